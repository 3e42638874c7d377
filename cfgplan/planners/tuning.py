"""How the exact planner spends its time: every number that was chosen because of measurements, in one frozen value.

None of them changes an answer that is proven, only how soon it is. Work is counted in steps, about a microsecond each
where they were timed, so that a plan can be repeated on any machine; only a time limit turns them into seconds.
"""

from __future__ import annotations

from collections.abc import Iterator, Sized
from dataclasses import dataclass, field, fields, is_dataclass, replace
from typing import NamedTuple, TypeVar

Number = TypeVar("Number")


class Description(NamedTuple):
    """The description of a tuning number: its unit, its effect in a sentence, and its origin."""

    unit: str
    what: str
    origin: str


LIBRARIES = "random libraries, seeds 20 to 45"
TIMED = "timed beside `scale/tables.md`"
AT_REST = "`benchmark.py replan`"
FLEETS = "`fleets.py`"
DEPLOYMENTS = "`deployments.py`, seeds 0 to 4, 200 to 211, 300 to 305, 507"
MIXED = "the shop, and `deployments.py` with one input that tells apart"
HARD_ONES = "`deployments.py`, seeds 300, 311 and 323 with 20 hosts"
TRANSPORTS = "transport and random libraries with costs alike, seeds 0 to 120"
TOYS = "`toys.py`"
SHARED = "NAO with shared cameras, and libraries with distinct inputs, seeds 501 to 506"
SERVED = "`count`, `optional` and `serves`, below"


def row(value: Number, unit: str, what: str, origin: str) -> Number:
    """Return a dataclass field for a number, with its description."""
    found: Number = field(default=value, metadata={"said": Description(unit, what, origin)})
    return found


@dataclass(frozen=True)
class Decide:
    """The planner's own search of small problems."""

    labels: int = row(600, "labels", "Networks of up to this size are searched before all else.", LIBRARIES)
    left: int = row(400, "labels", "So many that bounds leave are searched in a replan.", "`benchmark.py replan`")
    disjoint: int = row(
        5000,
        "labels",
        "If inputs are distinct, disjoint parts are tried first up to this size.",
        "NAO, 20 to 200 robots",
    )
    choices: int = row(
        100, "facts", "Not if more facts than this have more providers than they take.", "NAO; random libraries"
    )
    fewest: int = row(20, "labels", "With fewer labels it is not asked: its import takes longer than bounds.", SHARED)
    parts: int = row(120, "parts", "The solver chooses among at most this many that share labels.", SHARED)
    contracted: float = row(0.5, "share of the labels", "It also chooses among more, up to this share.", SHARED)
    choosing: float = row(0.03, "the engine's s", "It may take this long.", SHARED)
    round: float = row(0.001, "the engine's s", "Each of its rounds takes this long: a fixed part.", SHARED)
    chained: int = row(
        16, "labels", "Above this size, most expensive chains are charged before the search.", "NAO, 20 robots"
    )
    first: int = row(300, "landmarks and nodes", "The first part of the search may take this many.", LIBRARIES)
    steps: int = row(1500, "landmarks and nodes", "The whole search may take this many; 0: there is none.", LIBRARIES)
    soon: float = row(0.01, "share", "The search goes on if its first part did this much of it.", LIBRARIES)


@dataclass(frozen=True)
class Begin:
    """First plans."""

    attempts: int = row(30, "members", "The planner tries to leave out this many members of a first plan.", LIBRARIES)
    many: int = row(400, "labels", "With fewer labels none is tried, to save time.", "`guard.py`, seeds 7410 to 7425")
    ways: int = row(4, "plans", "This many first plans are tried where transformations are required.", LIBRARIES)
    shares: tuple[float, ...] = row(
        (0.0, 0.5, 2.0, 8.0, 32.0),
        "of the usual cost",
        "What a bounded resource or quality is priced at, in turn, until a plan keeps its bounds.",
        FLEETS,
    )
    placing: float = row(30.0, "steps", "The work for a unit on a host, or a carried stream.", "`limits.py`")


