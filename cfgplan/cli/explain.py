"""`cfgplan explain`: why no plan exists, or why the plan uses a unit, a transformation or an output."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from itertools import islice
from typing import TYPE_CHECKING

from cfgplan.canonical import normal
from cfgplan.cli import options as shared
from cfgplan.cli.exits import OF_STATUS, Exit
from cfgplan.cli.plan_text import cpu, fact_lines, plain_barred
from cfgplan.cli.screen import Screen
from cfgplan.cli.styled import Text
from cfgplan.domain import Environment
from cfgplan.errors import known
from cfgplan.explaining import Blocked, Choice, Clash, Unfed, Unreachable, Unused, Why, WhyNot
from cfgplan.explaining.why_words import choice_line, forced_by, instead, named_labels, why_lines
from cfgplan.figures import amount
from cfgplan.onward import grouped
from cfgplan.summary import some
from cfgplan.unmet import LEFT_OUT, SharedReason, shared_reasons

if TYPE_CHECKING:
    from cfgplan.answers import Subject
    from cfgplan.explaining import WhyNot
    from cfgplan.planning import Plan, Problem


def add_to(parser: argparse.ArgumentParser) -> None:
    parser.epilog = (
        "example:\n"
        "  cfgplan explain models/nao/0-target-only.yaml\n"
        "  cfgplan explain models/nao/4-fusion-available.yaml fuse_ball_pos"
    )
    shared.add_environment(parser)
    subject = parser.add_mutually_exclusive_group()
    subject.add_argument(
        "subject",
        type=normal,
        metavar="NAME",
        nargs="?",
        help="explain why this unit, transformation or stream is used or not (default: all that the plan uses)",
    )
    subject.add_argument(
        "--unit", type=normal, metavar="U", help="explain why this unit is started, kept, rewired or stopped"
    )
    subject.add_argument(
        "--transformation", type=normal, metavar="T", help="explain why this transformation is used or not"
    )
    subject.add_argument(
        "--stream",
        type=normal,
        metavar="S",
        help="explain why this output is used, as unit/port or transformation/port",
    )
    shared.add_planning(parser)
    shared.add_survive(parser)
    shared.add_matching(parser)
    shared.add_json(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace, screen: Screen) -> Exit:
    from cfgplan import answers, api

    task = shared.task(options, screen)
    world, planning, reasoning = task.world, task.planning, task.reasoning
    left_out = world.environment.left_out
    asked_for = options.subject or options.transformation
    if asked_for in left_out and not options.stream:
        if screen.json:
            screen.show_json({"left_out": {asked_for: left_out[asked_for]}})
        else:
            screen.show(f"{asked_for} is {LEFT_OUT}: {left_out[asked_for]}")
        return Exit.OK
    with task.planned(screen) as work:
        problem, plan = api.solved(task.problem, **planning, report=work.report)
    if plan.change_set is None:
        _check_named(options, problem.environment)
        with screen.phase("explain"):
            why = answers.why_not(world, problem, **reasoning, **planning)
        _show_why_not(problem, why, screen, world.environment)
        return OF_STATUS[plan.status]
    with screen.phase("explain"):
        whys = [answers.why(problem, plan, kind, name, **planning) for kind, name in _subjects(options, problem, plan)]
        unused = answers.why_not(world, problem, **reasoning, **planning).unused if plan.unused_required else ()
    pinned = answers.unfed_pinned(world, problem, **reasoning)
    names_one = any((options.subject, options.unit, options.transformation, options.stream))
    named = (options.unit, options.subject)
    asked = {unit: reason for unit, reason in pinned.items() if unit in named or not names_one}
    if screen.json:
        told = {"plan": plan, "why": whys, "unused": unused, "unfed": asked}
        screen.show_json(told | _of_facts(world.environment))
        return OF_STATUS[plan.status]
    from cfgplan.cli.plan_text import verdict

    if names_one:
        screen.show(why_text(whys[0]))
    else:
        screen.show("\n".join([*table_lines(whys), verdict(problem, plan).plain]))
    for unit, reason in asked.items():
        screen.show("\n".join(pinned_lines(problem.environment, unit, reason)))
    for each in unused:
        screen.show("\n".join(unused_lines(problem, each)))
    for told_of_fact in fact_lines(world.environment, asked_for if names_one else None):
        screen.show(told_of_fact)
    return OF_STATUS[plan.status]


def _of_facts(environment: Environment) -> dict[str, object]:
    """Return the effects of facts and observations on the library, for JSON; empty without any."""
    told = {
        "left_out": dict(environment.left_out),
        "barred": plain_barred(environment),
        "qualities_now": environment.qualities_now,
    }
    return {key: said for key, said in told.items() if said}


def _show_why_not(problem: Problem, why: WhyNot, screen: Screen, environment: Environment) -> None:
    if screen.json:
        of_facts = _of_facts(environment)
        screen.show_json(asdict(why) | of_facts if of_facts else why)
        return
    from cfgplan.cli.plan_text import undecided_lines, verdict

    screen.show(verdict(problem, why.plan))
    for line in undecided_lines(problem, why.plan):
        screen.show(line)
    told = why_not_told(problem, why)
    if told.text:
        screen.show(told.text)
    for told_of_fact in fact_lines(environment, told=told.left_out):
        screen.show(told_of_fact)


def _subjects(options: argparse.Namespace, problem: Problem, plan: Plan) -> list[tuple[Subject, str]]:
    """The subjects that are asked for, or all that the plan uses."""
    before, after = problem.environment, problem.after(plan)
    name = options.subject or options.unit or options.transformation or options.stream
    if name is None:
        from cfgplan.cli.plan_text import in_stream_order

        used = dict.fromkeys(unit.transformation for unit in in_stream_order(after))
        return [("transformation", label) for label in used]
    units = {*before.unit, *after.unit}
    if options.unit or (options.subject and name in units):
        return [("unit", name)]
    if options.stream or (options.subject and "/" in name and name not in after.transformation):
        return [_stream(name, after)]
    if options.subject:
        known(name, {*after.transformation, *units}, "unit, transformation or stream")
    return [("transformation", name)]


def _check_named(options: argparse.Namespace, environment: Environment) -> None:
    """Raise InputError if nothing that could be in a plan has the name that is asked for."""
    name = options.subject or options.unit or options.transformation or options.stream or ""
    owner = name.rpartition("/")[0] or name
    names = {*environment.transformation, *environment.unit}
    if name and names.isdisjoint((name, owner, owner.rpartition(".")[0])):
        known(name, names, "unit, transformation or stream")


def _stream(name: str, after: Environment) -> tuple[Subject, str]:
    unit, _, port = name.rpartition("/")
    running = after.unit.get(unit)
    return "stream", f"{running.transformation}/{port}" if running else name


MOST_LINES = 30
"""The most lines shown of one reason; `--json` has all."""


@dataclass(frozen=True)
class WhyNotTold:
    """Why no plan exists, in words, and the transformations that the text names as left out."""

    text: Text
    left_out: frozenset[str]


def why_not_told(problem: Problem, why: WhyNot) -> WhyNotTold:
    """Return why no plan exists, target by target; the text ends without a newline."""
    environment = problem.environment
    lines, shared = list[Text](), list[SharedReason]()
    trees, reasons = _Trees(environment), grouped(((one.wanted, one.blocked), one.target) for one in why.unreachable)
    for (wanted, blocked), targets in reasons.items():
        opening = f"{named_labels('target', tuple(targets))} want{'' if len(targets) > 1 else 's'}"
        lines += [Text(line) for line in trees.shortened(wanted, blocked, opening)]
    if why.clash is not None:
        lines.append(Text(clash_line(why.clash)))
        if why.clash.limits:
            named = ", ".join(map(str, why.clash.limits))
            these = "these limits together forbid it" if len(why.clash.limits) > 1 else "this limit forbids it"
            lines.append(Text(f"  {these}: {named}"))
        told = {reason.target for reason in why.unreachable}
        others = {label: reason for label, reason in why.plan.reasons.items() if label not in told}
        shared = shared_reasons(others)
        lines += [Text(f"  {one.text}") for one in shared]
    for unused in why.unused:
        lines += [Text(line) for line in unused_lines(problem, unused)]
    return WhyNotTold(Text("\n").join(lines), trees.left_out.union(*(one.left_out for one in shared)))


def clash_line(clash: Clash) -> str:
    demands = clash.demands
    parts = [named_labels("target", demands.targets)] if demands.targets else []
    parts += [named_labels("required", demands.required)] if demands.required else []
    parts += [named_labels("pinned", demands.pinned)] if demands.pinned else []
    number = len(demands.targets) + len(demands.required) + len(demands.pinned)
    who = " with ".join(parts) or "even without targets"
    if clash.cost_us is None or clash.max_cost_us is None:
        return (
            f"{who}: no valid configuration meets {'them together' if number > 1 else 'it' if number else 'the rules'}"
        )
    missing = " Without any one of them there is a plan." if number > 1 else ""
    alone = "these alone" if number > 1 else "it alone" if number else "no target"
    dear = f"costs at least {cpu(clash.cost_us)}, and {cpu(clash.max_cost_us)} is allowed"
    return f"{who}: the cheapest plan for {alone} {dear}.{missing}"


def unused_lines(problem: Problem, unused: Unused) -> Iterator[str]:
    """Why a required transformation is not used."""
    environment = problem.environment
    who = f"required {unused.transformation} is not used"
    if unused.blocked is not None:
        (first,) = unused.blocked.blocked[:1]
        yield f"{who}: it can't run"
        yield from ("  " + line for line in _Trees(environment).below(unused.blocked.blocked, first.transformation))
    elif not unused.proven:
        yield f"{who}: no plan that uses it was found, nor a proof that there is none"
    elif unused.excluded_by:
        yield f"{who}: no configuration uses it together with {' and '.join(unused.excluded_by)}"
    else:
        yield f"{who}: {_why_useless(problem, unused.transformation)}"


def _why_useless(problem: Problem, label: str) -> str:
    """Return why no unit can use a transformation that can run."""
    environment = problem.environment
    given = sorted({port.tag for port in environment.transformation[label].outputs})
    if not given:
        return "it has no output, and no target asks for a unit of it by `run:`"
    wanted = {*environment.demands.values()}
    if not any(problem.similarity.optimistic.holds(offered, tag) for offered in given for tag in wanted):
        return f"it can run, but no input and no target matches {' or '.join(given)}"
    return f"it can run, but no wiring leads from it to a target; it gives {some(given)}"


def pinned_lines(environment: Environment, unit: str, why: Unreachable) -> Iterator[str]:
    """Why a pinned unit can't be fed, down to the outputs that come nearest."""
    yield f"pinned unit {unit} is stopped, since it can't be fed"
    blocked = _Trees(environment).below(why.blocked, environment.unit[unit].transformation)
    yield from (f"  {line}" for line in blocked)


