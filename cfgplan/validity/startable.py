"""The transformations that can run at all, by the judge's own closure."""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Mapping

from cfgplan.domain import Environment, InputPort, Similarity, Transformation


def startable(environment: Environment, similarity: Similarity, units: Mapping[str, int] | None = None) -> set[str]:
    """Return the labels of all transformations with a unit in some valid wiring.

    More providers never hurt, so it is enough to consider all of them running at once: the largest set whose ordinary
    inputs are fed by earlier members and feedback inputs by any member. `units` limits the number of units of each; the
    `serves` limits of outputs are ignored.
    """
    providers = providers_by_tag(environment, similarity)
    candidates = set(environment.transformation)
    while True:
        grounded = _grounded(environment, providers, candidates, units)
        if grounded == candidates:
            return grounded
        candidates = grounded


def _grounded(
    environment: Environment, providers: Mapping[str, set[str]], candidates: set[str], units: Mapping[str, int] | None
) -> set[str]:
    """Return the candidates that can be fed, starting from sources; each is checked again when it may have a feeder."""
    giving: dict[str, list[str]] = defaultdict(list)
    for tag, labels in providers.items():
        for label in labels & candidates:
            giving[label].append(tag)
    taking: dict[str, list[Transformation]] = defaultdict(list)
    for label in candidates:
        for tag in {port.tag for port in environment.transformation[label].needed_inputs if not port.feedback}:
            taking[tag].append(environment.transformation[label])
    grounded: set[str] = set()
    given: set[str] = set()
    ahead = [environment.transformation[label] for label in candidates]
    for one in ahead:
        if one.label in grounded or not _can_be_fed(providers, one, grounded, candidates, units):
            continue
        grounded.add(one.label)
        for tag in giving[one.label]:
            is_first = tag not in given
            given.add(tag)
            ahead += [t for t in taking[tag] if is_first or any(_takes_several(port) for port in t.inputs)]
    return grounded


def _takes_several(port: InputPort) -> bool:
    return port.distinct is not None or port.count > 1


def _can_be_fed(
    providers: Mapping[str, set[str]],
    transformation: Transformation,
    before: set[str],
    anywhere: set[str],
    units: Mapping[str, int] | None,
) -> bool:
    choices: dict[str, dict[str, set[str]]] = defaultdict(dict)
    for port in transformation.needed_inputs:
        group = port.distinct if port.distinct is not None else f"\0{port.name}"
        allowed = anywhere if port.feedback else before
        feeding = providers.get(port.tag, set()) & allowed
        if units is not None and sum(units.get(label, 0) for label in feeding) < port.count:
            return False
        for number in range(max(port.count, 1) if port.distinct is not None else 1):
            choices[group][f"{port.name}\0{number}"] = feeding
    return all(different_choices_exist(group) for group in choices.values())


def providers_by_tag(environment: Environment, similarity: Similarity) -> dict[str, set[str]]:
    """Return, for each demanded tag, the transformations with a matching output, or those that a target wants
    to run.
    """
    offering: dict[str, set[str]] = defaultdict(set)
    for transformation in environment.library:
        for port in transformation.outputs:
            offering[port.tag].add(transformation.label)
    to_run = [target for target in environment.targets if target.run in environment.transformation]
    wanted = {target.tag: {target.run or ""} for target in to_run}
    matching = {
        demanded: {label for tag in offered for label in offering.get(tag, ())}
        for demanded, offered in similarity.offers.items()
    }
    return {**matching, **wanted}


def different_choices_exist(choices: Mapping[str, set[str]]) -> bool:
    """Whether each port can have a feeder of its own (a matching, by shortest augmenting paths)."""
    feeder_of: dict[str, str] = {}
    port_of: dict[str, str] = {}
    for port in choices:
        reached_from: dict[str, str] = {}
        free = None
        ahead = deque([port])
        while ahead and free is None:
            one = ahead.popleft()
            for feeder in choices[one] - reached_from.keys():
                reached_from[feeder] = one
                if feeder not in port_of:
                    free = feeder
                    break
                ahead.append(port_of[feeder])
        if free is None:
            return False
        while free is not None:
            one = reached_from[free]
            port_of[free] = one
            feeder_of[one], free = free, feeder_of.get(one)
    return True
