"""How the exact planner spends its time: every number that was chosen because of measurements, in one frozen value.

None of them changes an answer that is proven, only how soon it is. Work is counted in steps, about a microsecond each
where they were timed, so that a plan can be repeated on any machine; only a time limit turns them into seconds.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Annotated, NamedTuple, get_type_hints


class Said(NamedTuple):
    """What is said of a number: its unit, what it does, and what it was chosen on."""

    unit: str
    what: str
    origin: str


LIBRARIES = "random libraries, seeds 20 to 45"
TIMED = "timed beside `scale/tables.md`"
AT_REST = "`benchmark.py replan`"
FLEETS = "`fleets.py`"


@dataclass(frozen=True)
class Decide:
    """The planner's own search of small problems."""

    labels: Annotated[int, Said("labels", "so many a network may have that is searched before all else", LIBRARIES)] = (
        600
    )
    left: Annotated[int, Said("labels", "so many bounds may leave of one that is searched then", LIBRARIES)] = 200
    filtered: Annotated[int, Said("labels", "of more, those too dear by themselves are left out first", LIBRARIES)] = (
        120
    )
    chained: Annotated[int, Said("labels", "of more, chains are charged first", "NAO, 20 robots")] = 16
    first: Annotated[int, Said("landmarks and nodes", "at first", LIBRARIES)] = 300
    steps: Annotated[int, Said("landmarks and nodes", "in all; 0: nothing is searched", LIBRARIES)] = 1500
    soon: Annotated[float, Said("share", "so much must be done at first to go on", LIBRARIES)] = 0.01


@dataclass(frozen=True)
class Begin:
    """First plans."""

    attempts: Annotated[int, Said("members", "of a plan that are tried to be done without", LIBRARIES)] = 30
    ways: Annotated[int, Said("plans", "that are tried if transformations are required", LIBRARIES)] = 4
    shares: Annotated[
        tuple[float, ...], Said("of the usual cost", "for what bounds are on, until a plan keeps them", FLEETS)
    ] = (0.0, 0.5, 2.0, 8.0, 32.0)


@dataclass(frozen=True)
class Rise:
    """Bounds by landmarks."""

    landmarks: Annotated[int, Said("landmarks", "after so many the network is restricted", LIBRARIES)] = 20
    patience: Annotated[float, Said("steps/label^1.5", "landmarks may take where closing follows", LIBRARIES)] = 2.0
    last_patience: Annotated[float, Said("steps/label^1.5", "and where the solver follows", LIBRARIES)] = 20.0
    landmark: Annotated[float, Said("steps", "for a landmark", TIMED)] = 150.0
    need: Annotated[float, Said("steps/need", "for a landmark", TIMED)] = 0.04
    link: Annotated[float, Said("steps/link", "for a landmark or a repair where the way is deep", TIMED)] = 5.0
    building: Annotated[float, Said("steps/member", "until a linear program begins", TIMED)] = 3.0


@dataclass(frozen=True)
class Replan:
    """Looking ahead where nothing is to be changed, and replanning from there."""

    cases: Annotated[int, Said("labels", "if more changed their costs all plans are looked at together", AT_REST)] = 4
    room: Annotated[float, Said("times", "what the dearest failure costs is bounded", AT_REST)] = 1.05
    rival: Annotated[float, Said("s", "the solver may look for a plan as cheap", AT_REST)] = 1.0


@dataclass(frozen=True)
class Close:
    """Bound and plan brought together."""

    work: Annotated[float, Said("steps/label^1.5", "in all", LIBRARIES)] = 5.0
    rounds: Annotated[int, Said("linear programs", "before the network is restricted", LIBRARIES)] = 25
    fewest_rounds: Annotated[int, Said("linear programs", "with many labels", LIBRARIES)] = 3
    round_labels: Annotated[int, Said("labels", "of all rounds before the network is restricted", LIBRARIES)] = 50_000
    pace: Annotated[float, Said("share of the gap", "so many rounds must close to go on", LIBRARIES)] = 0.04
    far: Annotated[float, Said("share of the plan", "of a gap that leaves the solver little hope", LIBRARIES)] = 0.3
    patience: Annotated[int, Said("times", "as much work then", LIBRARIES)] = 100
    again: Annotated[int, Said("landmarks", "charged greedily that a round adds again", LIBRARIES)] = 40
    many: Annotated[int, Said("transformations", "with which a linear program takes long", LIBRARIES)] = 3000
    times: Annotated[int, Said("times", "needs are taken then, to miss more landmarks", LIBRARIES)] = 4
    entries: Annotated[int, Said("entries/link", "the first linear program has", TIMED)] = 3
    inward: Annotated[float, Said("share", "of the way to what hits all landmarks", LIBRARIES)] = 0.5
    trust: Annotated[float, Said("share", "by which repairs think cheaper what fractions use", LIBRARIES)] = 0.8
    need: Annotated[float, Said("steps/need", "for a round", TIMED)] = 16.0
    member: Annotated[float, Said("steps/member and landmark", "for a round", TIMED)] = 1.4e-3
    label: Annotated[float, Said("steps/label^2", "for a round", TIMED)] = 1.2e-2
    repair: Annotated[float, Said("steps", "for a repair", TIMED)] = 200.0
    repair_need: Annotated[float, Said("steps/need", "for a repair", TIMED)] = 0.15
    repairs: Annotated[float, Said("share", "of the work that repairs get", LIBRARIES)] = 0.4
    first_repairs: Annotated[int, Said("repairs", "at first", LIBRARIES)] = 300
    torn: Annotated[int, Said("members", "torn out of a plan at a time", LIBRARIES)] = 3
    noise: Annotated[float, Said("", "standard deviation of the logarithm of a price", LIBRARIES)] = 0.3
    in_vain: Annotated[int, Said("repairs", "in vain before a new plan is torn", LIBRARIES)] = 150
    missed: Annotated[float, Said("labels", "by which a landmark is hit too little", LIBRARIES)] = 1e-3
    need_noise: Annotated[float, Said("labels", "on needs that are taken again", LIBRARIES)] = 1.0
    goals: Annotated[int, Said("facts", "for which cuts are made", LIBRARIES)] = 8
    nested: Annotated[int, Said("cuts", "one behind the other", LIBRARIES)] = 6
    followed: Annotated[int, Said("rounds", "in which the support of facts is followed", LIBRARIES)] = 60


