"""What a manager decides: states and events in, states and effects out. Nothing runs, and no time passes."""

from __future__ import annotations

from collections.abc import Iterable
from concurrent.futures import Future
from dataclasses import replace
from math import inf
from typing import Any, TypeVar, get_args

import pytest
from cfgplan_runtime import ApplyError, Policy, StaleChangeSetError
from cfgplan_runtime.children.unit_order import order_digest
from cfgplan_runtime.errors import AbandonedError, NoSourceError
from cfgplan_runtime.lifecycle.back_off import Place
from cfgplan_runtime.lifecycle.changes import (
    Add,
    Change,
    KillUnit,
    LoseHost,
    RegainHost,
    Remove,
    ReviewNow,
    Stop,
)
from cfgplan_runtime.lifecycle.decisions import BreakIn, breaks_in, decide, first_state
from cfgplan_runtime.lifecycle.deliberation import Findings, Looked
from cfgplan_runtime.lifecycle.inbox import Asked, Item, Leave, OldCode, Unusable
from cfgplan_runtime.lifecycle.perturbations import (
    HorizonReached,
    HostBack,
    HostGone,
    MayStartAgain,
    Perturbation,
    ReviewRequested,
    Started,
    SubscriptionLost,
    TargetSilent,
    UnitGone,
    UnitKeepsFailing,
    UpdateFailed,
)
from cfgplan_runtime.lifecycle.reports import (
    BackedOff,
    Decision,
    Ended,
    Observed,
    OldCodeRuns,
    Perturbed,
    ReviewBegan,
    Reviewed,
    WorldRefused,
)
from cfgplan_runtime.lifecycle.state import Gathering, Planning, State, Updating
from cfgplan_runtime.lifecycle.transitions import (
    ApplyUpdate,
    Effect,
    Finished,
    Input,
    LearnOfFailure,
    MakePlan,
    Match,
    Matched,
    Observe,
    Planned,
    Prepare,
    Remember,
    Respond,
    Seen,
    StopAll,
    Tell,
    Terminate,
    Tick,
    TimedInput,
    Updated,
)
from cfgplan_runtime.lifecycle.worlds import WorldVersion
from cfgplan_runtime.supervision.backend import Failures
from cfgplan_runtime.supervision.events import (
    ClockMoved,
    End,
    FailuresKept,
    HostJoined,
    HostLost,
    InputLost,
    SpareLost,
    SparePrepared,
    SpareUsed,
    TopicsStatus,
    UnitDied,
    UnitFailed,
    UnitFound,
    UnitHung,
    UnitReady,
    UnitStatus,
    UnitStopped,
    UnitTooLarge,
)
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule
from simulated_life import RESULT, source, worker

from cfgplan import api
from cfgplan.domain import ChangeSet, ComputationUnit, Environment, Host, Publication, Stream, Subscription, Target
from cfgplan.errors import Fault, InputError

E = TypeVar("E")
LIBRARY = (source(), worker(host="far"))
DIGEST = order_digest(LIBRARY[1])
ENDS: tuple[End, ...] = get_args(End)
POLICY = Policy(gather_s=0.0, explain_s=0.02, retry_s=0.1, most_loss_s=1.0)
COUNT = ComputationUnit("count.1", "count")
WORK = ComputationUnit("work.1", "work", (Subscription("x", Stream("count.1", "n")),), (Publication("y", "/result"),))
RUNNING = Environment((COUNT, WORK), LIBRARY, (RESULT,))
EMPTY = LIVING = Environment((), LIBRARY, (RESULT,))
START = ChangeSet(started=(COUNT, WORK))


def world(*, targets: tuple[Target, ...] = (RESULT,), horizon_s: int = 60) -> api.World:
    return api.world(Environment((), LIBRARY, targets), horizon_s=horizon_s)


def after(state: State, at_s: float, *what: Input, running: Environment = RUNNING) -> tuple[State, list[Effect]]:
    """The state after things that happen at one time, and all effects."""
    effects: list[Effect] = []
    for one in what:
        state, more = decide(state, TimedInput(at_s, one, running))
        effects += more
    return state, effects


def found(effects: Iterable[Effect], kind: type[E]) -> list[E]:
    return [effect for effect in effects if isinstance(effect, kind)]


def perturbations(effects: Iterable[Effect]) -> list[Perturbation]:
    return [told.report.perturbation for told in found(effects, Tell) if isinstance(told.report, Perturbed)]


def asked(change: Change) -> Asked:
    return Asked(change, Future())


def findings(**more: Any) -> Findings:
    """A plan that starts what is to run, unless it is said otherwise."""
    more = {
        "running": EMPTY,
        "decision": Decision.APPLIED,
        "change_set": START,
        "cost_us": 1,
        "met": ("result",),
        **more,
    }
    return Findings(planned=EMPTY, **more)


def stable(policy: Policy = POLICY, **more: Any) -> State:
    """After the first review, with both units running since 0."""
    state, _ = after(first_state(world(**more), POLICY), 0.0, Started(), Tick(0.0), Planned(findings()), running=EMPTY)
    return replace(after(state, 0.0, Updated())[0], policy=policy)


def planning() -> State:
    return after(stable(), 1.0, asked(ReviewNow()), Tick(0.0))[0]


def updating(**more: Any) -> State:
    """While another work.2 is started in the place of work.1."""
    started = (replace(WORK, id="work.2"),)
    swap = findings(running=RUNNING, change_set=ChangeSet(started=started, stopped=("work.1",)), **more)
    return after(planning(), 2.0, Planned(swap))[0]


