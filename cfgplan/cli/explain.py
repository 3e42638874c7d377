"""`cfgplan explain`: why there is no plan, or why the plan uses what it uses."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from cfgplan.canonical import normal
from cfgplan.cli import options as shared
from cfgplan.cli.exits import OF_STATUS, Exit
from cfgplan.cli.screen import Screen

if TYPE_CHECKING:
    from cfgplan.answers import Subject
    from cfgplan.explaining import WhyNot
    from cfgplan.planning import Plan, Problem


def add_to(verbs: shared.Subparsers) -> None:
    parser = shared.add_verb(
        verbs,
        "explain",
        "say why there is no plan, or why the plan uses what it uses and what doing without would cost",
        "  cfgplan explain models/nao/0-target-only.yaml\n"
        "  cfgplan explain models/nao/4-fusion-available.yaml --transformation fuse_ball_pos",
    )
    shared.add_environment(parser)
    subject = parser.add_mutually_exclusive_group()
    subject.add_argument("--unit", type=normal, metavar="U", help="why this unit is started, kept, rewired or stopped")
    subject.add_argument("--transformation", type=normal, metavar="T", help="why this transformation is used, or not")
    subject.add_argument(
        "--stream",
        type=normal,
        metavar="S",
        help="why this output is used: unit/port or transformation/port",
    )
    shared.add_planning(parser)
    shared.add_survive(parser)
    shared.add_matching(parser)
    shared.add_json(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace, screen: Screen) -> Exit:
    from cfgplan import answers, api

    world = shared.load(options, screen)
    matches = shared.matches(options, screen, world, api.FEW_PAIRS)
    problem = shared.problem(options, screen, world, matches)
    with screen.phase("plan"):
        problem, plan = api.solved(problem, matches, planner=options.planner, time_limit_s=options.timeout)
    reasoning = {"reasoner": options.reasoner, "reasoner_limit_s": options.reasoner_timeout}
    chosen = {"planner": options.planner, "time_limit_s": options.timeout, "decider": matches}
    if plan.change_set is None:
        with screen.phase("explain"):
            why = answers.why_not(world, problem, **reasoning, **chosen)
        _show_why_not(problem, why, screen)
        return OF_STATUS[plan.status]
    with screen.phase("explain"):
        whys = [answers.why(problem, plan, kind, name, **chosen) for kind, name in _subjects(options, problem, plan)]
        unused = answers.why_not(world, problem, **reasoning, **chosen).unused if plan.unused_required else ()
    pinned = answers.unfed_pinned(world, problem, **reasoning)
    asked = {unit: reason for unit, reason in pinned.items() if options.unit == unit or not _names_one(options)}
    if screen.json:
        from cfgplan.explaining import plain

        unfed = {unit: plain(reason) for unit, reason in asked.items()}
        screen.show_json({"plan": plain(plan), "why": plain(tuple(whys)), "unused": plain(unused), "unfed": unfed})
        return OF_STATUS[plan.status]
    from cfgplan.cli.explain_text import pinned_lines, table_lines, unused_lines, why_text
    from cfgplan.cli.update_text import verdict

    if _names_one(options):
        screen.show(why_text(whys[0]))
    else:
        screen.show("\n".join([*table_lines(whys), verdict(problem, plan).plain]))
    for unit, reason in asked.items():
        screen.show("\n".join(pinned_lines(problem.environment, unit, reason)))
    for each in unused:
        screen.show("\n".join(unused_lines(problem.environment, each)))
    return OF_STATUS[plan.status]


def _show_why_not(problem: Problem, why: WhyNot, screen: Screen) -> None:
    if screen.json:
        from cfgplan.explaining import plain

        screen.show_json(plain(why))
        return
    from cfgplan.cli.explain_text import why_not_text
    from cfgplan.cli.update_text import undecided_lines, verdict

    screen.show(verdict(problem, why.plan))
    for line in undecided_lines(problem, why.plan):
        screen.show(line)
    text = why_not_text(problem.environment, why)
    if text:
        screen.show(text)


def _names_one(options: argparse.Namespace) -> bool:
    return any((options.unit, options.transformation, options.stream))


def _subjects(options: argparse.Namespace, problem: Problem, plan: Plan) -> list[tuple[Subject, str]]:
    """What is asked for, or all that the plan uses."""
    assert plan.change_set is not None
    after = problem.environment.update(plan.change_set)
    if options.unit:
        return [("unit", options.unit)]
    if options.transformation:
        return [("transformation", options.transformation)]
    if options.stream:
        unit, _, port = options.stream.rpartition("/")
        running = after.unit.get(unit)
        return [("stream", f"{running.transformation if running else unit}/{port}")]
    from cfgplan.cli.update_text import with_the_stream

    used = dict.fromkeys(unit.transformation for unit in with_the_stream(after))
    return [("transformation", label) for label in used]
