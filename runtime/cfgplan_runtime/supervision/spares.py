"""Cold spares: units of a configuration that do not run, but are prepared, so that others start sooner."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import inf

from cfgplan.domain import Environment, Transformation
from cfgplan_runtime.children.messages import UnitOrder
from cfgplan_runtime.children.unit_order import unit_order
from cfgplan_runtime.supervision.backend import Backend
from cfgplan_runtime.supervision.delays import doubling_s
from cfgplan_runtime.supervision.events import SpareLost, SparePrepared

MEGABYTE = 1 << 20
_PUT_OFF_S, _MOST_PUT_OFF_S, _WELL_S = 1.0, 300.0, 60.0
"""Seconds until a spare that was lost twice in a row is prepared again, doubled for each further loss up to the second
value. A loss later than the third value after the preparation counts as the first.
"""


@dataclass(slots=True)
class _ColdSpare:
    """A cold spare. `order` has everything that its process depends on; costs and tags of its transformation do not
    matter.
    """

    transformation: Transformation
    host: str | None
    order: UnitOrder
    is_asked: bool = False
    """Whether the backend was asked to prepare it, and has not lost it since."""
    prepared: SparePrepared | None = None
    prepared_s: float = 0.0
    losses: int = 0
    """How often in a row it was lost."""
    due_s: float = -inf
    """When it is to be prepared, unless it is."""


class Spares:
    """Lets a backend prepare the cold spares of the configuration, one process for each. Times are in seconds."""

    def __init__(self, backend: Backend) -> None:
        self._backend = backend
        self._spares: dict[str, _ColdSpare] = {}

    @property
    def prepared(self) -> list[SparePrepared]:
        """The figures of the prepared spares, sorted by their ids."""
        return [spare.prepared for _, spare in sorted(self._spares.items()) if spare.prepared is not None]

    def adopt(self, environment: Environment, labor_us: Mapping[str, int], now_s: float) -> None:
        """Continue with spares of an earlier supervisor. Spares in `labor_us` are prepared."""
        self._spares = _spares(environment)
        for spare in self._spares.values():
            spare.is_asked = True
        for unit in self._spares.keys() & labor_us.keys():
            self.note_prepared(SparePrepared(unit, labor_us[unit]), now_s)

    def keep(self, environment: Environment, now_s: float) -> None:
        """Prepare the cold spares of a configuration, and discard all others."""
        wanted = _spares(environment)
        for unit, spare in list(self._spares.items()):
            if unit not in wanted or (wanted[unit].order, wanted[unit].host) != (spare.order, spare.host):
                del self._spares[unit]
                self._backend.discard(unit)
        self._spares = wanted | self._spares
        self._prepare(now_s)

    def watch(self, now_s: float) -> list[SpareLost]:
        """End spares that have grown too large, and prepare those that are due. Returns the ended ones."""
        ended = []
        for unit, spare in self._spares.items():
            most_mb = spare.transformation.run.memory_mb
            usage = None if most_mb is None or spare.prepared is None else self._backend.usage(unit)
            if most_mb is not None and usage is not None and usage.memory_bytes > most_mb * MEGABYTE:
                self._backend.discard(unit)
                self.note_loss(unit, now_s)
                ended.append(SpareLost(unit, f"uses {usage.memory_bytes // MEGABYTE} MB, and may use {most_mb}"))
        self._prepare(now_s)
        return ended

    def take(self, transformation: Transformation, host: str | None) -> str | None:
        """Remove and return a spare that a new unit can start in, preferably a prepared one; None without one."""
        order = unit_order("", transformation, None)
        fit = [unit for unit, one in self._spares.items() if one.is_asked and (one.order, one.host) == (order, host)]
        taken = min(fit, key=lambda unit: (self._spares[unit].prepared is None, unit), default=None)
        if taken is not None:
            del self._spares[taken]
        return taken

    def note_prepared(self, prepared: SparePrepared, now_s: float) -> bool:
        """Note that a spare is prepared. Returns whether it is still wanted."""
        spare = self._spares.get(prepared.unit)
        if spare is not None:
            spare.prepared, spare.prepared_s = prepared, now_s
        return spare is not None

    def note_loss(self, unit: str, now_s: float) -> bool:
        """Note the loss of a spare: it is prepared again, after growing waits. Returns whether it is still wanted."""
        spare = self._spares.get(unit)
        if spare is not None:
            lived_well = spare.prepared is not None and now_s - spare.prepared_s >= _WELL_S
            spare.losses = 1 if lived_well else spare.losses + 1
            spare.due_s = now_s + doubling_s(spare.losses, _PUT_OFF_S, _MOST_PUT_OFF_S)
            spare.is_asked, spare.prepared = False, None
        return spare is not None

    def lose_host(self, host: str) -> None:
        """Forget the spares on a host that is gone."""
        self._spares = {unit: spare for unit, spare in self._spares.items() if spare.host != host}

    def _prepare(self, now_s: float) -> None:
        for unit, spare in sorted(self._spares.items()):
            if not spare.is_asked and spare.due_s <= now_s:
                spare.is_asked = True
                self._backend.prepare(unit, spare.transformation, spare.host)


def _spares(environment: Environment) -> dict[str, _ColdSpare]:
    return {
        unit.id: _ColdSpare(transformation, unit.host, unit_order("", transformation, None))
        for unit in environment.units
        if unit.standby
        for transformation in [environment.transformation[unit.transformation]]
    }