def test_the_first_review_plans_updates_and_is_put_on_record() -> None:
    state, effects = after(first_state(world(), POLICY), 5.0, Started(), Tick(100.0), running=EMPTY)
    assert perturbations(effects) == [Started()]
    (plan,) = found(effects, MakePlan)
    assert (plan.plan_input.running, plan.optimises, plan.is_last) == (EMPTY, True, False)
    state, effects = after(state, 6.0, Planned(findings()), running=EMPTY)
    assert effects == [ApplyUpdate(START, EMPTY)]
    state, effects = after(state, 7.0, Updated(0.5))
    (review,) = state.reviews
    assert (review.number, review.at_s, review.time_s, review.decision) == (1, 5.0, 100.0, Decision.APPLIED)
    assert review.seconds == {"detect": 0.0, "match": 0.0, "apply": 0.5}
    assert effects == [Tell(Reviewed(review)), Prepare(replace(state, running=RUNNING).plan_input)]
    assert (state.doing, state.horizon_at_s, state.observe_at_s) == (None, 67.0, 8.0)
    assert {unit: known.since_s for unit, known in state.situation.units.items()} == {"count.1": 6.0, "work.1": 6.0}


def test_a_look_is_put_off_by_what_happens_while_it_is_planned() -> None:
    """A death is answered first; the look is due again as soon as nothing waits, since none has begun."""
    looking = replace(stable(), doing=Planning(2, 1.0, 1.0, 0.0, world(), plans=1))
    look = Looked(
        (Place("work"),), (), findings(running=RUNNING, change_set=ChangeSet(started=(replace(WORK, id="work.2"),)))
    )
    _, effects = after(looking, 1.5, look)
    assert found(effects, ApplyUpdate)
    state, effects = after(looking, 1.5, UnitDied("work.1", "killed"), look)
    assert (found(effects, ApplyUpdate), state.doing, state.looks.pauses) == ([], None, {})
    assert state.due_s <= 1.5


def test_nothing_is_changed_in_place() -> None:
    state = stable()
    before = repr(state)
    for what in (UnitDied("work.1", "crash"), InputLost("work.1", "x", 1), UnitFailed("work.1", "raised", 1, "bad")):
        decide(state, TimedInput(1.0, what, RUNNING))
    assert repr(state) == before


def test_old_code_is_told_when_it_changes_and_when_the_last_of_its_units_has_ended() -> None:
    steps: list[tuple[OldCode, bool]] = [
        (OldCode("a.py", ()), False),
        (OldCode("a.py", ("x.1", "y.1")), True),
        (OldCode("b.py", ()), False),
        (OldCode("a.py", ("y.1",)), False),
        (OldCode("a.py", ("y.1",)), True),
        (OldCode("b.py", ("z.1",)), True),
        (OldCode("a.py", ("z.1",)), True),
        (OldCode("a.py", ()), True),
        (OldCode("a.py", ()), False),
    ]
    state = stable()
    for found, is_told in steps:
        state, effects = after(state, 1.0, found)
        assert list(effects) == ([Tell(OldCodeRuns(found.file, found.units))] if is_told else [])
    assert state.old_code == {"b.py": ("z.1",)}


@pytest.mark.parametrize(
    ("what", "perturbation", "delay_s"),
    [
        ([UnitDied("work.1", "crash")], UnitGone("work.1", "work", "died", "crash", "far"), 0.0),
        ([UnitHung("work.1", 9.0), UnitDied("work.1", "k")], UnitGone("work.1", "work", "hung", "k", "far"), 0.0),
        *(([UnitDied("work.1", "k", how)], UnitGone("work.1", "work", how, "k", "far"), 0.0) for how in ENDS),
        (
            [UnitTooLarge("work.1", 9), UnitDied("work.1", "k")],
            UnitGone("work.1", "work", "too large", "k", "far"),
            0.0,
        ),
        ([asked(KillUnit("work.1")), UnitDied("work.1", "k")], UnitGone("work.1", "work", "killed", "k", "far"), 0.0),
        (
            [UnitHung("work.1", 9.0), UnitReady("work.1", 1), UnitDied("work.1", "k")],
            UnitGone("work.1", "work", "died", "k", "far"),
            0.0,
        ),
        ([InputLost("work.1", "x", 1)], SubscriptionLost("work.1", "x"), 0.02),
        ([InputLost(None, "/result", 1)], SubscriptionLost(None, "/result"), 0.02),
        ([asked(LoseHost("far", "no answer"))], HostGone("far", "no answer"), 0.0),
        ([HostLost("far", "cut")], HostGone("far", "cut"), 0.0),
        ([HostLost("far", "cut"), UnitDied("work.1", "k")], HostGone("far", "cut"), 0.0),
        ([asked(LoseHost("far")), asked(RegainHost("far"))], (HostGone("far"), HostBack("far")), 0.0),
        ([asked(ReviewNow("me"))], ReviewRequested("me"), 0.0),
    ],
)
def test_what_happens_is_a_perturbation_and_a_review_is_due(
    what: list[Input], perturbation: Perturbation | tuple[Perturbation, ...], delay_s: float
) -> None:
    state, effects = after(stable(), 3.0, *what)
    told = perturbation if isinstance(perturbation, tuple) else (perturbation,)
    assert tuple(perturbations(effects)) == told
    assert state.due_s == 3.0 + delay_s
    state, effects = after(state, state.due_s, Tick(0.0))
    assert [type(effect) for effect in effects] == [Tell, MakePlan]
    assert effects[0] == Tell(ReviewBegan(2, told))