@dataclass(frozen=True)
class Rise:
    """Bounds by landmarks."""

    landmarks: int = row(20, "landmarks", "After this many new ones reduced costs restrict the network.", LIBRARIES)
    patience: float = row(50.0, "steps/label", "The gap must close in so much work, if closing follows.", LIBRARIES)
    narrowed: float = row(2.0, "steps/label^1.5", "At least this, once reduced costs have left labels out.", LIBRARIES)
    last_patience: float = row(20.0, "steps/label^1.5", "The same, if the solver follows at once.", LIBRARIES)
    landmark: float = row(150.0, "steps", "The work for a landmark: a fixed part.", TIMED)
    need: float = row(0.04, "steps/need", "The work for a landmark: for each need in the network.", TIMED)
    link: float = row(5.0, "steps/link", "The work for a landmark or a repair in a deep network: for each link.", TIMED)
    building: float = row(3.0, "steps/member", "The work to build a linear program: for each entry.", TIMED)


@dataclass(frozen=True)
class Replan:
    """Looking ahead while the running plan is optimal, and replanning from there."""

    cases: int = row(4, "labels", "If more of them changed their cost, all plans are bounded together.", AT_REST)
    room: float = row(
        1.05, "times", "Plans up to this multiple of the cost after the most expensive failure are bounded.", AT_REST
    )
    ties: float = row(1.0, "s", "The solver may look so long for another plan at the same cost.", AT_REST)
    many: int = row(100, "labels", "If bounds leave so many, a linear program charges the landmarks.", AT_REST)


@dataclass(frozen=True)
class Close:
    """Bound and plan brought together."""

    work: float = row(5.0, "steps/label^1.5", "Closing may take this much work.", LIBRARIES)
    rounds: int = row(
        25, "linear programs", "At most this many are solved before the network is restricted.", LIBRARIES
    )
    fewest_rounds: int = row(3, "linear programs", "At least this many are, with however many labels.", LIBRARIES)
    round_labels: int = row(
        50_000, "labels", "The rounds before a restriction have this many labels in all.", LIBRARIES
    )
    pace: float = row(0.04, "share of the gap", "Closing goes on if `rounds` rounds close this much.", LIBRARIES)
    far: float = row(
        0.3, "share of the cost", "With a larger gap the solver has little hope: closing goes on.", LIBRARIES
    )
    patience: int = row(100, "times", "Closing may take this much more work if the gap is that large.", LIBRARIES)
    many: int = row(3000, "labels", "From here on a linear program takes long: its rounds get more cuts.", LIBRARIES)
    times: int = row(16, "times", "A round then chooses needs this often, each time for other cuts.", LIBRARIES)
    part: float = row(
        0.25, "share", "From `many` labels on, labels of good plans come first if their share is less.", LIBRARIES
    )
    likely: int = row(12, "linear programs", "This many over these labels precede the next over all.", LIBRARIES)
    far_times: int = row(
        4,
        "times",
        "As `times`, if targets are replanned next, or with fewer than `many` labels and a gap above `far`.",
        LIBRARIES,
    )
    entries: int = row(3, "entries/link", "The first linear program has about this many.", TIMED)
    trust: float = row(0.8, "share", "Repairs reckon labels cheaper by this part of their fraction.", LIBRARIES)
    need: float = row(16.0, "steps/need", "The work for a round: for each need.", TIMED)
    member: float = row(1.4e-3, "steps/member and landmark", "The work for a round: for each pair of these.", TIMED)
    label: float = row(1.2e-2, "steps/label^2", "The work for a round: for each pair of labels.", TIMED)
    repair: float = row(200.0, "steps", "The work for a repair: a fixed part.", TIMED)
    repair_need: float = row(0.15, "steps/need", "The work for a repair: for each need.", TIMED)
    repairs: float = row(0.4, "share", "Repairs get this part of the work that rounds take.", LIBRARIES)
    first_repairs: int = row(300, "repairs", "At most this many follow the first linear program.", LIBRARIES)
    torn: int = row(3, "members", "A repair tears out at most this many.", LIBRARIES)
    noise: float = row(0.3, "", "The standard deviation of the logarithm of a price in a repair.", LIBRARIES)
    in_vain: int = row(150, "repairs", "After this many in vain a new plan is begun.", LIBRARIES)
    missed: float = row(1e-3, "labels", "A landmark is a cut if fractions hit it by this much too little.", LIBRARIES)
    need_noise: float = row(1.0, "labels", "The noise on support where needs are chosen again.", LIBRARIES)
    goals: int = row(8, "facts", "Each choice of needs gives cuts for this many wanted facts.", LIBRARIES)
    nested: int = row(6, "cuts", "Each wanted fact gives at most this many, one behind the other.", LIBRARIES)
    cut: float = row(0.14, "steps/arc", "The work for a cut: for each arc of its graph.", TIMED)
    followed: int = row(60, "rounds", "The support of facts is followed this far.", LIBRARIES)


