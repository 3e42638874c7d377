"""`cfgplan suggest`: tags for ports, from names, types of messages and units of measure."""

from __future__ import annotations

import argparse
import shlex
from collections.abc import Iterable, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING

from cfgplan.canonical import normal
from cfgplan.cli import options as shared
from cfgplan.cli.exits import Exit
from cfgplan.cli.screen import Screen
from cfgplan.errors import InputError, known

if TYPE_CHECKING:
    from cfgplan.domain import Environment
    from cfgplan.matching import Suggestion

_MOST_PORTS = 4
"""The most ports listed; if more, only their number is shown."""


def add_to(parser: argparse.ArgumentParser) -> None:
    parser.epilog = (
        "example:\n"
        "  cfgplan suggest models/nao/1-piff-registered.yaml 'ball_localization(piff)/position'\n"
        "Write the tag ⊤ (Thing) for a port that has no tag yet."
    )
    shared.add_environment(parser)
    parser.add_argument(
        "port",
        nargs="?",
        type=normal,
        help="an input or output as transformation/port, or the label of a target (default: all)",
    )
    shared.add_matching(parser)
    shared.add_json(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace, screen: Screen) -> Exit:
    from cfgplan import api
    from cfgplan.ros.vocabulary import ROS_NAMES

    world = shared.load(options, screen)
    if world.ontology.is_open:
        mend = f"`cfgplan ontology new {shlex.quote(options.env)}` writes one of the names in use"
        raise InputError.of(
            "the environment has no `ontology:` whose names tags could use", file=options.env, mend=mend
        )
    names = None if options.port is None else [port_named(world.environment, options.port)]
    with screen.phase("match"):
        found = api.suggested_tags(
            world, names, foreign=ROS_NAMES, reasoner=options.reasoner, time_limit_s=options.reasoner_timeout
        )
    tags = {**world.environment.outputs, **world.environment.demands}
    if screen.json:
        ports = {
            name: {"tag": tags[name], "suggestions": [asdict(each) for each in some]} for name, some in found.items()
        }
        screen.show_json({"ports": ports})
        return Exit.OK
    screen.show("\n".join(line for name, some in found.items() for line in _lines(name, tags[name], some)))
    return Exit.OK


def port_named(environment: Environment, name: str) -> str:
    """An input, output or target by its name, a target without `target ` too. Raises InputError with the nearest."""
    target = f"target {name}"
    if target in environment.demands:
        return target
    known(name, {**environment.outputs, **environment.demands}, "port or target", "`cfgplan match ENV` lists them all")
    return name


def _lines(name: str, tag: str, suggestions: Sequence[Suggestion]) -> Iterable[str]:
    yield f"{name}  now {tag}"
    if not suggestions:
        yield "  no name of the ontology fits its name, type or unit: rename the port, or declare a class for it"
    for number, each in enumerate(suggestions, start=1):
        yield f"  {number}. {each.tag}" + ("  (as it is)" if each.tag == tag else "")
        yield f"     {each.because}"
        for verb, ports in (("would match", each.gained), ("would no longer match", each.lost)):
            if ports:
                yield f"     {verb} {_some(ports)}"


def _some(ports: Sequence[str]) -> str:
    more = len(ports) - _MOST_PORTS
    return ", ".join(ports[:_MOST_PORTS]) + (f" and {more} more" if more > 0 else "")