@pytest.mark.parametrize(
    "what",
    [
        UnitDied("stranger.1", "crash"),
        UnitStopped("work.1"),
        UnitFailed("work.1", "raised", 3, "bad"),
        SparePrepared("work.9", 1),
        SpareUsed("work.1", "work.9"),
        SpareLost("work.9", "crash"),
        Unusable("f", ()),
        HostLost("stranger", "cut"),
        HostJoined("stranger"),
        HostJoined("far"),
    ],
)
def test_what_is_no_perturbation_makes_no_review(what: Input) -> None:
    state, effects = after(stable(), 3.0, what)
    assert (effects, state.due_s) == ([], inf)


def test_a_lost_host_takes_its_units_along_blames_nobody_and_answers_by_the_review() -> None:
    kill = asked(KillUnit("work.1"))
    state, effects = after(stable(), 3.0, kill, HostLost("far", "cut"))
    assert state.situation.units.keys() == {"count.1"}
    assert not found(effects, LearnOfFailure)
    assert state.waiting == {}
    assert state.entries[-1].outcomes == (kill.outcome,)
    state, _ = after(updating(), 2.0, HostLost("far", "cut"))
    state, effects = after(state, 2.5, Updated(0.5, ApplyError("work.2 was on far", ("work.2",))))
    assert not found(effects, LearnOfFailure)
    assert state.due_s == 2.0


def test_the_first_review_waits_for_hosts_as_long_as_it_may() -> None:
    policy = replace(POLICY, hosts_s=3.0)
    state, _ = after(first_state(world(), policy), 5.0, Started(), running=EMPTY)
    assert (state.due_s, state.situation.lost_hosts(LIVING)) == (8.0, ("far",))
    joined, effects = after(state, 6.0, HostJoined("near"), HostJoined("far"), running=EMPTY)
    assert (joined.due_s, joined.situation.lost_hosts(LIVING), effects) == (6.0, (), [])


def test_the_clock_of_a_host_is_known_while_it_is_there() -> None:
    joined, _ = after(stable(), 1.0, HostJoined("near"), HostJoined("far", -500_000))
    assert joined.situation.clocks_ahead_us == {"near": 0, "far": -500_000}
    joined, effects = after(joined, 1.5, ClockMoved("near", 2_000_000))
    assert joined.situation.clocks_ahead_us == {"near": 2_000_000, "far": -500_000} and not effects
    lost, _ = after(joined, 2.0, HostLost("far", "cut"))
    assert lost.situation.clocks_ahead_us == {"near": 2_000_000}


@pytest.mark.parametrize(
    ("what", "prepared"),
    [
        ([], {"work.9"}),
        ([SparePrepared("work.8", 1)], {"work.8", "work.9"}),
        ([SpareUsed("work.2", "work.9")], set()),
        ([SpareLost("work.9", "crash")], set()),
        ([SpareLost("work.9", "crash"), SparePrepared("work.9", 1)], {"work.9"}),
        ([UnitDied("work.9", "crash"), HostLost("far", "cut")], {"work.9"}),
    ],
)
def test_a_cold_spare_is_known_to_be_prepared_until_it_is_used_or_lost(what: list[Input], prepared: set[str]) -> None:
    state, _ = after(stable(), 3.0, SparePrepared("work.9", 1), *what)
    assert state.situation.prepared == prepared


def test_another_spare_of_the_same_id_is_not_known_to_be_prepared() -> None:
    state, _ = after(updating(), 3.0, SparePrepared("work.1", 1))
    assert state.situation.prepared == {"work.1"}
    state, _ = after(planning(), 3.0, SparePrepared("work.1", 1), Planned(findings()))
    assert not state.situation.prepared


def test_a_unit_without_a_good_step_for_long_is_given_up_and_blamed() -> None:
    state, failed = stable(Policy(failing_steps=5, failing_s=3.0)), UnitFailed("work.1", "raised", 12, "bad luck")
    told: list[Effect] = []
    for at_s, steps, errors in ((1, 10, 0), (2, 12, 2), (3, 16, 6), (5, 17, 7), (6, 18, 8)):
        state, effects = after(state, at_s, failed, UnitStatus("work.1", steps, errors, {}, {}))
        told += effects
    assert perturbations(told) == [UnitKeepsFailing("work.1", "work", 7, "bad luck")]
    assert found(told, LearnOfFailure) == [LearnOfFailure(Place("work", "far"))]
    assert state.situation.failing == {"work.1"}


def test_a_unit_with_one_good_step_in_between_goes_on() -> None:
    state = stable(Policy(failing_steps=5, failing_s=3.0))
    for at_s, steps, errors in ((1, 10, 0), (3, 14, 4), (5, 20, 8), (7, 24, 12)):
        state, effects = after(state, at_s, UnitStatus("work.1", steps, errors, {}, {}))
        assert effects == []
    assert [type(one) for one in perturbations(after(state, 9.0, UnitStatus("work.1", 28, 16, {}, {}))[1])] == [
        UnitKeepsFailing
    ]


def test_a_unit_is_not_judged_by_what_another_of_its_id_has_done() -> None:
    def status(steps: int, errors: int) -> UnitStatus:
        return UnitStatus("work.1", steps, errors, {}, {})

    state, _ = after(stable(), 1.0, status(100, 0), UnitReady("work.1", 1))
    assert perturbations(after(state, 9.0, status(10, 10))[1]) == []
    state, _ = after(state, 9.0, status(10, 10))
    assert [type(one) for one in perturbations(after(state, 12.0, status(20, 20))[1])] == [UnitKeepsFailing]


