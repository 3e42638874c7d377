"""`cfgplan help WORDS` finds the sections of the manual that tell most about some words."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from cfgplan.cli.main import main
from cfgplan.cli.manual import manual_pages
from cfgplan.cli.manual_search import Section, asked_stems, found, sections, stems

PAGE = """\
# Robots

They move.

## Wheels

A wheel turns. Wheels need oil; oil is cheap.

```sh
# Legs
walk
```

### Tyres

| key | meaning |
|---|---|
| `oil` | none |
"""


@pytest.fixture
def page(tmp_path: Path) -> dict[str, Path]:
    (tmp_path / "robots.md").write_text(PAGE)
    return {"robots": tmp_path / "robots.md"}


def test_a_page_is_divided_at_its_headings_and_not_in_its_code(page: dict[str, Path]) -> None:
    made = list(sections(page))
    assert [(each.heading, each.under) for each in made] == [
        ("Robots", ()),
        ("Wheels", ("Robots",)),
        ("Tyres", ("Robots", "Wheels")),
    ]
    assert "walk" in made[1].lines


def test_words_are_found_in_other_forms(page: dict[str, Path]) -> None:
    assert stems("Turning wheels, oiled") == stems("turns wheel oil")
    (best,) = found(list(sections(page)), asked_stems(["turning", "wheel"]))
    assert best.heading == "Wheels"
    assert best.best_sentence(asked_stems(["oil", "wheels"])) == "Wheels need oil; oil is cheap."


def test_the_section_with_all_words_in_one_sentence_comes_first() -> None:
    apart = Section("p", "Apart", (), ("oil here.", "", "and a wheel there."))
    together = Section("p", "Together", (), ("a wheel with oil.", "", "and more."))
    assert found([apart, together], ["oil", "wheel"]) == [together, apart]
    assert found([apart, together], ["oil", "leg"]) == []
    assert found([apart, together], []) == []


@pytest.mark.parametrize(
    ("words", "page", "heading"),
    [
        ("restart unit", "operation", "A run in operation"),
        ("what is a cold spare", "hosts", "Failures"),
        ("link bandwidth", "environment", "A link"),
        ("docker container", "recipes", "A container as a unit"),
        ("targets at a broker", "mqtt", "Targets at a broker"),
        ("unproven plan", "hard", "What stays hard"),
    ],
)
def test_a_question_finds_its_section_among_the_first_three(words: str, page: str, heading: str) -> None:
    best = found(list(sections(manual_pages())), asked_stems(words.split()))
    assert (page, heading) in [(each.page, each.heading) for each in best[:3]]


def test_sections_are_shown_with_their_best_sentence(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["help", "mqtt", "password"]) == 0
    shown = capsys.readouterr()
    assert "mqtt: Targets at a broker\n" in shown.out
    assert "shows the first one's page" in shown.err


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["tutorial", "xyzzy"], "the manual has no word `xyzzy`"),
        (["what", "is"], "no section of the manual has all of these words"),
        (["quasar"], "there is no page `quasar`"),
    ],
)
def test_what_is_not_found_is_told(words: list[str], told: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["help", *words]) == 30
    assert told in capsys.readouterr().err


def test_a_page_in_a_file_or_pipe_has_no_spaces_at_line_ends(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["help", "tutorial"]) == 0
    lines = capsys.readouterr().out.split("\n")
    assert "   - label: thermometer" in lines
    assert not [line for line in lines if line.endswith(" ")]


def test_the_name_of_a_command_shows_its_options(capsys: pytest.CaptureFixture[str]) -> None:
    shown = []
    for words in (["help", "check"], ["check", "--help"]):
        with pytest.raises(SystemExit):
            main(words)
        shown.append(capsys.readouterr().out)
    assert shown[0].startswith("usage: cfgplan check ")
    assert shown[0] == shown[1]


def test_python_runs_the_package() -> None:
    call = [sys.executable, "-m", "cfgplan", "help", "glossary"]
    assert "Planning" in subprocess.run(call, capture_output=True, text=True, check=True).stdout
