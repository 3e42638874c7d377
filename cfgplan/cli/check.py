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


def add_to(parser: argparse.ArgumentParser) -> None:
    parser.epilog = "example:\n  cfgplan check models/nao/2-segmenter-lost.yaml"
    shared.add_environment(parser)
    shared.add_survive(parser)
    shared.add_matching(parser)
    shared.add_json(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace, screen: Screen) -> Exit:
    from rich.text import Text

    from cfgplan import api
    from cfgplan.planners.undecided import used_pairs

    world = shared.load(options, screen)
    matches = shared.matches(options, screen, world, api.FEW_PAIRS)
    with screen.phase("match"):
        matches.decide([*used_pairs(world.environment, matches.similarity)])
    problem = shared.problem(options, screen, world, matches)
    found = api.violations(problem.environment, problem.similarity, problem.survive, problem.horizon_s)
    broken = sum(not violation.is_open for violation in found)
    is_open = bool(found) and not broken
    if screen.json:
        screen.show_json(
            {
                "valid": None if is_open else not found,
                "violations": [
                    {
                        "rule": violation.rule.name.lower(),
                        "text": violation.text,
                        "unit": violation.unit,
                        "port": violation.port,
                        "target": violation.target,
                        "undecided": violation.is_open,
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
        verdict, style = "the running configuration is valid", "bold green"
        if is_open:
            verdict, style = "it is not decided whether the running configuration is valid", "bold yellow"
        elif found:
            verdict, style = f"the running configuration violates {counted(broken, 'rule')}", "bold red"
        screen.show(Text(f"{size}: {verdict}.", style=style))
    if is_open:
        return Exit.NOT_PROVEN
    return Exit.INVALID if found else Exit.OK


def _place(world: World, violation: Violation) -> str:
    """Where the unit or target of a violation is written, as `file:line:column`."""
    file = world.file
    place = file.place(unit=violation.unit, port=violation.port, target=violation.target) if file else None
    return ":".join(map(str, place)) if place else str(file.path if file else "environment")
