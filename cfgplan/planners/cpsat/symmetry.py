"""Of new units alike a cheapest plan has one: rules that the model does not need, but that shorten its proof.

Why that is so, see `closing.alike`.
"""

from __future__ import annotations

from collections import defaultdict

from cfgplan.planners.cpsat.model import Model


def one_of_those_alike_is_enough(model: Model) -> None:
    """Of new units that meet the same demands one runs, and those that need something need it together.

    Where transformations are required two of them may be wanted.
    """
    if model.tracked:
        return
    site = model.site
    ports = [port for candidate in site.candidates for port in candidate.transformation.inputs]
    demands = {site.feeders(tag) for tag in (*(p.tag for p in ports), *(t.tag for t in site.environment.targets))}
    given: dict[int, list[tuple[int, ...]]] = defaultdict(list)
    for feeders in sorted(demands):
        for feeder in feeders:
            given[feeder].append(feeders)
    apart = {feeder for port in ports if port.distinct is not None for feeder in site.feeders(port.tag)}
    groups: dict[tuple[tuple[int, ...], ...], list[int]] = defaultdict(list)
    for unit, candidate in enumerate(site.candidates):
        if candidate.running is None and unit not in apart:
            groups[tuple(given[unit])].append(unit)
    for units in groups.values():
        if len(units) > 1:
            model.cp.add_at_most_one(model.runs[unit] for unit in units)
            _needs_are_shared(model, units)


def _needs_are_shared(model: Model, units: list[int]) -> None:
    needing: dict[int, list[int]] = defaultdict(list)
    for unit in units:
        for hub in sorted(_hubs(model, unit)):
            needing[hub].append(unit)
    for hub, sharing in needing.items():
        if len(sharing) > 1:
            model.cp.add_at_most_one([model.literals[hub].negated(), *(model.runs[unit] for unit in sharing)])


def _hubs(model: Model, unit: int) -> set[int]:
    """The hubs through which a new unit is fed."""
    ports = model.site.candidates[unit].transformation.inputs
    return {model.hub(port.tag).index for port in ports if not port.feedback and not model.is_explicit(unit, port)}
