"""A problem as plain JSON data, for the way into another process, without what only running or hosts need."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from cfgplan.domain import (
    ComputationUnit,
    Environment,
    InputPort,
    OutputPort,
    Publication,
    Similarity,
    Stream,
    Subscription,
    Target,
    Transformation,
)
from cfgplan.planning import Problem, refuse_notions


def document(problem: Problem) -> dict[str, Any]:
    """The problem as data; `restored` is the way back. Raises InputError if it asks more than the paper."""
    from cfgplan.formats.environment_file import later_fields
    from cfgplan.formats.fields import OutputPart, TargetPart, TransformationPart

    refuse_notions(problem, "a comparison with other planners")
    environment = problem.environment
    return {
        "units": [
            {
                "id": unit.id,
                "transformation": unit.transformation,
                "feeds": {s.port: [s.stream.unit, s.stream.port] for s in unit.subscriptions},
                "topics": [[p.port, p.topic] for p in unit.publications],
            }
            for unit in environment.units
        ],
        "library": [
            {
                "label": t.label,
                "inputs": [asdict(port) for port in t.inputs],
                "outputs": [
                    {"name": port.name, "tag": port.tag} | later_fields(OutputPart, port) for port in t.outputs
                ],
                "labor_us": t.labor_us,
                "upkeep_us": t.upkeep_us,
                "pinned": t.pinned,
                "required": t.required,
            }
            | later_fields(TransformationPart, t)
            for t in environment.library
        ],
        "targets": [
            {"label": t.label, "tag": t.tag, "topic": t.topic, "priority": t.priority} | later_fields(TargetPart, t)
            for t in environment.targets
        ],
        "offers": {tag: sorted(offered) for tag, offered in sorted(problem.similarity.offers.items())},
        "horizon_s": problem.horizon_s,
        "max_cost_us": problem.max_cost_us,
    }


def restored(data: dict[str, Any]) -> Problem:
    """The problem that `document` described."""
    units = tuple(
        ComputationUnit(
            unit["id"],
            unit["transformation"],
            tuple(Subscription(port, Stream(*stream)) for port, stream in unit["feeds"].items()),
            tuple(Publication(*topic) for topic in unit["topics"]),
        )
        for unit in data["units"]
    )
    library = tuple(
        Transformation(
            **{
                **transformation,
                "inputs": tuple(InputPort(**port) for port in transformation["inputs"]),
                "outputs": tuple(OutputPort(**port) for port in transformation["outputs"]),
            }
        )
        for transformation in data["library"]
    )
    targets = tuple(Target(**target) for target in data["targets"])
    similarity = Similarity({tag: frozenset(offered) for tag, offered in data["offers"].items()})
    return Problem(Environment(units, library, targets), similarity, data["horizon_s"], data["max_cost_us"])
