"""A run that has seen many guests keeps no more objects than one that has seen few; no process."""

from __future__ import annotations

import gc
from collections import Counter

from cfgplan_runtime import Policy
from cfgplan_runtime.lifecycle.changes import Add, Remove
from cfgplan_runtime.supervision.backend import Inlet
from cfgplan_runtime.supervision.simulated_backend import Behaviour
from simulated_life import Life, source, started, worker

from cfgplan.domain import Stream, Target

GUESTS = 20


def visit(life: Life) -> None:
    """A guest comes, dies again and again, and goes; its reports are read."""
    life.ask(Add((Target("guest", "G", "/guest"),), (worker("guest", gives="G"),)))
    life.pass_time(3.0)
    life.ask(Remove(("guest",), ("guest",)))
    life.pass_time(1.0)
    life.reports.clear()
    life.runtime.backend.calls.clear()
    while not life.runtime.events.empty():
        life.runtime.events.get_nowait()


def kept(life: Life) -> Counter[type]:
    """The numbers of all objects of the product by type, without the wires of the simulation."""
    gc.collect()
    types = Counter(type(one) for one in gc.get_objects())
    types.subtract(dict.fromkeys((Stream, Inlet), len(life.runtime.backend.wires)))
    return Counter({kind: count for kind, count in types.items() if str(kind.__module__).startswith("cfgplan")})


def test_guests_that_have_left_are_forgotten() -> None:
    life = started(source(), worker(), behaviours={"guest": Behaviour(dies_s=0.2)}, policy=Policy(reviews_kept=3))
    for _ in range(GUESTS):
        visit(life)
    before = kept(life)
    for _ in range(GUESTS):
        visit(life)
    assert {kind: more for kind, more in (kept(life) - before).items() if more >= GUESTS} == {}
