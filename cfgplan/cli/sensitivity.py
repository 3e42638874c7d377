"""`cfgplan sensitivity`: for which horizons, or upkeeps of a transformation, which plan is optimal."""

from __future__ import annotations

import argparse
from pathlib import Path

from cfgplan.canonical import normal
from cfgplan.cli import options as shared
from cfgplan.cli.exits import Exit
from cfgplan.cli.screen import Screen
from cfgplan.errors import InputError

_ENDINGS = (".svg", ".png", ".pdf")


def add_to(verbs: shared.Subparsers) -> None:
    parser = shared.add_verb(
        verbs,
        "sensitivity",
        "find for which horizons, or upkeeps of a transformation, which plan is optimal",
        "  cfgplan sensitivity models/building/office.yaml\n"
        "  cfgplan sensitivity models/building/office.yaml --upkeep-of air_flow_meter --out upkeep.svg",
    )
    shared.add_environment(parser)
    parser.add_argument(
        "--upkeep-of", type=normal, metavar="T", help="vary the upkeep of this transformation, not the horizon"
    )
    picture = "draw the least cost with its break points (svg, png or pdf)"
    parser.add_argument("--out", type=shared.out_file, metavar="FILE", help=picture)
    shared.add_planning(parser)
    shared.add_matching(parser)
    shared.add_json(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace, screen: Screen) -> Exit:
    from cfgplan import answers, api

    if options.out and Path(options.out).suffix.lower() not in _ENDINGS:
        raise InputError.of("not a kind of picture", file=options.out, mend=f"use one of {', '.join(_ENDINGS)}")
    world = shared.load(options, screen)
    matches = shared.matches(options, screen, world, api.FEW_PAIRS)
    problem = shared.problem(options, screen, world, matches)
    with screen.phase("plan"):
        found = answers.sensitivity(
            problem,
            upkeep_of=options.upkeep_of,
            planner=options.planner,
            time_limit_s=options.timeout,
            decider=matches,
        )
    if screen.json:
        from cfgplan.explaining import plain

        here = None if found.here is None else found.spans.index(found.here)
        screen.show_json({**plain(found), "breaks": plain(found.breaks), "here": here})
    else:
        from cfgplan.cli.sensitivity_text import sensitivity_text

        screen.show(sensitivity_text(found))
    if not found.spans:
        return Exit.NO_PLAN if found.exact else Exit.NO_ANSWER
    if options.out:
        from cfgplan.cli.sensitivity_plot import picture

        api.write_file(Path(options.out), picture(found, Path(options.out).suffix[1:].lower()))
        screen.note(f"Wrote {options.out}.")
    return Exit.OK if found.exact else Exit.NOT_PROVEN
