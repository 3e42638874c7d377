"""An instance: a named problem with the family, parameters and seed that it comes from."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from inspect import signature
from typing import Any

from cfgplan.errors import InputError, InvalidValueError
from cfgplan.planning import Problem
from cfgplan.rows import planned
from experiments.families import FAMILIES


@dataclass(frozen=True)
class Instance:
    """A problem to compare planners on; `make` builds it when it is first needed."""

    name: str
    family: str
    parameters: Mapping[str, object]
    seed: int | None
    make: Callable[[], Problem] = field(compare=False, repr=False)

    @cached_property
    def problem(self) -> Problem:
        return self.make()

    @cached_property
    def text(self) -> str:
        """The problem as one line of JSON, the same for equal problems."""
        return json.dumps(
            _document(self.problem), default=str, ensure_ascii=False, sort_keys=True, separators=(",", ":")
        )

    @cached_property
    def digest(self) -> str:
        """A short hash of the problem: a result belongs to it, not to the name alone."""
        return hashlib.sha256(self.text.encode()).hexdigest()[:16]


def generated(family: str, seed: int = 0, /, **parameters: object) -> Instance:
    """An instance of a registered family. Raises InputError for an unknown one or unfit parameters."""
    if family not in FAMILIES:
        raise InputError.of(f"there is no family {family!r}", mend=f"there are {', '.join(sorted(FAMILIES))}")

    shown = ", ".join(f"{name}={value}" for name, value in parameters.items())

    def make() -> Problem:
        try:
            return FAMILIES[family](seed, **parameters)
        except InvalidValueError as error:
            raise InputError.of(f"family {family} can't be made with {shown}: {error}") from None
        except TypeError:
            _, *known = signature(FAMILIES[family]).parameters
            mend = f"it takes {', '.join(known)}"
            raise InputError.of(f"family {family} can't be made with {shown}", mend=mend) from None

    return Instance(f"{family}({shown})#{seed}", family, parameters, seed, make)


def named(name: str) -> Instance:
    """The generated instance of that name, such as `random_library(depth=8, back=0.3)#7`; the seed may be left out.

    Raises InputError.
    """
    found = re.fullmatch(r"\s*(\w+)\s*(?:\(([^()]*)\))?\s*(?:#(\d+))?\s*", name)
    pairs = [pair.split("=", 1) for pair in (found[2] or "").split(",") if pair.strip()] if found else []
    if found is None or any(len(pair) != 2 for pair in pairs):
        raise InputError.of(f"{name!r} names no instance", mend="write it as family(parameter=value, ...)#seed")
    return generated(found[1], int(found[3] or 0), **{key.strip(): _value(text.strip()) for key, text in pairs})


def _value(text: str) -> object:
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text


def given(name: str, problem: Problem, *, family: str = "own") -> Instance:
    """Return an instance of an existing problem, such as a user's own file."""
    return Instance(name, family, {}, None, lambda: problem)


def _document(problem: Problem) -> dict[str, Any]:
    """The problem as plain data, without what only running needs; one that asks more than the paper as its file."""
    from cfgplan.formats.dump import plain_environment

    environment = problem.environment
    offers = {tag: sorted(offered) for tag, offered in sorted(problem.similarity.offers.items())}
    if problem.features:
        limits = {"horizon_s": problem.horizon_s, "max_cost_us": problem.max_cost_us, "survive": problem.survive}
        return {"environment": plain_environment(environment, **limits), "offers": offers}
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
            {name: said for name, said in planned(t).items() if name != "host"}  # a problem of the paper has no hosts
            | {
                "label": t.label,
                "inputs": [
                    {"name": p.name, "tag": p.tag, "distinct": p.distinct, "feedback": p.feedback} for p in t.inputs
                ],
                "outputs": [planned(port) for port in t.outputs],
                "labor_us": t.labor_us,
                "upkeep_us": t.upkeep_us,
                "pinned": t.pinned,
                "required": t.required,
            }
            for t in environment.library
        ],
        "targets": [
            planned(t) | {"label": t.label, "tag": t.tag, "topic": t.topic, "priority": t.priority}
            for t in environment.targets
        ],
        "offers": offers,
        "horizon_s": problem.horizon_s,
        "max_cost_us": problem.max_cost_us,
    }