def test_an_input_that_is_lost_again_and_again_waits_ever_longer() -> None:
    state, delays = stable(), []
    lost = InputLost("work.1", "x", 1)
    for at_s in (*range(1, 8), 100):
        state, _ = after(replace(state, entries=()), at_s, lost)
        delays.append(state.due_s - at_s)
    assert delays == pytest.approx([0.02, 0.02, 0.1, 0.2, 0.4, 0.8, 1.0, 0.02])
    state, _ = after(replace(state, entries=()), 8.0, InputLost("work.1", "z", 1))
    assert state.due_s == pytest.approx(8.02)


def test_the_second_failure_in_a_row_is_waited_after_and_then_it_may_start_again() -> None:
    state = stable()
    for at_s in (1.0, 2.0):
        state, effects = after(state, at_s, UnitDied("work.1", "crash"))
        state = replace(state, entries=(), situation=state.situation.with_started((WORK,), RUNNING, at_s))
        assert found(effects, LearnOfFailure) == [LearnOfFailure(Place("work", "far"))]
    assert (state.situation.back_offs.avoided, state.wake_s) == ({Place("work", "far")}, 1.0)
    state, effects = after(replace(state, observe_at_s=inf), 3.0, Tick(0.0))
    assert perturbations(effects) == [MayStartAgain(("work",))]
    assert state.situation.back_offs.avoided == frozenset()


def test_each_change_of_failures_is_remembered_for_the_next_manager() -> None:
    state, place, work = stable(), Place("work", "far"), LIBRARY[1]
    for at_s, left_s in ((1.0, 0.0), (2.0, 1.0)):
        number = round(at_s)
        state, effects = after(state, at_s, UnitDied("work.1", "crash"))
        state = replace(state, entries=(), situation=state.situation.with_started((WORK,), RUNNING, at_s))
        assert found(effects, Remember) == [Remember(place, Failures(work, "far", number, left_s, "crash"))]
    assert found(after(state, 2.5, HostJoined("far"))[1], Remember) == []
    _, effects = after(state, 3.0, asked(ReviewNow("a person")))
    assert found(effects, Remember) == [Remember(place, None)]


def test_a_manager_goes_on_with_the_failures_of_the_one_before_it() -> None:
    place, kept = Place("work", "far"), FailuresKept("work", "far", 3, 2.5, "crash", DIGEST)
    state, effects = after(first_state(world(), POLICY), 10.0, kept, running=EMPTY)
    assert state.situation.back_offs.avoided == {place}
    assert state.wake_s == 12.5
    assert found(effects, LearnOfFailure) == [LearnOfFailure(place)] * 3
    (backed_off,) = [told.report.backing_off for told in found(effects, Tell) if isinstance(told.report, BackedOff)]
    assert (backed_off.failures, backed_off.left_s, backed_off.cause) == (3, 2.5, "crash")
    again = kept.__class__("work", "far", 9, 99.0, "an older one", DIGEST)
    assert after(state, 11.0, again, running=EMPTY)[0].situation.back_offs == state.situation.back_offs
    over = FailuresKept("work", "far", 3, 0.0, "crash", DIGEST)
    ended, _ = after(first_state(world(), POLICY), 10.0, over, running=EMPTY)
    assert ended.situation.back_offs.avoided == frozenset(), "its wait is over"
    ended, _ = after(ended, 11.0, UnitFound("work.1", 5.0), UnitDied("work.1", "crash"))
    assert ended.situation.back_offs.records[place].failures == 4, "and the next failure is the fourth"


def mended(state: State) -> State:
    """The state with other params of the worker, whose units run as before until the review."""
    library = LIBRARY[0], replace(LIBRARY[1], params={"mended": True})
    return replace(state, version=WorldVersion(api.world(Environment((), library, (RESULT,)), horizon_s=60)))


@pytest.mark.parametrize("is_known", [False, True])
def test_failures_that_an_earlier_manager_has_kept_are_judged_by_the_present_world(is_known: bool) -> None:
    """A host joined after an edit: its failures may be of the transformation as it was before, or as it is now."""
    state, place = mended(first_state(world(), POLICY)), Place("work", "far")
    now = state.version.world.environment.transformation["work"]
    kept = FailuresKept("work", "far", 3, 2.5, "crash", order_digest(now) if is_known else DIGEST)
    state, effects = after(state, 10.0, kept, running=EMPTY)
    assert state.situation.back_offs.avoided == ({place} if is_known else set())
    failures = Failures(now, "far", 3, 2.5, "crash") if is_known else None
    assert found(effects, Remember) == [Remember(place, failures)]
    gone = FailuresKept("other", "far", 3, 2.5, "crash", DIGEST)
    assert found(after(state, 11.0, gone, running=EMPTY)[1], Remember) == [Remember(Place("other", "far"), None)]


def test_failures_of_a_unit_that_was_started_before_an_edit_are_not_those_of_the_present_transformation() -> None:
    state, effects = after(mended(stable()), 1.0, UnitDied("work.1", "crash"))
    assert [type(one) for one in perturbations(effects)] == [UnitGone]
    assert found(effects, LearnOfFailure) == found(effects, Remember) == []
    assert state.situation.back_offs.records == {}
    state, _ = after(stable(), 1.0, UnitStatus("work.1", 1, 0, {}, {}))
    state, effects = after(mended(state), 9.0, UnitStatus("work.1", 10, 9, {}, {}))
    assert [type(one) for one in perturbations(effects)] == [UnitKeepsFailing]
    assert (found(effects, LearnOfFailure), state.situation.failing) == ([], {"work.1"})
    slow = Updated(error=ApplyError("work.2 was not ready within 30 s", ("work.2",)))
    for state, blamed in ((updating(), [LearnOfFailure(Place("work", "far"))]), (mended(updating()), [])):
        assert found(after(state, 3.0, slow)[1], LearnOfFailure) == blamed


