"""The limits of an environment that prevent every plan: a minimal set of them."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, Final, TypeVar

from cfgplan.domain import Environment, Host, InputPort, Link, OutputPort, Target, Transformation
from cfgplan.planning import Problem
from cfgplan.rows import limits

T = TypeVar("T")


@dataclass(frozen=True, order=True)
class Limit:
    """A field of the environment file that can only rule out plans: the `key` of a part, given by its kind and name.

    The name is empty for the environment itself.
    """

    kind: str
    name: str
    key: str

    def __str__(self) -> str:
        return f"`{self.key}` of {self.kind} {self.name}".rstrip()


_KINDS: Final[Mapping[str, type[Any]]] = MappingProxyType(
    {
        "transformation": Transformation,
        "input": InputPort,
        "output": OutputPort,
        "host": Host,
        "link": Link,
        "target": Target,
        "the environment": Problem,
    }
)


def limits_of(problem: Problem) -> list[Limit]:
    """All limits that a problem sets, in order."""
    found: list[Limit] = []

    def note(kind: str, name: str, part: T) -> T:
        said = (key for key, each in limits(_KINDS[kind]).items() if getattr(part, each.name) != each.default)
        found.extend(Limit(kind, name, key) for key in said)
        return part

    _changed(problem, note)
    return sorted(found)


def without_limits(problem: Problem, lifting: Collection[Limit]) -> Problem:
    """The problem with some of its limits lifted."""

    def lift(kind: str, name: str, part: Any) -> Any:
        known = limits(_KINDS[kind]).items()
        lifted = {each.name: each.default for key, each in known if Limit(kind, name, key) in lifting}
        return replace(part, **lifted) if lifted else part

    return _changed(problem, lift)


def in_the_way(problem: Problem, is_refused: Callable[[Problem], bool]) -> tuple[Limit, ...]:
    """Return a minimal set of limits that already rule out every plan; empty if no plan exists even without limits.

    `is_refused` is called for few problems if the set is small (QuickXplain; Junker, AAAI 2004).
    """
    everything = limits_of(problem)

    def fails(kept: Sequence[Limit]) -> bool:
        return is_refused(without_limits(problem, {*everything}.difference(kept)))

    def least(kept: list[Limit], is_more: bool, ahead: list[Limit]) -> list[Limit]:
        """The limits in `ahead` that a minimal set has beside `kept`, to which `is_more` was added since `fails`."""
        if is_more and fails(kept):
            return []
        if len(ahead) == 1:
            return ahead
        first, rest = ahead[: len(ahead) // 2], ahead[len(ahead) // 2 :]
        second = least([*kept, *first], True, rest)
        return [*least([*kept, *second], bool(second), first), *second]

    return tuple(sorted(least([], True, everything))) if everything and fails(everything) else ()


def _changed(problem: Problem, change: Callable[[str, str, Any], Any]) -> Problem:
    """The problem with each part that may set limits changed, by its kind and name."""
    problem = change("the environment", "", problem)
    return replace(problem, environment=_with_parts_changed(problem.environment, change))


def _with_parts_changed(environment: Environment, change: Callable[[str, str, Any], Any]) -> Environment:
    library = (
        replace(
            t,
            inputs=tuple(change("input", f"{t.label}/{port.name}", port) for port in t.inputs),
            outputs=tuple(change("output", f"{t.label}/{port.name}", port) for port in t.outputs),
        )
        for t in environment.library
    )
    return replace(
        environment,
        library=tuple(change("transformation", t.label, t) for t in library),
        hosts=tuple(change("host", host.name, host) for host in environment.hosts),
        links=tuple(change("link", " - ".join(link.between), link) for link in environment.links),
        targets=tuple(change("target", target.label, target) for target in environment.targets),
    )