@dataclass(frozen=True)
class Solve:
    """The solver."""

    small: Annotated[int, Said("booleans", "of a model that probing takes longer for than it saves", LIBRARIES)] = 1000
    tiny: Annotated[int, Said("booleans", "of one that a second presolving does", LIBRARIES)] = 400


@dataclass(frozen=True)
class Fleets:
    """Fleets: quality, hosts, conflicts, numbers, spares."""

    round: Annotated[float, Said("the engine's s", "for the first round for quality", FLEETS)] = 2.0
    growth: Annotated[float, Said("times", "as long is each next round", FLEETS)] = 4.0
    many: Annotated[int, Said("kinds of unit", "of bounded quality, of which few are first", FLEETS)] = 400
    sizes: Annotated[tuple[int, ...], Said("kinds of unit", "looked among, of twice as many", FLEETS)] = (
        50,
        100,
        200,
    )
    look: Annotated[float, Said("the engine's s", "for each of these looks", FLEETS)] = 0.5
    small: Annotated[int, Said("booleans", "of a fleet's model that probing takes too long for", FLEETS)] = 20_000


@dataclass(frozen=True)
class Quality:
    """Quality of streams: first plans and linear cuts."""

    badness_steps: Annotated[int, Said("steps of badness", "from the best to the worst", FLEETS)] = 48
    reach: Annotated[int, Said("times the best badness", "up to which steps go without a bound", FLEETS)] = 3
    attempts: Annotated[int, Said("members", "of a plan that are tried to be done without", FLEETS)] = 40
    rounds: Annotated[int, Said("linear programs", "for cuts", FLEETS)] = 40
    guesses: Annotated[int, Said("potentials", "for each target in a round", FLEETS)] = 4
    enough: Annotated[float, Said("share", "by which a cut is violated that is good enough", FLEETS)] = 0.02
    passes: Annotated[int, Said("times", "potentials are made to follow from each other", FLEETS)] = 4
    least: Annotated[float, Said("share", "by which a cut is violated at least", FLEETS)] = 1e-3
    wait: Annotated[int, Said("rounds", "that must raise the bound", FLEETS)] = 4
    rise: Annotated[float, Said("share", "by which they must", FLEETS)] = 5e-4
    largest: Annotated[int, Said("coefficients", "of the largest linear program", FLEETS)] = 300_000
    gains: Annotated[int, Said("units", "in a row that amplify", FLEETS)] = 12
    few: Annotated[float, Said("share", "of an input in deciding that counts for nothing", FLEETS)] = 0.03
    lifts: Annotated[int, Said("times", "potentials are raised for nothing", FLEETS)] = 6


@dataclass(frozen=True)
class Tuning:
    """All tuning. With `is_solver_only` there are no bounds, no first plans and no search of the planner's own."""

    decide: Decide = Decide()
    begin: Begin = Begin()
    rise: Rise = Rise()
    rest: Replan = Replan()
    close: Close = Close()
    solve: Solve = Solve()
    fleet: Fleets = Fleets()
    quality: Quality = Quality()
    seconds_per_step: Annotated[float, Said("s/step", "where work is set against a time limit", TIMED)] = 1e-6
    is_solver_only: bool = False

    @classmethod
    def solver_only(cls) -> Tuning:
        """A tuning with which the solver finds and proves every plan by itself: for tests of the model."""
        return cls(is_solver_only=True)

    def without_search(self) -> Tuning:
        """The same without a search of the planner's own."""
        return replace(self, decide=replace(self.decide, steps=0))

    def rows(self) -> Iterator[tuple[str, object, Said]]:
        """Name, value and what is said of each number."""
        yield from _rows(self, "")


USUAL = Tuning()


def _rows(value: object, before: str) -> Iterator[tuple[str, object, Said]]:
    assert is_dataclass(value)
    hints = get_type_hints(type(value), include_extras=True)
    for field in fields(value):
        mine = getattr(value, field.name)
        if is_dataclass(mine):
            yield from _rows(mine, f"{before}{field.name}.")
        for said in getattr(hints[field.name], "__metadata__", ()):
            yield f"{before}{field.name}", mine, said