@pytest.mark.parametrize(("age_s", "failures"), [(5.0, 4), (3600.0, 1)])
def test_the_life_of_a_unit_before_a_takeover_counts(age_s: float, failures: int) -> None:
    kept = FailuresKept("work", "far", 3, 0.0, "crash", DIGEST)
    state, _ = after(first_state(world(), POLICY), 10.0, kept, UnitFound("work.1", age_s))
    state, _ = after(state, 11.0, UnitDied("work.1", "crash"))
    assert state.situation.back_offs.records[Place("work", "far")].failures == failures


def test_at_the_horizon_units_are_observed_before_it_is_planned() -> None:
    _, effects = after(stable(), 60.0, Tick(0.0))
    assert perturbations(effects) == [HorizonReached(60)]
    assert [type(effect) for effect in effects] == [Tell, Observe, Tell, MakePlan]
    assert found(effects, MakePlan)[0].optimises


def test_between_reviews_units_are_observed() -> None:
    state, effects = after(stable(), 1.0, Tick(0.0))
    assert effects == [Observe()]
    state, effects = after(state, 1.0, Seen(()))
    assert (effects, state.observe_at_s) == ([Tell(Observed(()))], 2.0)


def test_what_comes_shortly_after_is_part_of_the_same_review() -> None:
    state, effects = after(stable(replace(POLICY, gather_s=0.5)), 1.0, UnitDied("work.1", "k"), Tick(0.0))
    assert (state.doing, state.wake_s, found(effects, MakePlan)) == (Gathering(1.5), 1.5, [])
    state, effects = after(state, 1.2, UnitDied("count.1", "k"), Tick(0.0))
    assert found(effects, MakePlan) == []
    state, effects = after(state, 1.5, Tick(0.0))
    assert len(found(effects, MakePlan)) == 1
    assert isinstance(state.doing, Planning)
    assert len(state.doing.entries) == 2


def test_what_comes_while_it_plans_makes_it_plan_anew_but_not_for_ever() -> None:
    state, request = planning(), asked(ReviewNow("late"))
    state, _ = after(state, 1.0, request)
    for number in range(2, POLICY.interruptions + 2):
        state, effects = after(state, 1.0, Planned(findings(), was_interrupted=True))
        (plan,) = effects
        assert isinstance(plan, MakePlan)
        assert plan.is_last is (number > POLICY.interruptions)
    state, effects = after(state, 1.0, Planned(findings(running=RUNNING, change_set=ChangeSet()), was_interrupted=True))
    assert Respond(request.outcome, state.reviews[-1]) in effects
    assert found(effects, MakePlan) == []


@pytest.mark.parametrize(
    ("made", "decision", "cause"),
    [
        (findings(change_set=ChangeSet(), decision=Decision.KEPT), Decision.KEPT, ""),
        (findings(decision=Decision.DEFERRED), Decision.DEFERRED, ""),
        (findings(change_set=None, decision=Decision.UNDECIDED, cause="no time"), Decision.UNDECIDED, "no time"),
    ],
)
def test_where_nothing_is_to_be_changed_nothing_is_applied(made: Findings, decision: Decision, cause: str) -> None:
    state, effects = after(planning(), 2.0, Planned(made))
    assert found(effects, ApplyUpdate) == found(effects, Prepare) == []
    assert (state.reviews[-1].decision, state.reviews[-1].cause) == (decision, cause)
    assert state.due_s == (2.1 if cause else inf)


def test_reviews_that_come_to_nothing_are_repeated_later_and_later() -> None:
    state, at_s, waits = planning(), 2.0, []
    for _ in range(5):
        state, _ = after(state, at_s, Planned(findings(change_set=None, decision=Decision.UNDECIDED, cause="no time")))
        waits.append(state.due_s - at_s)
        at_s = state.due_s
        state, effects = after(state, at_s, Tick(0.0))
        assert found(effects, MakePlan)[0].optimises  # the review that was asked for is still owed
    assert waits == pytest.approx([0.1, 0.2, 0.4, 0.8, 1.6])


def undone(cause: str) -> UpdateFailed:
    return UpdateFailed(cause, ("work",), is_undone=True)


@pytest.mark.parametrize(
    ("error", "failed", "avoided"),
    [
        (StaleChangeSetError("others run"), UpdateFailed("others run", is_stale=True), set()),
        (NoSourceError("no code", ("work",), "none"), UpdateFailed("no code", ("work",)), {Place("work")}),
        (
            AbandonedError("given up", ("work.2",)),
            UpdateFailed("given up", ("work",), is_undone=True),
            {Place("work", "far")},
        ),
        (
            ApplyError("too slow", ("work.2",)),
            UpdateFailed("too slow", ("work",), is_undone=True),
            {Place("work", "far")},
        ),
        (
            ZeroDivisionError("bug"),
            UpdateFailed("the middleware failed: ZeroDivisionError: bug", is_fault=True),
            set(),
        ),
    ],
)
def test_an_update_that_fails_is_followed_by_another_review(
    error: Exception, failed: UpdateFailed, avoided: set[Place]
) -> None:
    state, effects = after(updating(), 3.0, Updated(0.1, error))
    assert perturbations(effects) == [failed]
    assert (state.reviews[-1].decision, state.reviews[-1].cause) == (Decision.FAILED, failed.cause)
    assert state.situation.back_offs.avoided == avoided
    assert "work.2" not in state.situation.units
    assert state.due_s == (3.1 if failed.is_fault else 3.0)
    assert found(effects, LearnOfFailure) == (
        [LearnOfFailure(Place("work", "far"))] if type(error) is ApplyError else []
    )


