"""What a manager keeps of what it finds on its hosts, without a network."""

from __future__ import annotations

from typing import cast

import pytest
from cfgplan_runtime.children.messages import Export, Import, TellMark
from cfgplan_runtime.children.unit_order import unit_order
from cfgplan_runtime.fleet.adoption import Adoption, adopt
from cfgplan_runtime.fleet.orders import (
    CloseTopicOrder,
    CutOrder,
    DiscardOrder,
    GiveStateOrder,
    Held,
    HeldExport,
    HeldImport,
    HeldState,
    HeldStop,
    HeldUnit,
    HeldWire,
    KillOrder,
    StopOrder,
)
from cfgplan_runtime.processes.process_backend import RELAY
from cfgplan_runtime.streams.topic_names import TAPS
from cfgplan_runtime.supervision.backend import Backend, FoundWire, Inlet, StoppingUnit
from cfgplan_runtime.supervision.wiring import Wiring
from small_fleet import cold, source, unit, worker

from cfgplan.domain import ComputationUnit, Publication, RunOptions, Stream, Transformation

LIBRARY = {one.label: one for one in (source(), worker())}
COUNTED, WORKED = Stream("count.1", "n"), Stream("work.1", "y")
TO_WORK, TO_TOPIC = Inlet("work.1", "x"), Inlet("", "/result")


def started(
    *units: str, stop: HeldStop | None = None, library: dict[str, Transformation] = LIBRARY
) -> dict[str, HeldUnit]:
    """Units `label.N` as they were started, with their labor."""
    labels = {one: one.rpartition(".")[0] for one in units}
    return {one: HeldUnit(label, unit_order(one, library[label], None), 7, stop) for one, label in labels.items()}


def found_units(adoption: Adoption) -> set[object]:
    return set() if adoption.found is None else set(adoption.found.units)


def test_of_two_units_of_one_id_that_of_the_latest_manager_is_kept_with_its_wires() -> None:
    apart = Held(
        term=1,
        units=started("count.1", "work.1"),
        spares=started("work.9"),
        wires=[HeldWire(1, COUNTED, TO_WORK), HeldWire(2, WORKED, TO_TOPIC, has_switched=True)],
        topics={"/result": None},
    )
    later = Held(
        term=2,
        units=started("work.1"),
        spares=started("work.9"),
        wires=[HeldWire(4, WORKED, TO_TOPIC, has_switched=True)],
        topics={"/result": None},
    )
    adoption = adopt("new", {"r1": apart, "r2": later}, LIBRARY)
    assert found_units(adoption) == {
        unit("count.1", "r1"),
        ComputationUnit("work.1", "work", (), (Publication("y", "/result"),), "r2"),
        cold("work.9", "r2"),
    }
    assert adoption.found is not None
    assert adoption.found.wires == (FoundWire(4, WORKED, TO_TOPIC, has_switched=True),)
    assert adoption.topics == {"/result": (None, "r2")}
    assert sorted(adoption.orders, key=str) == sorted(
        [
            ("r1", KillOrder("work.1", dump=False)),
            ("r1", DiscardOrder("work.9")),
            ("r1", CutOrder(1, TO_WORK)),
            ("r1", CutOrder(2, TO_TOPIC)),
            ("r1", CloseTopicOrder("/result")),
        ],
        key=str,
    )


def test_taps_of_an_earlier_manager_are_closed() -> None:
    tap = Inlet("", f"{TAPS}{COUNTED}")
    held = Held(units=started("count.1"), wires=[HeldWire(1, COUNTED, tap)], topics={tap.port: "r1"})
    adoption = adopt("new", {"r1": held}, LIBRARY)
    assert found_units(adoption) == {unit("count.1", "r1")}
    assert adoption.topics == {}
    assert adoption.orders == [("r1", CutOrder(1, tap)), ("r1", CloseTopicOrder(tap.port))]


def test_a_stream_from_the_other_one_of_two_units_of_one_id_is_cut() -> None:
    def at(host: str, term: int) -> Held:
        return Held(
            term=term, units=started("count.1"), exports={host: HeldExport(Export(host, "r3", 9, False), -1, COUNTED)}
        )

    fed = Held(
        term=2,
        units=started("work.1"),
        wires=[HeldWire(3, Stream(RELAY, "r1"), TO_WORK)],
        imports={name: HeldImport(Import(name, name), 1) for name in ("r1", "r2")},
    )
    adoption = adopt("new", {"r1": at("r1", 1), "r2": at("r2", 2), "r3": fed}, LIBRARY)
    assert adoption.orders == [("r1", KillOrder("count.1", dump=False)), ("r3", CutOrder(3, TO_WORK))]
    (wire, *_), feeding = adoption.routes.connect(5, COUNTED, TO_WORK, "r2", "r3", queue=9, blocks=False), "r2"
    assert wire[1].stream == Stream(RELAY, feeding), (
        "of the crossings of one stream that of the unit that is kept is used"
    )