@dataclass(frozen=True)
class Near:
    """Neighbourhoods of a plan for many targets."""

    targets: int = row(8, "facts", "From so many wanted facts on, neighbourhoods are searched.", LIBRARIES)
    gap: float = row(0.05, "share of the cost", "They are searched if the gap is at least this.", LIBRARIES)
    promising: float = row(0.03, "share of the gap", "Labels in plans so far above the bound are used.", LIBRARIES)
    wider: float = row(3.0, "times", "This share grows so much whenever they end.", LIBRARIES)
    fewest: int = row(4, "facts", "At least this many wanted facts are planned anew together.", LIBRARIES)
    growth: float = row(1.1, "times", "This number grows, or shrinks, if the solver is fast, or slow.", LIBRARIES)
    planned: float = row(0.5, "share", "So often what shares cost in the plan is drawn together.", LIBRARIES)
    used: float = row(0.02, "labels", "A linear program uses a label from this fraction on.", LIBRARIES)
    work: float = row(0.5, "the engine's s", "The solver may take so long for a neighbourhood.", LIBRARIES)
    look: float = row(0.005, "the engine's s", "The bound and the model of one take so long: a fixed part.", TIMED)
    link: float = row(3e-6, "the engine's s/link", "The same for each link.", TIMED)
    kernels: tuple[float, ...] = row(
        (0.3, 0.1, 0.0),
        "fractions",
        "Labels used more than this are searched first, in turn; if the solver has hope, the last only.",
        LIBRARIES,
    )
    kernel: float = row(15.0, "the engine's us/label^1.5", "Each of these searches may take this long.", LIBRARIES)
    small: int = row(1000, "labels", "Below it, probing takes longer than it saves.", LIBRARIES)
    in_vain: float = row(
        12.0, "the engine's us/label^1.5", "Without hope, they end so long after the last cheaper plan.", LIBRARIES
    )
    soon: float = row(5.0, "the engine's us/label^1.5", "If the solver has hope, they end so long after it.", LIBRARIES)
    times: int = row(8, "times", "Needs are chosen so often where one choice gives no missed landmark.", LIBRARIES)
    share: float = row(0.5, "share", "They take at most this part of the time that is left.", LIBRARIES)
    hopeless: float = row(0.08, "share of the cost", "From this gap on the solver has little hope.", LIBRARIES)
    many: int = row(1500, "labels", "With fewer labels left the solver has hope at any gap.", LIBRARIES)
    hopeless_share: float = row(0.9, "share", "They then take this part of the time.", LIBRARIES)


@dataclass(frozen=True)
class Solve:
    """The solver."""

    small: int = row(1000, "booleans", "Below this size of a model, probing takes longer than it saves.", LIBRARIES)
    unexplained: int = row(100, "solutions", "So many that are no plans, for no known reason, are forbidden.", FLEETS)
    tiny: int = row(500, "booleans", "Below this size, a second presolving takes longer than it saves.", LIBRARIES)


@dataclass(frozen=True)
class Cycles:
    """Answer sets for networks with many cycles and few different costs."""

    labels: int = row(100, "labels", "From this size on, answer sets are tried.", TRANSPORTS)
    values: int = row(10, "costs", "They are tried if at most this many differ; 0: never.", TRANSPORTS)
    first: int = row(1000, "conflicts", "The first try may take this many.", TRANSPORTS)
    near: float = row(0.2, "share of the cost", "They go on if the gap to the first plan is at most this.", TRANSPORTS)
    conflicts: int = row(100_000, "conflicts", "They then may take this many more.", TRANSPORTS)


