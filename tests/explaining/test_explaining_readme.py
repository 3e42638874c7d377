"""What the README of the room promises runs as it stands there."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import cfgplan

ROOT = Path(__file__).parents[2]


def test_the_python_of_the_readme_runs(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.chdir(ROOT)
    text = (Path(cfgplan.__file__).parent / "explaining" / "README.md").read_text(encoding="utf-8")
    (code,) = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    exec(code, {})
    said = capsys.readouterr().out.splitlines()
    assert said == ["cheaper 21300000", "[18600000, 20550000, 39900000]", "()", "()", "()"]
