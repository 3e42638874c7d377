"""`cfgplan completion`: scripts by which a shell completes command lines."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from typing import Any

from cfgplan.cli.exits import Exit
from cfgplan.cli.screen import Screen
from cfgplan.extras import needed

_FILE_METAVARS = ("ENV", "FILE", "PATH")
_FOLDER_METAVARS = ("DIR", "FOLDER")
"""The metavars of options whose values are files or folders."""


def add_to(parser: argparse.ArgumentParser) -> None:
    parser.epilog = "example:\n  cfgplan completion bash > ~/.local/share/bash-completion/completions/cfgplan"
    parser.add_argument("shell", choices=("bash", "zsh"), help="the shell to write the script for")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace, screen: Screen) -> Exit:
    needed("completions", "shtab")
    screen.write(script(options.shell))
    return Exit.OK


def script(shell: str) -> str:
    """The script that makes a shell complete every command."""
    import shtab

    from cfgplan.cli.main import VERBS, parser_with
    from cfgplan.cli.manual import manual_pages

    parser = parser_with(VERBS)
    for action in _actions(parser):
        if action.metavar in _FILE_METAVARS:
            action.complete = shtab.FILE
        elif action.metavar in _FOLDER_METAVARS:
            action.complete = shtab.DIRECTORY
        elif action.dest == "manual_page":
            action.choices = sorted(manual_pages())
    return shtab.complete(parser, shell)


def _actions(parser: argparse.ArgumentParser) -> Iterator[Any]:
    """Yield the actions of a parser and of all parsers below it."""
    for action in parser._actions:
        yield action
        if isinstance(action, argparse._SubParsersAction):
            for below in action.choices.values():
                yield from _actions(below)
