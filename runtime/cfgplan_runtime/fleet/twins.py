"""Two agents of one name, which may first meet after a cut link works again: the one that began later ends."""

from __future__ import annotations

import time
from collections.abc import Callable

import msgspec

from cfgplan.errors import InputError
from cfgplan_runtime.fleet.links import LEASE_S


class Sign(msgspec.Struct, array_like=True):
    """An agent's sign of life: its age in milliseconds, and the id of a twin that has to end."""

    age_ms: int
    later: str = ""


class Twins:
    """Compares the agent `life` with others of its name. All methods are thread-safe.

    The agent with the smaller id compares the two ages, so that both use one comparison: it calls `failed` itself, or
    names the other in its signs. Signs of an agent that was just killed may arrive for a lease.
    """

    def __init__(self, name: str, life: str, failed: Callable[[InputError], None]) -> None:
        self._name, self._life, self._failed = name, life, failed
        self._began_s = time.monotonic()
        self._heard_s: dict[str, float] = {}
        self._later = ""

    def sign(self) -> bytes:
        """Return the agent's next sign of life."""
        return msgspec.msgpack.encode(Sign(self._age_ms(), self._later))

    def hear(self, life: str, payload: bytes) -> None:
        """Take a sign of life of an agent of this name."""
        now_s = time.monotonic()
        if life == self._life or now_s - self._heard_s.setdefault(life, now_s) < LEASE_S:
            return
        try:
            sign = msgspec.msgpack.decode(payload, type=Sign)
        except msgspec.MsgspecError:
            return  # it is of another version
        is_younger = self._life < life and self._age_ms() < sign.age_ms
        if self._life < life and not is_younger:
            self._later = life
        if is_younger or sign.later == self._life:
            mend = "give one of them another --name"
            self._failed(InputError.of(f"the fleet has an agent {self._name!r} that began earlier", mend=mend))

    def _age_ms(self) -> int:
        return round((time.monotonic() - self._began_s) * 1000)
