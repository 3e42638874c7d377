"""Text for files is what rich would print there."""

from __future__ import annotations

import io

import pytest
from rich.console import Console

from cfgplan.cli.screen import Screen
from cfgplan.cli.styled import Text


def example() -> Text:
    """Text with every kind of piece, and characters that rich drops or turns into others."""
    line = (
        Text("a\tb ⊓ c\x07", style="bold red").append(" [bold]d[/]", style="not bold default").append("", style="dim")
    )
    return Text("\n").join([line, Text(), Text("é\r: 3", style="green"), Text("x" * 300)])


def printed(shown: object, **terminal: bool) -> str:
    stream = io.StringIO()
    console = Console(file=stream, highlight=False, markup=False, emoji=False, width=1000, **terminal)
    console.print(shown, soft_wrap=True)
    return stream.getvalue()


def test_plain_text_is_what_rich_prints_without_a_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    Screen(json=False).show(example())
    assert capsys.readouterr().out == printed(example()) == f"{example()}\n"


def test_a_note_and_a_warning_are_plain_without_a_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    screen = Screen(json=False)
    screen.note("one")
    screen.warn("two")
    assert capsys.readouterr().err == "one\nwarning: two\n"


def test_a_terminal_gets_colours(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")
    Screen(json=False).show(Text("a", style="bold red"))
    assert "\x1b[" in capsys.readouterr().out
    assert "\x1b[1;31m" in printed(example(), force_terminal=True)
