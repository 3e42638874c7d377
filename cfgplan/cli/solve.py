"""`cfgplan solve`: the main job, the optimal update."""

from __future__ import annotations

import argparse
from pathlib import Path

from cfgplan.cli import options as shared
from cfgplan.cli.exits import OF_STATUS, Exit
from cfgplan.cli.front import add_front, show_front
from cfgplan.cli.screen import Screen
from cfgplan.planning import Status


def add_to(verbs: shared.Subparsers) -> None:
    parser = shared.add_verb(
        verbs,
        "solve",
        "find the cheapest update that meets every target, and prove it",
        "  cfgplan solve models/nao/2-segmenter-lost.yaml\n"
        "  cfgplan solve models/building/office.yaml --horizon 30 --out plan.json",
    )
    shared.add_environment(parser)
    shared.add_planning(parser)
    shared.add_survive(parser)
    add_front(parser)
    shared.add_matching(parser)
    parser.add_argument("--out", metavar="FILE", help="write the plan to FILE (JSON)")
    parser.add_argument(
        "--progress", action="store_true", help="print each better cost or bound as a JSON line on stderr"
    )
    parser.add_argument(
        "--detailed-exitcode", action="store_true", help="exit with 2 instead of 0 if the update changes something"
    )
    parser.add_argument("-v", "--verbose", action="store_true", help="show what each step of the planner did")
    shared.add_json(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace, screen: Screen) -> Exit:
    from cfgplan import api

    world = shared.load(options, screen)
    problem = shared.problem(options, screen, world)
    if options.front is not None:
        return show_front(options, screen, problem)
    report = shared.progress_report(screen) if options.progress else None
    with screen.phase("plan"):
        plan = api.plan(problem, planner=options.planner, time_limit_s=options.timeout, report=report)
    document = api.plan_text(world, problem, plan)
    if options.out:
        api.write_file(Path(options.out), document.encode())
    if screen.json:
        screen.write(document)
    else:
        from cfgplan.cli.update_text import update_text

        screen.show(update_text(problem, plan))
        if options.verbose:
            screen.note("\n".join(f"  {name:32} {count}" for name, count in plan.counts.items()))
        screen.times()
        if options.out:
            screen.note(f"Wrote {options.out}.")
    if options.detailed_exitcode and plan.status is Status.OPTIMAL and plan.change_set:
        return Exit.CHANGES
    return OF_STATUS[plan.status]