def why_text(why: Why) -> Text:
    """Return why a plan uses something, or why not: the targets that it serves, and the cost of doing without it."""
    styles = {choice_line(why): "bold", "  + ": "green", "  - ": "red"}
    lines = (Text(line, style=styles.get(line) or styles.get(line[:4], "")) for line in why_lines(why))
    return Text("\n").join(lines)


def table_lines(whys: Sequence[Why]) -> Iterator[str]:
    """Yield a line for each unit of a plan: the targets that it serves, and the cost without its transformation."""
    width = max((len(unit) for why in whys for unit in why.units), default=0)
    told = max((len(some(why.targets)) for why in whys), default=0)
    for why in whys:
        for unit in why.units:
            yield f"  {unit:{width}}  for {some(why.targets) or '-':{told}}  {_briefly(why)}"


def _briefly(why: Why) -> str:
    match why.choice:
        case Choice.FORCED:
            return f"needed: {forced_by(why, is_brief=True)}"
        case Choice.CHEAPER:
            return f"without it {amount(why.decides, why.difference or 0)} more"
        case Choice.LESS_CHANGE:
            return "without it the same cost, more changes"
        case Choice.TIE:
            return f"a tie: {instead(why)}"
        case Choice.DEMANDED if not why.difference:
            return "required or pinned: without it the same cost"
        case Choice.DEMANDED:
            return f"required or pinned: without it {amount(why.decides, -(why.difference or 0))} less"
    return "not decided: time ran out before the cost of doing without it was known"