def test_a_unit_that_was_told_to_stop_is_awaited_with_its_wires_and_not_taken_for_one_that_runs() -> None:
    stopping = started("work.1", stop=HeldStop(5.0, is_told=True))
    wires = [HeldWire(1, COUNTED, TO_WORK), HeldWire(2, WORKED, TO_TOPIC, has_switched=True)]
    held = Held(now_s=8.5, units=started("count.1") | stopping, wires=wires, topics={"/result": None})
    for library in (LIBRARY, {"count": LIBRARY["count"]}):
        adoption = adopt("new", {"r1": held}, library)
        assert found_units(adoption) == {unit("count.1", "r1")}
        assert adoption.found is not None
        assert adoption.found.stopping == {"work.1": StoppingUnit("work", "r1", 3.5)}
        assert [wire.id for wire in adoption.found.wires] == [1, 2]
        assert adoption.units == {"count.1": "r1", "work.1": "r1"}
        assert adoption.orders == []


def test_a_unit_that_was_told_to_stop_before_it_was_ready_is_ended() -> None:
    early = started("work.1", stop=HeldStop(5.0))
    early["work.1"].labor_us = None
    adoption = adopt("new", {"r1": Held(units=early)}, LIBRARY)
    assert adoption.found is None
    assert adoption.orders == [("r1", KillOrder("work.1", dump=False))]


def test_a_unit_that_would_be_started_otherwise_now_is_told_to_stop_and_has_the_time_that_it_was_started_with() -> None:
    long = {"work": worker(run=RunOptions(stop_us=120_000_000, state="altitude"))}
    wires = [HeldWire(1, COUNTED, TO_WORK), HeldWire(2, WORKED, TO_TOPIC, has_switched=True)]
    units = started("count.1") | started("work.1", library=long)
    for library in (LIBRARY, {"count": LIBRARY["count"]}):
        adoption = adopt("new", {"r1": Held(units=units, wires=wires, topics={"/result": None})}, library)
        assert found_units(adoption) == {unit("count.1", "r1")}
        assert adoption.found is not None
        assert adoption.found.stopping == {"work.1": StoppingUnit("work", "r1", 0.0, 120.0, "altitude")}
        assert adoption.ended == ["work.1"]
        assert adoption.orders == [("r1", StopOrder("work.1"))], "its wires stay until it has ended"


def test_a_unit_that_still_awaits_elements_of_another_host_is_told_to_stop_behind_them_by_the_next_manager() -> None:
    exporting = Held(units=started("count.1"), exports={"x": HeldExport(Export("x", "r2", 9, False), -1, COUNTED)})
    for is_told in (False, True):
        fed = Held(
            units=started("work.1", stop=HeldStop(0.0, is_told)),
            wires=[HeldWire(3, Stream(RELAY, "x"), TO_WORK)],
            imports={"x": HeldImport(Import("x", "r1"), 1)},
        )
        adoption = adopt("new", {"r1": exporting, "r2": fed}, LIBRARY)
        told = [("r2", StopOrder("work.1", ("x",))), ("r1", TellMark("x", "work.1"))]
        assert adoption.orders == ([] if is_told else told), "a second order would interrupt its code"


def test_the_latest_state_of_each_name_is_found_also_if_no_unit_runs() -> None:
    states = {
        "r1": {"altitude": HeldState(7, b"old"), "map": HeldState(1, b"map")},
        "r2": {"altitude": HeldState(8, b"new")},
    }
    adoption = adopt("new", {"r1": Held(), "r2": Held()}, LIBRARY, states)
    assert adoption.found is not None
    assert adoption.found.states == {"altitude": b"new", "map": b"map"}


STATEFUL = {"count": LIBRARY["count"], "work": worker(run=RunOptions(state="altitude"))}


def in_handover(asked: str = "is asked", new: str = "waits", *, is_wired: bool = True) -> Held:
    """Units work.1 and work.2, which replaces it: its wires are the newest ones."""
    units = started("count.1") | started("work.1", "work.2", library=STATEFUL)
    units["work.1"].handover, units["work.2"].handover = asked, new  # type: ignore[assignment]
    units["work.1"].successor = "work.2" if asked == "is asked" else ""
    wires = [HeldWire(1, COUNTED, TO_WORK, has_switched=True)]
    if is_wired:
        wires += [HeldWire(2, COUNTED, Inlet("work.2", "x")), HeldWire(3, Stream("work.2", "y"), TO_TOPIC)]
    return Held(units=units, wires=wires, topics={"/result": None})


