"""`cfgplan check`: every rule that the running configuration violates."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from cfgplan.cli import options as shared
from cfgplan.cli.exits import Exit
from cfgplan.cli.screen import Screen, counted

if TYPE_CHECKING:
    from cfgplan.api import World
    from cfgplan.validity import Violation


def add_to(verbs: shared.Subparsers) -> None:
    parser = shared.add_verb(
        verbs,
        "check",
        "load and match an environment and judge its running configuration",
        "  cfgplan check models/nao/2-segmenter-lost.yaml",
    )
    shared.add_environment(parser)
    shared.add_survive(parser)
    shared.add_matching(parser)
    shared.add_json(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace, screen: Screen) -> Exit:
    from rich.text import Text

    from cfgplan import api

    world = shared.load(options, screen)
    problem = shared.problem(options, screen, world)
    found = api.violations(problem.environment, problem.similarity, problem.survive)
    if screen.json:
        screen.show_json(
            {
                "valid": not found,
                "violations": [
                    {
                        "rule": violation.rule.name.lower(),
                        "text": violation.text,
                        "unit": violation.unit,
                        "port": violation.port,
                        "target": violation.target,
                        "place": _place(world, violation),
                    }
                    for violation in found
                ],
            }
        )
    else:
        for violation in found:
            line = Text(f"{_place(world, violation)}: ", style="bold")
            line.append(f"{violation.rule.name.lower()}: ", style="red")
            line.append(violation.text)
            screen.show(line)
        environment = world.environment
        size = ", ".join(
            [
                counted(len(environment.library), "transformation"),
                counted(len(environment.units), "running unit"),
                counted(len(environment.targets), "target"),
            ]
        )
        broken = f"the running configuration violates {counted(len(found), 'rule')}"
        verdict = broken if found else "the running configuration is valid"
        screen.show(Text(f"{size}: {verdict}.", style="bold red" if found else "bold green"))
    return Exit.INVALID if found else Exit.OK


def _place(world: World, violation: Violation) -> str:
    """Where the unit or target of a violation is written, as `file:line:column`."""
    file = world.file
    place = file.place(unit=violation.unit, port=violation.port, target=violation.target) if file else None
    return ":".join(map(str, place)) if place else str(file.path if file else "environment")