@dataclass(frozen=True)
class Fleets:
    """Fleets: quality, hosts, conflicts, numbers, spares."""

    many: int = row(400, "labels", "From here on, bounded quality is first looked for among few.", FLEETS)
    sizes: tuple[int, ...] = row((50, 100, 200), "labels", "These many are the few, of at least twice as many.", FLEETS)
    look: float = row(0.5, "the engine's s", "Each look among few takes so long.", FLEETS)
    fewer: float = row(1.2, "times", "A relaxation's labels are looked among if so many are there in all.", FLEETS)
    shared: int = row(8, "times", "Where some are told apart, others are counted if places get so few.", MIXED)
    place: float = row(1.0, "the engine's s", "Counted units may take so long to be placed.", DEPLOYMENTS)
    price: float = row(0.05, "the engine's s", "A heaviest pattern of units may take so long.", HARD_ONES)
    recounts: int = row(3, "times", "Units that can't be placed are counted again this often.", DEPLOYMENTS)
    apart: int = row(12, "hosts", "Up to here each is looked at by itself where not all fits.", DEPLOYMENTS)
    company: float = row(10.0, "hosts", "Units with company, or that are it, weigh at most this.", DEPLOYMENTS)
    small: int = row(20_000, "booleans", "Below this size of a fleet's model, probing takes too long.", FLEETS)
    few: int = row(20, "candidates", "Up to here who feeds whom is ordered and relaxed in full.", TOYS)
    wired: int = row(12_000, "booleans", "Below it, relaxing who feeds counted inputs in full takes too long.", SERVED)


@dataclass(frozen=True)
class Quality:
    """Quality of streams: linear cuts."""

    rounds: int = row(40, "linear programs", "At most this many are solved for cuts.", FLEETS)
    guesses: int = row(4, "potentials", "Each round tries this many for each target.", FLEETS)
    passes: int = row(4, "times", "Potentials are made to follow from each other this often.", FLEETS)
    least: float = row(1e-3, "share", "A cut is violated by this much at least.", FLEETS)
    wait: int = row(4, "rounds", "Cuts go on if so many rounds raise the bound by `rise`.", FLEETS)
    rise: float = row(5e-4, "share", "The rise of the bound with which cuts go on.", FLEETS)
    largest: int = row(300_000, "coefficients", "A larger linear program is not built.", FLEETS)
    lifts: int = row(6, "times", "Potentials are raised this often where that costs nothing.", FLEETS)


@dataclass(frozen=True)
class Tuning:
    """All tuning. With `is_solver_only` the planner uses no bounds, first plans or search of its own.

    With `counts`, units are counted if names do not matter. With `reduces`, parts that can't matter are left out first.
    """

    decide: Decide = Decide()
    begin: Begin = Begin()
    rise: Rise = Rise()
    replan: Replan = Replan()
    close: Close = Close()
    near: Near = Near()
    solve: Solve = Solve()
    cycles: Cycles = Cycles()
    fleet: Fleets = Fleets()
    quality: Quality = Quality()
    seconds_per_step: float = row(1e-6, "s/step", "Work counts so long where it is set against a time limit.", TIMED)
    is_solver_only: bool = False
    counts: bool = True
    reduces: bool = True

    @classmethod
    def solver_only(cls) -> Tuning:
        """A tuning with which the solver finds and proves every plan by itself: for tests of the model."""
        return cls(is_solver_only=True, counts=False, reduces=False)

    def without_search(self) -> Tuning:
        """The same without the planner's own search and without disjoint parts."""
        return replace(self, decide=replace(self.decide, steps=0, disjoint=0))

    def rows(self) -> Iterator[tuple[str, object, Description]]:
        """Yield name, value and description of each number."""
        yield from _rows(self, "")


USUAL = Tuning()


def attempts_among(labels: Sized, tuning: Tuning) -> int:
    """Return how many members of a first plan of these labels are tried to be left out."""
    return tuning.begin.attempts if len(labels) >= tuning.begin.many else 0


def _rows(value: object, before: str) -> Iterator[tuple[str, object, Description]]:
    assert is_dataclass(value)
    for one in fields(value):
        mine = getattr(value, one.name)
        if is_dataclass(mine):
            yield from _rows(mine, f"{before}{one.name}.")
        elif "said" in one.metadata:
            yield f"{before}{one.name}", mine, one.metadata["said"]