@pytest.mark.parametrize("how", ENDS)
def test_a_unit_that_was_given_up_though_its_process_may_live_is_blamed_on_nothing(how: End) -> None:
    is_blamed = how != "was given up"
    _, effects = after(stable(), 3.0, UnitDied("work.1", "the master is gone", how))
    assert found(effects, LearnOfFailure) == [LearnOfFailure(Place("work", "far"))] * is_blamed
    _, effects = after(after(updating(), 2.5, UnitDied("work.2", "k", how))[0], 3.0, Updated(0.1))
    assert found(effects, LearnOfFailure) == [LearnOfFailure(Place("work", "far"))] * is_blamed


def test_a_new_unit_that_dies_counts_once_however_its_update_ends() -> None:
    state, effects = after(updating(), 2.5, UnitDied("work.2", "no camera"))
    assert effects == []
    failed, effects = after(state, 3.0, Updated(0.1, ApplyError("undone", ("work.2",))))
    assert found(effects, LearnOfFailure) == [LearnOfFailure(Place("work", "far"))]
    assert perturbations(effects) == [undone("undone")]
    assert failed.situation.back_offs.avoided == {Place("work", "far")}
    state, effects = after(state, 3.0, Updated(0.1))
    assert found(effects, LearnOfFailure) == [LearnOfFailure(Place("work", "far"))]
    assert perturbations(effects) == [UnitGone("work.2", "work", "died", "no camera", "far")]
    assert (state.situation.back_offs.avoided, found(effects, Prepare)) == (frozenset(), [])


@pytest.mark.parametrize(
    "error",
    [
        None,
        NoSourceError("no code", ("work",), "none"),
        AbandonedError("given up", ("work.2",)),
        ApplyError("too slow", ("work.2",)),
    ],
)
@pytest.mark.parametrize("has_died", [False, True])
def test_an_update_that_was_planned_before_an_edit_says_nothing_about_the_present_transformation(
    error: Exception | None, has_died: bool
) -> None:
    """The edit comes while the update is under way, also after a new unit of it has died."""
    state = after(updating(), 2.5, UnitDied("work.2", "no camera"))[0] if has_died else updating()
    state, effects = after(mended(state), 3.0, Updated(0.1, error))
    assert found(effects, LearnOfFailure) == found(effects, Remember) == []
    assert (state.situation.back_offs.records, state.situation.back_offs.avoided) == ({}, frozenset())


def test_where_nothing_else_can_help_what_is_left_alone_may_start_sooner() -> None:
    state = stable()
    for at_s in range(1, 6):
        state, _ = after(state, at_s, UnitDied("work.1", "crash"))
        state = replace(state, situation=state.situation.with_started((WORK,), RUNNING, at_s))
    assert state.situation.back_offs.next_end_s == 5 + 8.0
    state, _ = after(state, 5.0, Tick(0.0))
    state, _ = after(state, 5.0, Planned(findings(change_set=ChangeSet(), decision=Decision.KEPT, hurried=("work",))))
    assert state.situation.back_offs.next_end_s == 5 + 3.0


@pytest.mark.parametrize(
    ("change", "part"),
    [
        (KillUnit("nobody.1"), "no unit 'nobody.1' runs"),
        (LoseHost("near"), "there is no host 'near'"),
        (RegainHost("far"), "host 'far' was not taken out of service"),
    ],
)
def test_a_bad_request_is_refused_at_once(change: Change, part: str) -> None:
    request = asked(change)
    before = stable()
    state, (answer,) = after(before, 1.0, request)
    assert isinstance(answer, Respond)
    assert (answer.outcome, part in str(answer.answer)) == (request.outcome, True)
    assert state == before


def test_a_world_is_matched_before_anything_else_is_decided() -> None:
    state, request = stable(), asked(Remove(targets=("result",)))
    state, effects = after(state, 1.0, request)
    assert effects == [Match(state.version, request, request.change)]  # type: ignore[arg-type]
    gone, effects = after(state, 1.0, Matched(request, state.version.after(Remove(targets=("result",))), 0.25))
    assert [type(one).__name__ for one in perturbations(effects)] == ["WorldChanged"]
    assert (gone.version.world.environment.targets, gone.match_s) == ((), 0.25)
    _, effects = after(state, 1.0, Matched(request, InputError.of("bad")))
    assert [str(answer.answer) for answer in found(effects, Respond)] == ["bad"]
    _, effects = after(state, 1.0, Matched(request, state.version))
    assert effects == [Respond(request.outcome)]


def test_a_file_that_can_not_be_used_is_told_until_it_is_well_again() -> None:
    faults = (Fault("bad"),)
    state, effects = after(stable(), 1.0, Unusable("env.yaml", faults))
    assert (state.faults, effects) == (faults, [Tell(WorldRefused("env.yaml", faults))])
    state, effects = after(state, 1.0, Unusable("env.yaml", ()), Unusable("env.yaml", ()))
    assert (state.faults, effects) == ((), [Tell(WorldRefused("env.yaml", ()))])


