"""`cfgplan solve`: the main job, the optimal update."""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Collection, Iterator
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cfgplan.cli import options as shared
from cfgplan.cli.exits import OF_STATUS, Exit, exit_of
from cfgplan.cli.idle_words import idle_words
from cfgplan.cli.plan_text import cpu, verdict
from cfgplan.cli.screen import Screen, blamed, counted
from cfgplan.cli.styled import Text
from cfgplan.errors import InputError
from cfgplan.planning import REFUSED, Plan, PlannerFaultError, Problem

if TYPE_CHECKING:
    from cfgplan.explaining import Alternatives
    from cfgplan.planning import Pair, Problem


def add_to(parser: argparse.ArgumentParser) -> None:
    parser.epilog = (
        "example:\n"
        "  cfgplan solve models/nao/2-segmenter-lost.yaml\n"
        "  cfgplan solve models/building/office.yaml --horizon 30 --out plan.json\n"
        "  cfgplan solve models/nao/4-fusion-available.yaml --alternatives 3\n"
        "  cfgplan solve models/nao/4-fusion-available.yaml --without 'segmenter(piff).1' --set horizon=600"
    )
    shared.add_environment(parser)
    shared.add_planning(parser)
    shared.add_survive(parser)
    shared.add_matching(parser)
    parser.add_argument("--out", type=shared.out_file, metavar="FILE", help="write the plan to FILE as JSON")
    parser.add_argument(
        "--progress", action="store_true", help="print each better cost or bound on standard error, as a line of JSON"
    )
    parser.add_argument(
        "--detailed-exitcode", action="store_true", help="exit with 2 instead of 0 if the plan changes something"
    )
    also = parser.add_mutually_exclusive_group()
    also.add_argument(
        "--alternatives",
        type=shared.count,
        metavar="K",
        help="show the K best plans that differ in which transformations run",
    )
    also.add_argument(
        "--front",
        nargs="?",
        const="",
        metavar="TARGET:ATTRIBUTE",
        help="list what each better quality of a target's stream costs; leave the value out if only one is possible",
    )
    also.add_argument(
        "--best-effort",
        action="store_true",
        help="if not every target can be met, give up those of lowest priority; exits with 12 then",
    )
    plot = "with --front: draw it, as .svg, .png or .pdf (needs the extra `plots`)"
    parser.add_argument("--plot", type=shared.plot_file, metavar="FILE", help=plot)
    parser.add_argument("-v", "--verbose", action="store_true", help="show how much work each step of the planner did")
    shared.add_json(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace, screen: Screen) -> Exit:
    if options.plot and options.front is None:
        raise InputError.of("--plot draws what --front finds", mend="add --front; `cfgplan graph` draws an update")
    if options.out and options.front is not None:
        raise InputError.of("--out writes one plan, but --front finds several", mend="use --json, or --plot FILE")
    of_one_plan = {
        "--progress": options.progress,
        "--detailed-exitcode": options.detailed_exitcode,
        "-v": options.verbose,
    }
    if options.front is not None or options.alternatives:
        shared.refuse_beside("--front" if options.front is not None else "--alternatives", of_one_plan)
    if options.best_effort:
        shared.refuse_beside("--best-effort", {"--progress": options.progress})
    task = shared.task(options, screen)
    try:
        if options.front is not None:
            from cfgplan.cli.front import show_front

            return show_front(options, screen, task)
        if options.alternatives:
            return _alternatives(options, screen, task)
        return _solve(options, screen, task)
    except PlannerFaultError as error:
        if error.plan.change_set is None or os.environ.get("CFGPLAN_TRACEBACK"):
            raise
        return _show_unjudged(screen, task, error)


def _solve(options: argparse.Namespace, screen: Screen, task: shared.Task) -> Exit:
    from cfgplan import answers, api
    from cfgplan.cli.plan_text import left_out_lines, told_left_out, update_text
    from cfgplan.shared_states import double_owners

    world, is_proven = task.world, True
    undecided: tuple[Pair, ...] = ()
    given_up: Collection[str] = ()
    with task.planned(screen) as work:
        work.is_told = options.progress
        if options.best_effort:
            found = answers.best_effort(task.problem, **task.planning)
            problem, plan, is_proven, undecided = found.problem, found.plan, found.exact, found.undecided
            given_up = found.given_up
        else:
            report = shared.progress_report(screen) if options.progress else work.report
            problem, plan = api.solved(task.problem, **task.planning, report=report)
    try:
        document = api.plan_text(world, problem, plan) if screen.json or options.out else ""
        shown = None if screen.json else update_text(problem, plan, given_up)
    except Exception as error:
        raise PlannerFaultError(f"it can't be shown: {type(error).__name__}: {error}", plan) from error
    if shown is None:
        screen.write(document)
    else:
        screen.show(shown)
    if options.out:
        api.write_file(Path(options.out), document.encode())
    if not screen.json:
        is_reasoned = plan.change_set is not None and bool(plan.reasons)
        unfed = answers.unfed_pinned(world, problem, **task.reasoning) if is_reasoned else {}
        for unit, why in unfed.items():
            from cfgplan.cli.explain import pinned_lines

            screen.warn("\n".join(pinned_lines(problem.environment, unit, why)))
        if not is_proven and undecided:
            screen.warn(
                f"whether more targets can be met depends on {counted(len(undecided), 'pair')} of undecided tags"
            )
        elif not is_proven:
            screen.warn("time ran out before it was proven that no better set of targets can be met")
        for line in left_out_lines(world.environment, told=told_left_out(plan, given_up)):
            screen.note(line)
        for warning in double_owners(problem.after(plan)) if plan.change_set is not None else ():
            screen.warn(warning)
        started = {unit.transformation for unit in plan.change_set.started} if plan.change_set is not None else set()
        for fault in (*shared.code_faults(world, sorted(started)), *idle_words(world)):
            screen.warn_of(fault)
        if options.verbose:
            screen.note("\n".join(f"  {name:32} {count}" for name, count in plan.counts.items()))
        screen.times()
        if options.out:
            screen.note(f"Wrote {options.out}.")
        if plan.status in REFUSED:
            screen.note(f"`cfgplan explain {shared.problem_words(options)}` says more about the reasons.")
    code = exit_of(plan.status, is_exact=is_proven, is_unmet=bool(given_up))
    return Exit.CHANGES if code is Exit.OK and options.detailed_exitcode and plan.change_set else code