class _Trees:
    """Lines of reasons as trees. Each transformation and each unmatched tag is explained once in all of them."""

    def __init__(self, environment: Environment) -> None:
        self._environment = environment
        self._told: set[str] = set()
        self._told_tags: set[str] = set()
        self.left_out: frozenset[str] = frozenset()
        """The transformations that the lines name as left out."""

    def shortened(self, wanted: Unfed, blocked: Sequence[Blocked], opening: str) -> Iterator[str]:
        """Yield the first lines about a demand that can't be fed, and how many more there are."""
        lines = self._tree(wanted, blocked, opening)
        yield from islice(lines, MOST_LINES)
        told, told_tags, left_out = self._told.copy(), self._told_tags.copy(), self.left_out
        if more := sum(1 for _ in lines):
            yield f"  ... and {more} more lines, all in --json"
        self._told, self._told_tags, self.left_out = told, told_tags, left_out

    def _tree(self, wanted: Unfed, blocked: Sequence[Blocked], opening: str) -> Iterator[str]:
        yield from self._demand(wanted, opening)
        for provider in wanted.providers:
            yield from ("  " + line for line in self.below(blocked, provider))

    def below(self, all_blocked: Sequence[Blocked], root: str) -> Iterator[str]:
        """Yield the blockers of a transformation, depth first."""
        blocked = {each.transformation: each for each in all_blocked}
        ahead: list[tuple[int, str, tuple[str, ...]]] = [(0, root, ())]
        while ahead:
            depth, label, above = ahead.pop()
            indent = "  " * depth
            if label not in blocked:
                continue
            if label in self._told:
                again = "is fed only by itself, see above" if label in above else "see above"
                yield f"{indent}{label}: {again}"
                continue
            self._told.add(label)
            each = blocked[label]
            for line in self._blocked(each):
                yield indent + line
            providers = [provider for unfed in each.inputs for provider in unfed.providers]
            ahead += [(depth + 1, provider, (*above, label)) for provider in reversed(list(dict.fromkeys(providers)))]

    def _blocked(self, blocked: Blocked) -> Iterator[str]:
        if len(blocked.inputs) == 1:
            (unfed,) = blocked.inputs
            yield from self._demand(unfed, f"{blocked.transformation}: input {unfed.port} wants")
            return
        names = " and ".join(unfed.port or "" for unfed in blocked.inputs)
        able = f"only {some(blocked.available)} can feed them" if blocked.available else "nothing can feed them"
        yield f"{blocked.transformation}: inputs {names} must be fed by different transformations, but {able}"

    def _demand(self, unfed: Unfed, opening: str) -> Iterator[str]:
        if unfed.providers or unfed.left_out:
            yield f"{opening} {unfed.tag}, but no transformation that offers it can run"
            if unfed.undecided:
                yield f"    not decided yet whether {some(unfed.undecided)} matches"
            labels_of = grouped((why, label) for label, why in unfed.left_out)
            for why, labels in labels_of.items():
                self.left_out = self.left_out.union(labels)
                yield f"    {LEFT_OUT}: {', '.join(labels)}, {why}"
            return
        is_new = unfed.tag not in self._told_tags
        self._told_tags.add(unfed.tag)
        yield f"{opening} {unfed.tag}, but no output matches{'' if is_new or not unfed.nearest else ', see above'}"
        fewest = min((len(offer.missing) for offer in unfed.nearest), default=0)
        for offer in unfed.nearest if is_new else ():
            if len(offer.missing) > fewest:
                continue
            providers = some(name for name, tag in self._environment.outputs.items() if tag == offer.offered)
            yield f"    nearest: {providers} gives {offer.offered}: {offer.verdict}"