def test_a_killed_unit_is_nobodys_failure_and_who_asked_is_told_by_the_review() -> None:
    request = asked(KillUnit("work.1"))
    state, effects = after(stable(), 1.0, request)
    assert (effects, state.is_settled) == ([Terminate("work.1")], False)
    state, effects = after(state, 1.5, UnitDied("work.1", "killed"), running=replace(RUNNING, units=(COUNT,)))
    assert found(effects, LearnOfFailure) == []
    assert state.entries[0].outcomes == (request.outcome,)


def test_a_silent_target_makes_a_review_again_and_again() -> None:
    state, silent = stable(targets=(replace(RESULT, silent_us=5_000_000),)), []
    for at_s in range(1, 21):
        state, effects = after(replace(state, entries=()), at_s, TopicsStatus({}))
        silent += [(at_s, one.target) for one in perturbations(effects) if isinstance(one, TargetSilent)]
    assert silent == [(7, "result"), (13, "result"), (19, "result")]
    assert [one.target for one in state.situation.silences] == ["result"]


@pytest.mark.parametrize(
    ("doing", "item", "how"),
    [
        (None, asked(ReviewNow()), BreakIn.INTERRUPT),
        (planning().doing, UnitDied("work.1", "k"), BreakIn.INTERRUPT),
        (updating().doing, UnitDied("work.1", "k"), BreakIn.INTERRUPT | BreakIn.ABANDON),
        (updating().doing, UnitDied("work.2", "k"), BreakIn.INTERRUPT),
        (updating().doing, InputLost(None, "/result", 1), BreakIn.INTERRUPT | BreakIn.ABANDON),
        (updating().doing, asked(ReviewNow()), BreakIn.INTERRUPT),
        (updating().doing, asked(Stop()), BreakIn.INTERRUPT | BreakIn.ABANDON | BreakIn.END),
        (planning().doing, Leave(), BreakIn.INTERRUPT | BreakIn.END),
        (updating().doing, UnitReady("work.2", 1), BreakIn(0)),
        (planning().doing, Unusable("f", ()), BreakIn(0)),
    ],
)
def test_what_can_not_wait_breaks_in(doing: Any, item: Item, how: BreakIn) -> None:
    assert breaks_in(doing, item) == how


@pytest.mark.parametrize("state", [stable(), planning()], ids=["stable", "planning"])
def test_the_end_stops_all_units_and_tells_everybody(state: State) -> None:
    stop, kill, late = asked(Stop()), asked(KillUnit("work.1")), asked(ReviewNow())
    state, _ = after(state, 3.0, kill, late, stop)
    over = Planned(findings()) if isinstance(state.doing, Planning) else Tick(0.0)
    state, effects = after(state, 3.0, over)
    assert effects == [StopAll()]
    state, effects = after(state, 4.0, Finished())
    answers = {answer.outcome: str(answer.answer) for answer in found(effects, Respond)}
    assert answers[stop.outcome] == "None"
    assert answers[kill.outcome] == answers[late.outcome] == "the run has ended"
    assert (state.is_over, effects[-1]) == (True, Tell(Ended("")))


def test_a_manager_that_is_closed_leaves_the_units_alone() -> None:
    state, effects = after(stable(), 3.0, Leave(), Tick(0.0))
    assert (state.is_over, effects) == (True, [Tell(Ended(""))])


OTHERS = tuple(Target(f"other{number}", "Y", f"/other{number}") for number in range(3))