def ids(adoption: Adoption) -> list[str]:
    assert adoption.found is not None
    return [one.id for one in adoption.found.units]


@pytest.mark.parametrize("asked", ["", "is asked"], ids=["before it is asked", "after it is asked"])
def test_a_unit_that_waits_for_the_state_of_another_is_ended_and_the_other_is_kept(asked: str) -> None:
    adoption = adopt("new", {"r1": in_handover(asked)}, STATEFUL)
    assert (ids(adoption), adoption.ended) == (["count.1", "work.1"], [])
    goes_on = [("r1", GiveStateOrder("work.1", None, {}, {}))] if asked else []
    assert adoption.orders == [
        ("r1", KillOrder("work.2", dump=False)),
        *goes_on,
        ("r1", CutOrder(2, Inlet("work.2", "x"))),
        ("r1", CutOrder(3, TO_TOPIC)),
    ]


def test_a_unit_that_waits_for_the_state_of_one_that_is_gone_is_kept_and_begins_with_the_last_known_one() -> None:
    held = in_handover()
    del held.units["work.1"]
    for states in ({}, {"r1": {"altitude": HeldState(1, b"high")}}):
        adoption = adopt("new", {"r1": held}, STATEFUL, states)
        assert ids(adoption) == ["count.1", "work.2"]
        last = b"high" if states else None
        assert adoption.orders == [("r1", GiveStateOrder("work.2", last, {}, {})), ("r1", CutOrder(1, TO_WORK))]


def test_a_unit_whose_state_another_has_is_told_to_stop_unless_the_update_was_undone() -> None:
    adoption = adopt("new", {"r1": in_handover(new="has it")}, STATEFUL)
    assert (ids(adoption), adoption.ended) == (["count.1", "work.2"], [])
    assert adoption.orders == [("r1", StopOrder("work.1"))]
    assert adoption.found is not None
    assert adoption.found.stopping == {"work.1": StoppingUnit("work", "r1", 0.0, None, "altitude")}
    adoption = adopt("new", {"r1": in_handover(new="has it", is_wired=False)}, STATEFUL)
    assert ids(adoption) == ["count.1", "work.1", "work.2"]
    assert adoption.orders == [("r1", GiveStateOrder("work.1", None, {}, {}))], "a source that was asked gives again"


def test_a_unit_that_gave_its_state_to_a_unit_that_is_gone_continues_beside_others_with_that_state() -> None:
    held = in_handover(new="has it")
    held.units["work.1"].successor = "work.3"
    for _ in range(2):
        adoption = adopt("new", {"r1": held}, STATEFUL)
        assert ids(adoption) == ["count.1", "work.1", "work.2"]
        assert adoption.orders == [("r1", GiveStateOrder("work.1", None, {}, {}))]
        held.units |= started("work.3", library=STATEFUL)
        held.units["work.3"].handover = "waits"
        ended = adopt("new", {"r1": held}, STATEFUL)
        assert ids(ended) == ["count.1", "work.1", "work.2"]
        assert ended.orders == [("r1", KillOrder("work.3", dump=False)), *adoption.orders]
        del held.units["work.3"]


def test_parts_in_earlier_handovers_end_nothing() -> None:
    for asked in ("", "has it"):
        adoption = adopt("new", {"r1": in_handover(asked, "has it")}, STATEFUL)
        assert (ids(adoption), adoption.orders) == (["count.1", "work.1", "work.2"], [])


def test_the_age_of_a_unit_is_known_by_the_clock_of_its_host() -> None:
    held = Held(now_s=100.0, units=started("count.1"))
    held.units["count.1"].since_s = 70.0
    adoption = adopt("new", {"r1": held}, LIBRARY)
    assert adoption.found is not None
    assert adoption.found.ages_s == {"count.1": 30.0}


def test_units_that_were_not_told_to_begin_are_found_as_such() -> None:
    held = Held(units=started("count.1", "work.1"))
    held.units["count.1"].is_active = True
    adoption = adopt("new", {"r1": held}, LIBRARY)
    assert adoption.found is not None
    assert adoption.found.inactive == {"work.1"}


def test_no_wire_gets_the_number_of_one_that_an_inlet_may_still_have() -> None:
    first, second = (Held(units=started(one), last_wire=number) for one, number in (("count.1", 7), ("work.1", 9)))
    adoption = adopt("new", {"r1": first, "r2": second}, LIBRARY)
    assert adoption.found is not None
    wiring = Wiring(cast("Backend", None))
    wiring.adopt(adoption.found.wires, (), adoption.found.last_wire)
    assert wiring.fresh_id() == 10
