"""Computers on which units run, and the network links between them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated

from cfgplan.arguments import AtLeast, Natural, checked
from cfgplan.canonical import store_resources, store_sorted
from cfgplan.errors import InvalidValueError
from cfgplan.qualities import LARGEST_QUALITY, MICRO
from cfgplan.rows import FOUND, LARGEST_AMOUNT, Row
from cfgplan.selectors import check_selector, selector
from cfgplan.transformations import CPU, MEMORY, POWER

MANAGER = "manager"
"""The name of the sender of orders to a fleet's hosts; no host may have it."""


@dataclass(frozen=True)
@checked
class Host:
    """A computer, by `name`: units may take `cpu_us` microseconds of CPU time each second and `memory_mb` megabytes;
    None: no limit.

    `offers` gives the amounts of other resources as integers; a resource that is not listed has amount 0. A unit takes
    the CPU time of its transformation divided by `speed`, which is in millionths. Selectors choose a host by its name
    and its `labels`. It costs `rent_us` each second, at any speed, as long as it has a running unit or a cold spare. It
    has `energy` (watt seconds; None: no limit) for the power that its units take over the horizon.
    """

    name: Annotated[str, Row("the name of the host; unique")]
    cpu_us: Annotated[
        Natural | None,
        Row("CPU seconds per second (cores) that its units may take together; no limit if absent", is_limit=True),
    ] = None
    memory_mb: Annotated[
        Natural | None, Row("megabytes that its units may take together; no limit if absent", is_limit=True)
    ] = None
    offers: Annotated[
        Mapping[str, Natural],
        Row("other resources that the host has: name to amount, a whole number; none of a resource that is absent"),
    ] = field(default_factory=dict, hash=False)
    speed: Annotated[
        Annotated[int, AtLeast(1)],
        Row(
            "how fast the host is: CPU seconds of labor, upkeep and standby are divided by this number there",
            form="Speed",
            below="energy",
        ),
    ] = MICRO
    labels: Annotated[
        tuple[str, ...],
        Row("words by which selectors such as `on` choose the host, besides its name; none if absent", below="name"),
    ] = ()
    rent_us: Annotated[
        Natural, Row("cost of using the host, in CPU seconds per second, while it has a unit or a spare")
    ] = 0
    energy: Annotated[
        Natural | None,
        Row(
            "watt seconds that its units may take over the horizon, computed from the watts that they state as "
            "`power` under `needs`; no limit if absent",
            most=LARGEST_AMOUNT**2,
            is_limit=True,
        ),
    ] = None

    def __post_init__(self) -> None:
        store_sorted(self, "labels", dict.fromkeys(self.labels), str)
        if self.name == MANAGER:
            raise InvalidValueError(f"no host can be called {MANAGER!r}: the manager has this name")
        store_resources(self, "offers", {CPU: "cpu_us", MEMORY: "memory_mb"})

    def fits(self, text: str) -> bool:
        """Whether a selector, an expression over labels, chooses the host. Raises TagError."""
        return selector(text)((self.name, *self.labels))

    def room(self, resource: str, horizon_s: int = 0) -> int | None:
        """Return how much of `resource`, a key of `Transformation.takes`, units may take there together; None: no
        limit.

        Energy is that for a horizon of `horizon_s` seconds.
        """
        if resource in (CPU, MEMORY):
            return self.cpu_us if resource == CPU else self.memory_mb
        if resource != POWER:
            return self.offers.get(resource, 0)
        lasting = None if self.energy is None or not horizon_s else self.energy // horizon_s
        return min((most for most in (self.offers.get(POWER), lasting) if most is not None), default=None)


@dataclass(frozen=True, slots=True)
@checked
class Link:
    """A network link between the hosts that one selector fits and the hosts that the other fits, in both directions.

    All transfers over it together carry at most `bandwidth` bytes per second (None: no limit); a stream is transferred
    once to each host that needs it. A megabyte costs `price_us`; if that is None, the environment's `transfer_us`. A
    transfer adds `latency` (micro-units) to a stream's value of the quality attribute `adds`.
    """

    between: Annotated[
        tuple[str, str],
        Row("the two ends of the link: two selectors of hosts, such as `[robot, base]`", form="TwoSelectors"),
    ]
    bandwidth: Annotated[
        Natural | None,
        Row(
            "bytes per second that all streams over the link may take together; no limit if absent",
            most=LARGEST_AMOUNT**2,
            is_limit=True,
        ),
    ] = None
    price_us: Annotated[
        Natural | None, Row("CPU seconds for each megabyte sent over the link; the environment's `transfer` if absent")
    ] = None
    latency: Annotated[
        Natural,
        Row(
            "added to the quality `adds` of each stream over the link, in the unit of that quality",
            form="PositiveMicro",
        ),
    ] = 0
    adds: Annotated[
        str | None,
        Row("the quality attribute to which `latency` is added, one with `better: lower`; needed with `latency`"),
    ] = None
    is_measured: Annotated[bool, FOUND] = False
    declared: Annotated[Natural | None, FOUND] = None
    """The declared bandwidth, if the link was found to carry less."""

    def __post_init__(self) -> None:
        for text in self.between:
            check_selector(text)
        if self.latency > LARGEST_QUALITY or (self.adds is None) != (self.latency == 0):
            raise InvalidValueError("a link has a `latency` of 0 or more and names the attribute that it `adds` to")

    def joins(self, one: Host, other: Host) -> bool:
        """Whether it carries streams between two hosts."""
        first, second = self.between
        return (one.fits(first) and other.fits(second)) or (one.fits(second) and other.fits(first))
