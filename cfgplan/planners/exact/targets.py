"""The rules of targets: each is met by one stream or unit, and it is known which units serve one."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Final

from cfgplan.domain import Stream
from cfgplan.onward import grouped
from cfgplan.planners.exact.rule import CheckedUnits, Rule
from cfgplan.planning import Feature

if TYPE_CHECKING:
    from ortools.sat.python.cp_model import IntVar, LiteralT

    from cfgplan.planners.exact.model import Model


def a_target_is_published_by_one_unit(model: Model) -> None:
    """Each target is published by exactly one unit; a staying unit publishes exactly its previous targets."""
    for target in model.environment.stream_targets:
        choices = model.publishes[target.label] = {}
        others: list[IntVar] = []
        for stream in model.choices(target.tag):
            feeder = model.unit_of(stream)
            running = model.candidates.all[feeder].running
            is_explicit = model.is_apart or model.is_grouped or target.quality or stream in model.serves
            if not is_explicit and feeder not in model.tracked and running is None:
                others += model.ways(stream, target.host)
                continue
            publishes = choices[stream] = model.boolean()
            model.rests_on_all(publishes, [model.present(stream, target.host)])
            if running is not None and feeder in model.stays:
                keeps = any(
                    p.topic == target.topic and (p.port == stream.port or not model.tells_ports)
                    for p in running.publications
                )
                model.cp.add_implication(model.stays[feeder], publishes if keeps else publishes.negated())
        publishers = list(choices.values())
        if others:
            publishers.append(model.boolean())
            model.rests_on_any(publishers[-1], others)
        met = model.boolean()
        model.rests_on_any(met, publishers)
        model.cp.add_exactly_one(publishers)
        model.cp.add(met == 1)


def _unmet_targets(checked: CheckedUnits) -> Iterator[str]:
    published = sorted([p.topic for unit in checked.units for p in unit.publications])
    if published != sorted([target.topic for target in checked.environment.stream_targets]):
        yield "not every target has one stream"


def a_unit_of_each_wanted_transformation_runs(model: Model) -> None:
    """Some unit of each wanted transformation runs. If feeders matter, the first running one gets a boolean."""
    for target, label in model.environment.wanted_to_run.items():
        running = [(i, model.runs[i]) for i in model.to_run(label)]
        met = model.boolean()
        model.rests_on_any(met, [runs for _, runs in running])
        model.cp.add(met == 1)
        choices = model.publishes[target] = {}
        for number, (i, runs) in enumerate(running):
            if i not in model.tracked:
                continue
            earlier = [before.negated() for _, before in running[:number]]
            choices[Stream(model.candidates.all[i].id, "")] = model.only_if(runs, *earlier)


def _missing_wanted(checked: CheckedUnits) -> Iterator[str]:
    if not checked.running.keys() >= {*checked.environment.wanted_to_run.values()}:
        yield "a target wants a unit that does not run"


def required_transformations_serve_a_target(model: Model) -> None:
    candidates = model.candidates
    if not model.environment.required:
        return
    serving_units = [(candidates.all[i].transformation, serves) for i, serves in serving_literals(model).items()]
    for label, serving in grouped((t.label, serves) for t, serves in serving_units if t.required).items():
        model.uses_required[label] = model.boolean()
        model.needs_any(model.uses_required[label], serving)


def units_that_could_keep_each_other_are_needed(model: Model) -> None:
    needed = needed_literals(model) if model.keeping_each_other else {}
    for i in sorted(model.keeping_each_other & model.runs.keys()):
        model.cp.add_implication(model.runs[i], needed[i])


def needed_literals(model: Model) -> Mapping[int, IntVar]:
    """The boolean of each tracked unit that it is needed: by a target, a pin, a number, a failure, or a needed unit."""
    if model.needed:
        return model.needed
    candidates = model.candidates
    roots: dict[int, list[IntVar]] = defaultdict(list)
    for i in sorted(model.tracked):
        if candidates.is_pinned(i):
            roots[i].append(model.runs[i])
    for t in model.environment.library:
        running = {i: model.runs[i] for i in model.running(t.label)} if t.min_instances else {}
        for i, asked in [(i, model.only_if(runs)) for i, runs in running.items()]:
            model.cp.add(model.total([*running.values()]) <= t.min_instances).only_enforce_if(asked)
            roots[i].append(asked)
    for i in sorted(model.tracked & model.runs.keys()) if model.problem.survive is not None else ():
        model.spares[i] = model.only_if(model.runs[i])
        roots[i].append(model.spares[i])
    model.needed.update(serving_literals(model, roots))
    return model.needed


def serving_literals(model: Model, roots: Mapping[int, Sequence[IntVar]] | None = None) -> dict[int, IntVar]:
    """For each tracked unit a boolean that it serves a target: it publishes one, or feeds a unit that serves one.

    With `roots`, a unit serves also where its literals there say so, and where one that serves can't run without it.
    The distance to the target grows along the way; else two units could serve through each other's feedback inputs.
    """
    candidates = model.candidates
    tracked = sorted(model.tracked)
    distance = {i: model.cp.new_int_var(0, len(tracked), "") for i in tracked}
    ways: dict[int, list[IntVar]] = {i: [*(roots or {}).get(i, ())] for i in tracked}
    serving = {i: model.boolean() for i in tracked}
    for choices in model.publishes.values():
        for stream, publishes in choices.items():
            if model.unit_of(stream) in ways:
                ways[model.unit_of(stream)].append(publishes)
    for (consumer, name), choices in candidates.clock.each(model.connects.items()):
        is_reason = consumer in ways and name not in candidates.all[consumer].transformation.idle_inputs
        for stream, connected in choices.items() if is_reason else ():
            feeder = model.unit_of(stream)
            if feeder in ways:
                ways[feeder].append(through := model.only_if(connected, serving[consumer]))
                model.cp.add(distance[feeder] > distance[consumer]).only_enforce_if(through)
    for user, alone, both_run in _company(model) if roots is not None else ():
        if user in ways and alone in ways:
            ways[alone].append(through := model.only_if(*both_run, serving[user]))
            model.cp.add(distance[alone] > distance[user]).only_enforce_if(through)
    for i, choices_of in ways.items():
        model.needs_any(serving[i], choices_of)
    return serving


def _company(model: Model) -> Iterator[tuple[int, int, list[LiteralT]]]:
    """Each unit, one that it may run with on a host, and the literals that both run there, the latter alone of its
    transformation.
    """
    for user, places in model.runs_on.items():
        for label in model.candidates.all[user].transformation.beside:
            units = model.running(label)
            for host, runs in places.items():
                there = {i: model.runs_on[i][host] for i in units if host in model.runs_on[i]}
                for alone in sorted(there.keys() - {user}):
                    others = (other.negated() for i, other in there.items() if i != alone)
                    yield user, alone, [runs, there[alone], *others]


MET: Final = (
    Rule(a_target_is_published_by_one_unit, flaws=_unmet_targets),
    Rule(a_unit_of_each_wanted_transformation_runs, Feature.RUNS, _missing_wanted),
)
REQUIRED: Final = Rule(required_transformations_serve_a_target)
NEEDED: Final = Rule(units_that_could_keep_each_other_are_needed)
