"""A plan as text: units to start, rewire, stop and keep, and the cost, quality and hosts afterwards."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Collection, Iterable, Iterator

from cfgplan.amounts import core_share, short_core_share
from cfgplan.cli.screen import counted, decided_by
from cfgplan.cli.styled import Text
from cfgplan.costs import keep_cost_us, labor_us, standby_cost_us, upkeep_us
from cfgplan.domain import CPU, MEMORY, POWER, ChangeSet, ComputationUnit, Environment, Host, Stream, Target
from cfgplan.figures import CostParts, amount, cost_parts, link_loads, loads, told_qualities, transfers
from cfgplan.planners import IGNORING_REQUIRED
from cfgplan.planning import Failures, Plan, Problem, Status
from cfgplan.qualities import Better, Wish
from cfgplan.ros.sources import NodeSource
from cfgplan.summary import cpu as cpu
from cfgplan.unmet import LEFT_OUT, SharedReason, shared_reasons

_SIGNS = {"+": ("start", "green"), "~": ("rewire", "yellow"), "-": ("stop", "red"), "=": ("keep", "dim")}
"""The actions on a unit, and the sign and style of each."""
MOST_OPEN_PAIRS, MOST_NAMES = 10, 3
"""The most open pairs shown, and the most ports of one tag; `--json` has all."""


def update_text(problem: Problem, plan: Plan, given_up: Collection[str] = ()) -> Text:
    """The whole report of `solve`; ends without a newline. `given_up` are labels of targets that `problem` lacks."""
    changes = () if plan.change_set is None else _changes(problem.environment, plan.change_set)
    return Text("\n").join([*changes, *_summary(problem, plan, given_up)])


def left_out_lines(environment: Environment, *, told: Collection[str] = ()) -> list[str]:
    """Return lines that name the transformations that facts leave out, and those that facts of hosts bar from some.

    Transformations in `told` have been named as left out already.
    """
    left_out = environment.left_out.items()
    new = [f"{LEFT_OUT}: {label}, {why}" for label, why in left_out if label not in told]
    return [*new, *_barred_lines(environment)]


def _barred_lines(environment: Environment, of: str | None = None) -> list[str]:
    """The hosts where transformations, or only the one of a label, may not run for now."""
    return [
        f"{label} may not run on {host} for now: {why}"
        for label, hosts in environment.barred.items()
        if of in (None, label)
        for host, why in hosts.items()
    ]


def plain_barred(environment: Environment) -> dict[str, dict[str, str]]:
    """Return for JSON why transformations may not run on some hosts for now, by label and host."""
    return {label: dict(hosts) for label, hosts in environment.barred.items()}


def fact_lines(environment: Environment, of: str | None = None, *, told: Collection[str] = ()) -> list[str]:
    """Return the effects of facts on the library: transformations that may not run, and qualities that follow facts.

    `of` is a transformation or a unit; None stands for all. `told` is as for `left_out_lines`.
    """
    label = of if of is None or of not in environment.unit else environment.unit[of].transformation
    now = environment.qualities_now.items()
    of_quality = [f"for now: {what} {value}" for what, value in now if label is None or what.startswith(f"{label}/")]
    if label is not None:
        return [*_barred_lines(environment, label), *of_quality]
    return [*left_out_lines(environment, told=told), *of_quality]


def changes_text(before: Environment, changes: ChangeSet) -> Text:
    """Return a change set as text: units to start, rewire, stop and keep; ends with an empty line."""
    return Text("\n").join(_changes(before, changes))


def _changes(before: Environment, changes: ChangeSet) -> Iterator[Text]:
    after = before.update(changes)
    started = {unit.id for unit in changes.started}
    rewired = {unit.id for unit in changes.rewired}
    width = max((len(unit.id) for unit in (*before.units, *after.units)), default=0)
    units = in_stream_order(after)
    for unit in units:
        if unit.id in started:
            yield _headline("+", unit, width, before)
            yield from _wiring(unit)
    for unit in units:
        if unit.id in rewired:
            yield _headline("~", unit, width, before)
            yield from _differences(before.unit[unit.id], unit)
    for unit_id in changes.stopped:
        yield _headline("-", before.unit[unit_id], width, before)
    for unit in units:
        if unit.id not in started and unit.id not in rewired:
            yield _headline("=", unit, width, before)
    yield Text()


def in_stream_order(environment: Environment) -> list[ComputationUnit]:
    """Return the units in the order of their streams: each after its feeders, except those of feedback inputs."""
    done: dict[str, ComputationUnit] = {}
    missing = {unit.id: {s.stream.unit for s in unit.subscriptions} for unit in environment.units}
    readers: dict[str, list[str]] = defaultdict(list)
    for unit_id, feeders in missing.items():
        for feeder in feeders:
            readers[feeder].append(unit_id)
    ready = [unit_id for unit_id, feeders in missing.items() if not feeders]
    waiting = iter(environment.units)
    while len(done) < len(environment.units):
        ready = ready or [next(unit.id for unit in waiting if unit.id not in done)]
        done |= {unit_id: environment.unit[unit_id] for unit_id in ready}
        freed = []
        for unit_id in ready:
            for reader in readers[unit_id]:
                missing[reader].discard(unit_id)
                if not missing[reader] and reader not in done:
                    freed.append(reader)
        ready = sorted(freed)
    return list(done.values())


def _headline(sign: str, unit: ComputationUnit, width: int, environment: Environment) -> Text:
    transformation = environment.transformation.get(unit.transformation)
    done, style = _SIGNS[sign]
    verb = "ready" if sign == "+" and unit.standby else done
    node = None if transformation is None else NodeSource.read(transformation.source)
    if sign == "+" and node is not None and node.kind == "external":
        verb = "adopt"
    line = Text(f"  {sign} {verb:6}  {unit.id:{width}}", style=style)
    if transformation is not None:
        where = "" if unit.host is None else f"on {unit.host}, "
        host = environment.place_of(unit)
        labor = f"labor {cpu(labor_us(transformation, host))}, " if sign == "+" else ""
        figures = f"{labor}upkeep {core_share(upkeep_us(transformation, host))}"
        if unit.standby:
            figures = f"a cold spare, standby {core_share(standby_cost_us(transformation, 1, host))}"
        line.append(f"   {where}{figures}", style="dim")
    return line


def _wiring(unit: ComputationUnit) -> Iterator[Text]:
    for port, streams in unit.feeds.items():
        yield Text(f"              {port} <- {_names(streams)}", style="green")
    for publication in unit.publications:
        yield Text(f"              {publication.port} -> topic {publication.topic}", style="green")


def _differences(was: ComputationUnit, now: ComputationUnit) -> Iterator[Text]:
    for port in sorted(was.feeds.keys() | now.feeds.keys()):
        old, new = was.feeds.get(port, ()), now.feeds.get(port, ())
        if old != new:
            text = f"{port} <- {_names(new) or 'nothing'}   (was {_names(old) or 'not connected'})"
            yield Text(f"              {text}", style="yellow")
    for publication in was.publications:
        if publication not in now.publications:
            yield Text(f"              {publication.port} no longer on topic {publication.topic}", style="yellow")
    for publication in now.publications:
        if publication not in was.publications:
            yield Text(f"              {publication.port} -> topic {publication.topic}", style="yellow")


def _names(streams: Iterable[Stream]) -> str:
    return ", ".join(map(str, streams))


def _summary(problem: Problem, plan: Plan, given_up: Collection[str]) -> Iterator[Text]:
    before, horizon_s = problem.environment, problem.horizon_s
    if plan.change_set is not None:
        changes = plan.change_set
        kept = len(before.units) - len(changes.stopped) - len(changes.rewired)
        spares = sum(unit.standby for unit in changes.started)
        ready = f"{spares} to make ready, " if spares else ""
        yield Text(
            f"Update: {len(changes.started) - spares} to start, {ready}{len(changes.rewired)} to rewire, "
            f"{len(changes.stopped)} to stop, {kept} kept as they are.",
            style="bold",
        )
        after, library, place_of = before.update(changes), before.transformation, before.place_of
        now = sum(
            keep_cost_us(library[u.transformation], horizon_s, place_of(u))
            for u in before.units
            if u.transformation in library and not u.standby
        )
        assert plan.cost_us is not None
        parts = cost_parts(problem, after.units)
        cost = f"{cpu(parts.total_us)} of CPU = {_terms(parts)}"
        if parts.total_us != plan.cost_us:
            cost = f"{cost}, but {plan.planner} says {cpu(plan.cost_us)}"
        running = f"The running configuration costs {cpu(now)} of upkeep."
        yield Text(f"Cost over the horizon of {horizon_s} s: {cost}. {running}")
        yield from fleet_lines(problem, after)
        if plan.objectives:
            told = ", ".join(
                f"{amount(m.objective, m.value)}{'' if m.is_proven else ' (open)'}" for m in plan.objectives
            )
            yield Text(f"Minimised, in this order: {told}.")
    yield verdict(problem, plan)
    if not given_up and (told := nothing_wanted(before)):
        yield Text(told, style="bold yellow")
    yield from undecided_lines(problem, plan)
    if plan.change_set is not None and given_up:
        yield Text(f"Given up: {len(given_up)} of {len(before.targets) + len(given_up)} targets.", style="bold yellow")
    unmet, stopped = _told_reasons(plan, given_up)
    yield from (Text(f"  {shared.text}") for shared in unmet)
    yield from (Text(f"Stopped, though pinned: {each.text}.", style="bold yellow") for each in stopped)
    for label in plan.unused_required:
        yield Text(f"Required {label} is not used: {why_unused(plan)}.", style="yellow")


def _told_reasons(plan: Plan, given_up: Collection[str]) -> tuple[list[SharedReason], list[SharedReason]]:
    """Return why targets are not met, and why pinned units are stopped."""
    of_units = {name for name in plan.reasons if plan.change_set is not None and name not in given_up}
    unmet = {name: why for name, why in plan.reasons.items() if name not in of_units}
    stopped = [each for name in plan.reasons if name in of_units for each in shared_reasons({name: plan.reasons[name]})]
    return shared_reasons(unmet), stopped


def told_left_out(plan: Plan, given_up: Collection[str]) -> frozenset[str]:
    """Return the transformations that `update_text` names as left out."""
    return frozenset[str]().union(*(each.left_out for some in _told_reasons(plan, given_up) for each in some))


def nothing_wanted(environment: Environment) -> str:
    """Return a hint that `targets:` may be missing; empty if the environment wants something to run."""
    if environment.targets or any(one.min_instances for one in environment.library):
        return ""
    return "The environment has no targets, so no unit needs to run. Is `targets:` missing?"


def undecided_lines(problem: Problem, plan: Plan) -> Iterator[Text]:
    """Yield the pairs of tags that an answer depends on, with their ports, and how many pairs were asked about."""
    outputs, demands = problem.environment.outputs, problem.environment.demands
    for offered, demanded in plan.undecided[:MOST_OPEN_PAIRS]:
        ways = (
            ", ".join([name for name, tag in ports.items() if tag == one][:MOST_NAMES])
            for ports, one in ((outputs, offered), (demands, demanded))
        )
        yield Text(f"Not decided: whether `{offered}` is `{demanded}` ({' -> '.join(ways)}).", style="yellow")
    if len(plan.undecided) > MOST_OPEN_PAIRS:
        yield Text(f"  ... nor are {len(plan.undecided) - MOST_OPEN_PAIRS} further pairs.", style="yellow")
    if plan.undecided:
        yield Text(f"If so, an update for {cpu(plan.bound_us)} may exist.", style="yellow")
    if asked := plan.counts.get("pairs asked"):
        pairs = counted(asked, "pair")
        yield Text(f"HermiT was asked about {pairs} of tags. Decided: {decided_by(plan.counts)}.", style="dim")


def why_unused(plan: Plan) -> str:
    """Why a plan leaves required transformations unused, as far as it is known."""
    if plan.required_proven:
        return "no valid configuration can use it with the others"
    if plan.planner in IGNORING_REQUIRED:
        return f"{plan.planner} does not support `required`"
    return "no plan that uses it was found in time"


def verdict(problem: Problem, plan: Plan) -> Text:
    """How a planner ended, in a sentence."""
    match plan.status:
        case Status.OPTIMAL if not plan.change_set:
            return Text(f"Optimal: nothing to change, proven by {plan.planner}.", style="bold green")
        case Status.OPTIMAL:
            ties = "" if plan.ties_proven else "; another of this cost may rewire or start fewer units"
            better = "better in this order" if plan.objectives else "cheaper"
            return Text(f"Optimal: no update is {better}, proven by {plan.planner}{ties}.", style="bold green")
        case Status.FEASIBLE:
            first = next((one for one in plan.measured if not one.is_proven), plan.measured[-1])
            bound = f"no update costs less than {amount(first.objective, first.bound)}, a gap of {plan.gap:.1%}"
            proven = bound if first.bound else "it has no bound on the optimum"
            if first.bound and first.is_proven and not plan.required_proven:
                proven = "another may use more of what is required"
            return Text(f"Feasible: {plan.planner} has not proven it optimal; {proven}.", style="bold yellow")
        case Status.INFEASIBLE:
            what = "these targets can't be met by any configuration"
            if not problem.environment.targets:
                what = "no configuration is valid, not even without any target"
            return Text(f"No plan: {what}.", style="bold red")
        case Status.TOO_EXPENSIVE:
            dear = f"any update costs at least {cpu(plan.bound_us)}, if one exists at all"
            if plan.cost_us is not None:
                dear = f"the cheapest update costs {cpu(plan.cost_us)}"
            allowed = cpu(problem.max_cost_us or 0)
            return Text(f"No plan within the largest cost: {dear}, but {allowed} is allowed.", style="bold red")
        case Status.UNKNOWN:
            return Text(
                f"No answer: {plan.planner} stopped without a plan and without a proof that there is none.",
                style="bold yellow",
            )


def _terms(parts: CostParts) -> str:
    """Return the parts of a cost as a sum: labor, upkeep, and every other part that is not 0."""
    named = {"transfers": parts.transfer_us, "cold spares": parts.standby_us, "quality missed": parts.quality_us}
    named |= {"rent": parts.rent_us, "optional inputs unfed": parts.unfed_us}
    more = [f"{name} {cpu(cost_us)}" for name, cost_us in named.items() if cost_us]
    return " + ".join([f"labor {cpu(parts.labor_us)}", f"upkeep {cpu(parts.upkeep_us)}", *more])


MOST_TRANSFERS = 10
"""The most transfers listed; if more, only their number is shown."""


def fleet_lines(problem: Problem, after: Environment) -> Iterator[Text]:
    """Yield a configuration's qualities, and loads of hosts and links; nothing for a problem as in the paper."""
    if problem.is_plain:
        return
    yield from _qualities(after)
    yield from _hosts(problem, after)
    if problem.survive is not None:
        kinds = "unit or host" if problem.survive is Failures.HOSTS else "unit"
        yield Text(f"No failure of a single {kinds} leaves a target without a stream.")