class Deciding(RuleBasedStateMachine):
    """A manager's loop in which anything may happen between two steps, with a planner that meets every target.

    What is to run is a unit for each target. Plans, updates and the end are answered only when the machine comes to it.
    """

    @initialize()
    def begin(self) -> None:
        self.at_s, self.number = 0.0, 0
        self.running = Environment((), (source(tag="Y"),), (), (Host("near"), Host("far")))
        self.lost: set[str] = set()
        self.state = first_state(api.world(replace(self.running, targets=OTHERS[:1]), horizon_s=60), POLICY)
        self.pending: MakePlan | ApplyUpdate | StopAll | None = None
        self.requests_made: list[Asked] = []
        self.answers: list[Any] = []
        self.decide(Started())

    def decide(self, what: Input) -> None:
        self.state, effects = decide(self.state, TimedInput(self.at_s, what, self.running))
        for position, effect in enumerate(effects):
            match effect:
                case Respond(outcome):
                    self.answers.append(outcome)
                case Match(version, request, change):
                    try:
                        self.decide(Matched(request, version.after(change)))
                    except InputError as error:
                        self.decide(Matched(request, error))
                case Observe():
                    self.decide(Seen(()))
                case MakePlan() | ApplyUpdate() | StopAll():
                    assert self.pending is None, "two things are asked for at once"
                    assert position == len(effects) - 1, "something comes after what has to be waited for"
                    self.pending = effect
                case Tell(Reviewed(review)):
                    wanted = {target.label for target in self.running.targets}
                    assert review.decision is Decision.FAILED or set(review.met) <= wanted, "a dropped target is met"

    def ask(self, change: Change) -> None:
        request = asked(change)
        self.requests_made.append(request)
        self.decide(request)

    @rule(seconds=st.sampled_from([0.0, 0.01, 1.0, 70.0]))
    def time_passes(self, seconds: float) -> None:
        self.at_s += seconds
        if self.pending is None and not self.state.is_over:
            self.decide(Tick(0.0))

    @precondition(lambda self: not self.state.is_over)
    @rule(target_number=st.integers(0, 2), comes=st.booleans())
    def somebody_asks_for_a_target(self, target_number: int, comes: bool) -> None:
        target = OTHERS[target_number]
        self.ask(Add(targets=(target,)) if comes else Remove(targets=(target.label,)))

    @precondition(lambda self: not self.state.is_over)
    @rule(change=st.sampled_from([ReviewNow(), LoseHost("far"), KillUnit("nobody.1")]))
    def somebody_asks_for_something_else(self, change: Change) -> None:
        self.ask(change)

    @precondition(lambda self: not self.state.is_over and self.running.units)
    @rule(data=st.data(), was_asked=st.booleans())
    def a_unit_dies(self, data: st.DataObject, was_asked: bool) -> None:
        unit = data.draw(st.sampled_from(sorted(self.running.unit)))
        if was_asked:
            self.ask(KillUnit(unit))
        self.running = replace(self.running, units=tuple(u for u in self.running.units if u.id != unit))
        self.decide(UnitDied(unit, "crash"))

    @precondition(lambda self: not self.state.is_over)
    @rule(host=st.sampled_from(["near", "far", "stranger"]), is_lost=st.booleans())
    def a_host_is_lost_or_joins(self, host: str, is_lost: bool) -> None:
        if is_lost:
            self.lost.add(host)
            self.running = replace(self.running, units=tuple(u for u in self.running.units if u.host != host))
        else:
            self.lost.discard(host)
        self.decide(HostLost(host, "cut") if is_lost else HostJoined(host))

    @precondition(lambda self: not self.state.is_over and isinstance(self.pending, ApplyUpdate))
    @rule()
    def a_new_unit_dies(self) -> None:
        assert isinstance(self.pending, ApplyUpdate)
        for unit in self.pending.change_set.started[:1]:
            self.decide(UnitDied(unit.id, "no camera"))

    @precondition(lambda self: isinstance(self.pending, MakePlan))
    @rule(finds=st.booleans(), was_interrupted=st.booleans())
    def a_plan_is_made(self, finds: bool, was_interrupted: bool) -> None:
        order, self.pending = self.pending, None
        assert isinstance(order, MakePlan)
        self.number += 1
        targets = order.plan_input.world.environment.targets
        host = next((host for host in ("far", "near") if not order.plan_input.situation.is_lost(host)), "near")
        started = tuple(
            ComputationUnit(f"count.{self.number}-{one.label}", "count", (), (Publication("n", one.topic),), host)
            for one in targets
        )
        change_set = ChangeSet(started, stopped=tuple(order.plan_input.running.unit)) if finds else None
        met = tuple(target.label for target in targets)
        decision = Decision.APPLIED if finds else Decision.UNDECIDED
        made = Findings(
            order.plan_input.running, self.running, decision=decision, change_set=change_set, met=met if finds else ()
        )
        self.decide(Planned(made, was_interrupted))

    @precondition(lambda self: isinstance(self.pending, ApplyUpdate))
    @rule(error=st.sampled_from([None, None, ApplyError("slow", ()), AbandonedError("late", ()), OSError("bug")]))
    def an_update_ends(self, error: Exception | None) -> None:
        order, self.pending = self.pending, None
        assert isinstance(order, ApplyUpdate)
        if order.basis.units != self.running.units or not self.lost.isdisjoint(
            u.host for u in order.change_set.started
        ):
            error = StaleChangeSetError("others run, or a host is gone")
        if error is None:
            self.running = self.running.update(order.change_set)
        self.decide(Updated(0.1, error))

    @precondition(lambda self: not self.state.is_over)
    @rule(is_closed=st.booleans())
    def the_end_is_asked_for(self, is_closed: bool) -> None:
        if is_closed:
            self.decide(Leave())
        else:
            self.ask(Stop())

    @precondition(lambda self: isinstance(self.pending, StopAll))
    @rule()
    def all_units_are_stopped(self) -> None:
        self.pending = None
        self.decide(Finished())

    @invariant()
    def no_question_is_answered_twice(self) -> None:
        assert len(self.answers) == len(set(map(id, self.answers)))

    @invariant()
    def no_unit_is_known_on_a_host_that_is_gone(self) -> None:
        state = getattr(self, "state", None)
        if state is not None and not isinstance(state.doing, Updating):
            assert self.lost.isdisjoint(known.host for known in state.situation.units.values())

    @invariant()
    def what_is_under_way_is_what_is_known_to_be(self) -> None:
        state, pending = getattr(self, "state", None), getattr(self, "pending", None)
        if state is None or isinstance(pending, StopAll):
            return
        assert isinstance(pending, MakePlan) == isinstance(state.doing, Planning)
        assert isinstance(pending, ApplyUpdate) == isinstance(state.doing, Updating)

    def teardown(self) -> None:
        """Whatever has happened, the end comes, and then every question has had its answer."""
        if not hasattr(self, "state"):
            return
        if not self.state.is_over:
            self.ask(Stop())
        for _ in range(5):
            match self.pending:
                case MakePlan():
                    self.a_plan_is_made(finds=True, was_interrupted=False)
                case ApplyUpdate():
                    self.an_update_ends(error=None)
                case StopAll():
                    self.all_units_are_stopped()
                case None if not self.state.is_over:
                    self.decide(Tick(0.0))
        assert self.state.is_over
        assert {id(one) for one in self.answers} == {id(one.outcome) for one in self.requests_made}
        assert (self.state.entries, self.state.waiting, self.state.stops) == ((), {}, ())


TestDeciding = Deciding.TestCase
TestDeciding.settings = settings(max_examples=100, stateful_step_count=40, deadline=None)