def _show_unjudged(screen: Screen, task: shared.Task, error: PlannerFaultError) -> Exit:
    """Print a plan that the judge could not confirm, and why; as plain data if its text fails too."""
    from cfgplan import api
    from cfgplan.cli.plan_text import update_text

    document: dict[str, Any] = {"cost_us": error.plan.cost_us, "change_set": repr(error.plan.change_set)}
    with suppress(Exception):
        document = json.loads(api.plan_text(task.world, task.problem, error.plan))
    shown = None
    if not screen.json:
        with suppress(Exception):
            shown = update_text(task.problem, error.plan)
    if shown is None:
        screen.show_json({**document, "unjudged": str(error)})
    else:
        screen.show(shown)
    if not screen.json:
        screen.note(f"Do not rely on this plan: {error}", style="bold red")
        blame = blamed(error)
        screen.note(f"{blame[0].upper()}{blame[1:]}.")
    return Exit.INTERNAL


def _alternatives(options: argparse.Namespace, screen: Screen, task: shared.Task) -> Exit:
    from cfgplan import answers, api

    with task.planned(screen):
        found = answers.alternatives(task.problem, options.alternatives, **task.planning)
    if not found.plans:
        return _solve(options, screen, task)
    documents = [api.plan_text(task.world, task.problem, plan) for plan in found.plans]
    if options.out:
        api.write_file(Path(options.out), documents[0].encode())
    if screen.json:
        plans = [json.loads(document) for document in documents]
        screen.show_json({"complete": found.complete, "has_more": found.has_more, "alternatives": plans})
    else:
        screen.show(alternatives_text(task.problem, found))
        screen.times()
        if options.out:
            screen.note(f"Wrote {options.out}: the first of them.")
    return OF_STATUS[found.plans[0].status] if found.complete else Exit.NOT_PROVEN


def alternatives_text(problem: Problem, found: Alternatives) -> Text:
    """The plans in order; ends without a newline."""
    lines = [line for place, plan in enumerate(found.plans) for line in _plan(problem, found.plans[0], place, plan)]
    lines.append(verdict(problem, found.plans[0]))
    if not found.complete:
        lines.append(Text("Further alternatives may be missing: not all could be decided.", style="yellow"))
    elif found.has_more:
        lines.append(Text("There are more: ask for a larger number of alternatives.", style="dim"))
    else:
        lines.append(Text("There are no others.", style="dim"))
    return Text("\n").join(lines)


def _plan(problem: Problem, first: Plan, place: int, plan: Plan) -> Iterator[Text]:
    changes = plan.change_set
    assert changes is not None and plan.cost_us is not None and first.cost_us is not None
    difference_us = plan.cost_us - first.cost_us
    more = f" ({'+' if difference_us >= 0 else '-'}{cpu(abs(difference_us))})" if place else ""
    kept = len(problem.environment.units) - len(changes.stopped) - len(changes.rewired)
    yield Text(
        f"{place + 1}. {cpu(plan.cost_us)}{more}: {len(changes.started)} to start, {len(changes.rewired)} to rewire, "
        f"{len(changes.stopped)} to stop, {kept} kept as they are",
        style="bold",
    )
    one, other = _running(problem, first), _running(problem, plan)
    if not place:
        yield Text(f"   {', '.join(sorted(other)) or 'nothing runs'}")
    if other - one:
        yield Text(f"   + {', '.join(sorted(other - one))}", style="green")
    if one - other:
        yield Text(f"   - {', '.join(sorted(one - other))}", style="red")
    for label in plan.unused_required:
        yield Text(f"   required {label} is not used", style="yellow")


def _running(problem: Problem, plan: Plan) -> set[str]:
    return {unit.transformation for unit in problem.after(plan).units}