def _qualities(after: Environment) -> Iterator[Text]:
    reached = told_qualities(after, after.units)
    for target in after.targets:
        values = [_reached(after, target, name, value) for name, value in reached.get(target.label, {}).items()]
        if values:
            yield Text(f"Target {target.label}: {', '.join(values)}.")


def _reached(environment: Environment, target: Target, name: str, value: int) -> str:
    attribute = environment.quality[name]
    wish = next((wish for wish in target.quality if wish.attribute == name), Wish(name))
    side = "at most" if attribute.better is Better.LOWER else "at least"
    asked = "" if wish.bound is None else f" ({side} {attribute.shown(wish.bound)} is asked)"
    return f"{name} {attribute.shown(value)}{asked}"


def _amount(host: Host, resource: str, taken: int, horizon_s: int) -> str:
    """Return the use of a resource and its limit: `9 % of a core (limit 40 %)`, `300 of 500 MB`, `1 of 2 gpu`."""
    room = host.room(resource, horizon_s)
    if resource == CPU:
        limit = "" if room is None else f" (limit {short_core_share(room)})"
        return f"{core_share(taken)}{limit}"
    unit = {MEMORY: "MB", POWER: "W"}.get(resource, resource)
    return f"{taken}{'' if room is None else f' of {room}'} {unit}"


