"""What the README shows is what happens."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import yaml

import cfgplan
from cfgplan.cli import main

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", README, re.DOTALL)


def test_the_first_command_ends_with_what_the_readme_shows(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(ROOT)
    job = blocks("sh")[0].split(" && ")[-1].split()
    assert job[0].endswith("/cfgplan")
    assert main(job[1:]) == 0
    assert blocks("text")[0].strip("\n") in capsys.readouterr().out


def test_it_can_be_read_at_once() -> None:
    assert README.count("\n") <= 150


def test_every_file_that_the_readme_links_to_is_there() -> None:
    for link in re.findall(r"\]\(([^)#]+)\)", README):
        assert "://" in link or (ROOT / link).exists(), link


def test_its_first_picture_is_a_short_film() -> None:
    image = pytest.importorskip("PIL.Image", reason="pip install 'cfgplan[plots]'")
    path = ROOT / re.findall(r"!\[[^]]*\]\(([^)]+)\)", README)[0]
    assert path.stat().st_size < 1_000_000
    with image.open(path) as film:
        assert film.is_animated
        assert film.n_frames > 10


def test_the_citation_is_that_of_this_version() -> None:
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert {"cff-version", "message", "title", "authors"} <= cited.keys()
    assert cited["version"] == cfgplan.__version__
