"""The rules of inputs that start nothing, and of outputs that serve only so many."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterator
from typing import TYPE_CHECKING, Final

from cfgplan.domain import ALL, ComputationUnit, InputPort, Stream
from cfgplan.onward import reached
from cfgplan.planners.exact.rule import CheckedUnits, Rule
from cfgplan.planners.exact.targets import needed_literals
from cfgplan.planning import Feature

if TYPE_CHECKING:
    from ortools.sat.python.cp_model import IntVar

    from cfgplan.planners.exact.model import Model


def a_stream_serves_no_more_than_it_may(model: Model) -> None:
    for stream, most in model.serves.items():
        taking = _taking(model, stream)
        if len(taking) > most or model.is_grouped:
            streams = model.number[model.unit_of(stream)] if model.is_grouped else 1
            model.cp.add(model.total(taking) <= most * streams)


def _taking(model: Model, stream: Stream) -> list[IntVar]:
    """How many inputs and topics take a stream that serves only so many: of named units, a boolean for each."""
    choices = [*model.connects.values(), *model.takes.values(), *model.publishes.values()]
    return [choice[stream] for choice in choices if stream in choice]


def an_idle_input_is_fed_by_needed_units(model: Model) -> None:
    """Feeders of such an input are needed by others. They don't spend limited streams on units that are not needed."""
    if not model.idle_feeders:
        return
    candidates, needed = model.candidates, needed_literals(model)
    for (unit, name), connects in model.connects.items():
        is_idle = name in candidates.all[unit].transformation.idle_inputs
        for stream, connected in connects.items():
            if is_idle:
                model.cp.add_implication(connected, needed[model.unit_of(stream)])
            if stream in model.serves and model.unit_of(stream) in model.idle_feeders:
                model.cp.add_implication(connected, needed[unit])


def an_idle_input_is_fed_if_possible(model: Model) -> None:
    """It is unfed only where too few units run that may feed it: others depend on its unit, or are not distinct."""
    candidates = model.candidates.all
    for (unit, name), fed in list(model.is_fed.items()):
        port = candidates[unit].transformation.input[name]
        if not port.starts_nothing or port.count == ALL:
            continue
        free: dict[int | str, IntVar] = {}
        below = {} if port.feedback else _below(model, unit, port)
        for stream in model.connects[unit, name]:
            feeder = model.unit_of(stream)
            label = candidates[feeder].transformation.label
            key = feeder if port.distinct is None else label
            barred = [below[feeder]] if feeder in below else []
            barred += [c for s, c in _of_group(model, unit, port) if model.candidates.label_of(s) == label]
            if stream in model.serves:
                barred.append(full := model.boolean())
                model.cp.add(model.total(_taking(model, stream)) >= model.serves[stream]).only_enforce_if(full)
            is_free = free[key] if key in free else model.boolean()
            free[key] = is_free
            model.cp.add_bool_or([is_free, model.runs[unit].negated(), model.runs[feeder].negated(), *barred])
        unfed = [fed.negated(), model.runs[unit]]
        model.cp.add(model.total(list(free.values())) < port.count).only_enforce_if(unfed)


def _of_group(model: Model, unit: int, port: InputPort) -> list[tuple[Stream, IntVar]]:
    """The streams that may feed other inputs of a distinct input's group, each with the boolean that it does."""
    others = [] if port.distinct is None else model.candidates.all[unit].transformation.inputs
    names = [other.name for other in others if other.distinct == port.distinct and other != port]
    return [entry for name in names for entry in model.connects[unit, name].items()]


def _below(model: Model, unit: int, port: InputPort) -> dict[int, IntVar]:
    """For each unit that may depend on a unit, and feed its input, and those between: a boolean that it does depend."""
    candidates = model.candidates.all
    ways: dict[int, list[tuple[int, IntVar]]] = defaultdict(list)
    readers: dict[int, set[int]] = defaultdict(set)
    for (reader, name), connects in model.connects.items():
        for stream, connected in connects.items() if not candidates[reader].transformation.input[name].feedback else ():
            readers[model.unit_of(stream)].add(reader)
            ways[reader].append((model.unit_of(stream), connected))
    _, *below = reached([unit], lambda here: sorted(readers[here]))
    found = {reader: model.boolean() for reader in below}
    if found.keys().isdisjoint(model.candidates.feeders(port.tag)):
        return {}
    for reader, depends in found.items():
        choices = [connected for feeder, connected in ways[reader] if feeder == unit]
        for feeder, connected in ways[reader]:
            if feeder in found:
                choices.append(model.only_if(connected, found[feeder]))
        model.needs_any(depends, choices)
    return found


def _overtaken(checked: CheckedUnits) -> Iterator[str]:
    if any(number < 0 for number in checked.left_to_serve.values()):
        yield "too many take a stream"


def _incomplete(checked: CheckedUnits) -> Iterator[str]:
    """Yield inputs that do not take all that they must."""
    for unit, port in _of_running(checked):
        if port.count == ALL:
            there = {stream for stream in checked.offers(port.tag) if stream.unit != unit.id}
            if not there.issubset(unit.feeds.get(port.name, ())):
                yield f"input {port.name} of unit {unit.id} takes not all that there is"


def _unfed(checked: CheckedUnits) -> Iterator[str]:
    """Yield inputs that start nothing, and are not fed although enough streams are free."""
    for unit, port in _of_running(checked):
        is_unfed = port.starts_nothing and port.count != ALL and port.name not in unit.feeds
        if is_unfed and len(_free(checked, unit, port)) >= port.count:
            yield f"input {port.name} of unit {unit.id} is not fed, but could be"


def _of_running(checked: CheckedUnits) -> Iterator[tuple[ComputationUnit, InputPort]]:
    for unit in checked.hot.values():
        for port in checked.kind(unit).inputs:
            yield unit, port


def _free(checked: CheckedUnits, unit: ComputationUnit, port: InputPort) -> Collection[str]:
    """Return the units with a stream that may feed an input; for a distinct input, the transformations."""
    barred = set() if port.feedback else {*reached([unit.id], lambda here: checked.readers.get(here, ()))}
    group = [p.name for p in checked.kind(unit).inputs if p.distinct is not None and p.distinct == port.distinct]
    taken = {checked.hot[s.unit].transformation for name in group for s in unit.feeds.get(name, ())}
    found = set()
    for stream in checked.offers(port.tag):
        label = checked.hot[stream.unit].transformation
        if stream.unit not in barred and checked.left_to_serve.get(stream, 1) > 0 and label not in taken:
            found.add(stream.unit if port.distinct is None else label)
    return found


IDLE: Final = (
    Rule(a_stream_serves_no_more_than_it_may, Feature.LIMITS, _overtaken),
    Rule(None, Feature.COUNTS, _incomplete),
    Rule(an_idle_input_is_fed_by_needed_units, Feature.OPTIONAL),
    Rule(an_idle_input_is_fed_if_possible, Feature.OPTIONAL, _unfed),
)