def _hosts(problem: Problem, after: Environment) -> Iterator[Text]:
    number = Counter(unit.host for unit in after.units)
    for name, load in loads(after, after.units).items():
        host = after.host[name]
        resources = dict.fromkeys([*load, *host.offers]) if number[name] else ()
        amounts = [_amount(host, resource, load[resource], problem.horizon_s) for resource in resources]
        if amounts:
            yield Text(f"Host {name}: {', '.join([counted(number[name], 'unit'), *amounts])}.")
    if empty := [host.name for host in after.hosts if not number[host.name]]:
        yield Text(f"No unit on {', '.join(empty)}.")
    for link, carried in link_loads(problem, after.units).items():
        limit = "" if link.bandwidth is None else f" of {link.bandwidth}"
        yield Text(f"Link {' - '.join(link.between)}: {carried}{limit} bytes/s.")
    journeys = transfers(problem, after.units)
    if journeys:
        yield Text("Streams from host to host:")
    for transfer in journeys[:MOST_TRANSFERS]:
        dear = f", {cpu(transfer.cost_us)}" if transfer.cost_us else ""
        yield Text(f"  {transfer.stream}: {transfer.origin} -> {transfer.to}{dear}", style="dim")
    if len(journeys) > MOST_TRANSFERS:
        yield Text(f"  ... and {len(journeys) - MOST_TRANSFERS} more transfers", style="dim")
