"""What the runtime's README shows is what happens."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from cfgplan_runtime import Received

README = (Path(__file__).parents[2] / "runtime" / "README.md").read_text(encoding="utf-8")


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", README, re.DOTALL)


def test_the_ten_lines_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    units, program, *_ = blocks("python")
    (tmp_path / "units.py").write_text(units)
    (tmp_path / "env.yaml").write_text(blocks("yaml")[0])
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    exec(program, names)
    received = names["received"]
    assert isinstance(received, Received)
    assert received.value is True
    assert capsys.readouterr().out.startswith("True ")


def test_every_run_option_is_in_the_table() -> None:
    from cfgplan.formats.fields import RunPart

    said = set(
        re.findall(r"`(\w+)`", "\n".join(line.split("|")[1] for line in README.splitlines() if line[:2] == "| "))
    )
    assert set(RunPart.model_fields) <= said
