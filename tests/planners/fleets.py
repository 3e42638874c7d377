"""Small environments with quality, hosts, conflicts, instances and spares, drawn by Hypothesis."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from hypothesis import strategies as st
from worlds import problems

from cfgplan.domain import (
    ALL,
    ComputationUnit,
    Environment,
    Host,
    InputPort,
    Link,
    Objective,
    OutputPort,
    Stream,
    Subscription,
    Target,
    Transformation,
)
from cfgplan.facts import Fact
from cfgplan.planning import Failures, Feature, Problem
from cfgplan.qualities import Better, Contribution, Over, QualityAttribute, QualityRule, Wish
from cfgplan.transformations import RunOptions

MICRO = 1_000_000
HOSTS = (
    Host("h0", 9, 4, {"gpu": 1}, labels=("a",)),
    Host("h1", 6, None, {"gpu": 3}, labels=("a", "b")),
    Host("h2"),
)
SELECTORS = st.sampled_from([None, None, None, None, "a", "not a", "a and not b", "b or h2", "not (a or b)"])
SPEEDS = st.sampled_from([MICRO, MICRO, MICRO // 2, 700_000, 3 * MICRO])
TOGETHER = frozenset(Feature)
"""All that a fleet may ask for at once."""
KNOWN_TO_BOUNDS = TOGETHER - {Feature.OPTIONAL, Feature.COUNTS, Feature.LIMITS}
"""What first plans and bounds know."""
LINKS = st.builds(
    Link,
    st.sampled_from([("a", "a"), ("a", "b"), ("h0", "not h0"), ("h2", "⊤")]),
    st.sampled_from([None, None, 0, 1, 3, 8]),
    st.sampled_from([None, 0, 1, 400_000, 1_500_000]),
)
VALUES = st.sampled_from([0, 1, 2, 3, 5, 8])
LEARNED = st.sampled_from([-3, -1, 1, 4, -MICRO // 3, MICRO // 2])
FACTORS = st.sampled_from([0, MICRO // 3, MICRO // 2, MICRO, 3 * MICRO // 2])


@st.composite
def fleets(draw: st.DrawFn, features: frozenset[Feature], *, most: int = 3) -> Problem:
    """A problem that may use the given features; with all of them it is small enough for the oracle."""
    plain = draw(problems(most=most, special=draw(st.booleans())))
    environment = plain.environment
    hosts = HOSTS[: draw(st.integers(1, 3))] if Feature.HOSTS in features else ()
    rents = st.sampled_from([0, 0, 1, 4])
    energies = st.sampled_from([None, None, plain.horizon_s, 2 * plain.horizon_s + 1])
    hosts = tuple(replace(h, speed=draw(SPEEDS), rent_us=draw(rents), energy=draw(energies)) for h in hosts)
    if hosts and draw(st.integers(0, 3)) == 0:
        hosts = tuple(replace(hosts[0], name=host.name) for host in hosts)
    qualities = draw(attributes()) if Feature.QUALITY in features else ()
    labels = [t.label for t in environment.library]
    library = [draw(transformations(t, labels, hosts, qualities, features)) for t in environment.library]
    targets = [draw(targets_of(target, hosts, qualities)) for target in environment.targets]
    if Feature.RUNS in features and draw(st.sampled_from([True, True, True, False])):
        wanted = draw(st.lists(st.sampled_from(labels), min_size=1, max_size=2, unique=True))
        targets = [*targets[draw(st.integers(0, 1)) :], *(Target(f"a unit of {label}", run=label) for label in wanted)]
    by_label = {t.label: t for t in library}
    survive = None
    if Feature.SURVIVAL in features:
        survive = draw(st.sampled_from([Failures.UNITS, Failures.HOSTS if hosts else Failures.UNITS]))
    units = [draw(placed(unit, by_label.get(unit.transformation), hosts, survive)) for unit in environment.units]
    units = [draw(fed_by_several(unit, units, by_label)) for unit in units]
    transfer_us = draw(st.sampled_from([0, 1, 700_000])) if hosts else 0
    is_ordered = Feature.ORDER in features and draw(st.booleans())
    minimise = draw(st.lists(st.sampled_from(Objective), unique=True, max_size=4)) if is_ordered else ()
    links = draw(st.lists(LINKS, max_size=2)) if len(hosts) > 1 and draw(st.booleans()) else []
    slow = [attribute.name for attribute in qualities if attribute.better is Better.LOWER]
    if slow and Feature.LATENCY in features and draw(st.booleans()):
        links = [
            replace(link, latency=draw(st.sampled_from([1, 2, 5])), adds=draw(st.sampled_from(slow))) for link in links
        ]
    return Problem(
        Environment(
            tuple(units),
            tuple(library),
            tuple(targets),
            hosts,
            qualities,
            transfer_us,
            tuple(links),
            minimise=tuple(minimise),
        ),
        plain.similarity,
        plain.horizon_s,
        plain.max_cost_us,
        survive,
    )


@st.composite
def attributes(draw: st.DrawFn) -> tuple[QualityAttribute, ...]:
    """One or two attributes on short scales."""
    found = []
    for name in ("e", "f")[: draw(st.sampled_from([1, 1, 2]))]:
        better = draw(st.sampled_from(Better))
        low, high = draw(st.sampled_from([0, 0, 2])), draw(st.sampled_from([9, 20]))
        worst, best = (high, low) if better is Better.LOWER else (low, high)
        found.append(QualityAttribute(name, better, worst=worst, best=best))
    return tuple(found)


@st.composite
def transformations(
    draw: st.DrawFn,
    plain: Transformation,
    labels: list[str],
    hosts: tuple[Host, ...],
    qualities: tuple[QualityAttribute, ...],
    features: frozenset[Feature],
) -> Transformation:
    """A transformation with something added of each feature."""
    outputs = []
    for port in plain.outputs:
        stated = []
        for attribute in qualities:
            if draw(st.sampled_from([True, True, True, False])):
                rule = draw(st.sampled_from(QualityRule))
                value = draw(FACTORS if rule is QualityRule.SCALE else VALUES)
                contribution = Contribution(attribute.name, rule, value, draw(st.sampled_from(Over)))
                there = st.sampled_from([host.name for host in hosts] or [None])
                stated.append(contribution.taught(draw(st.dictionaries(there, LEARNED, max_size=2))))
        rate, size = (
            (draw(st.sampled_from([0, MICRO, 2_500_000])), draw(st.sampled_from([0, 1, 3]))) if hosts else (0, 0)
        )
        serves = draw(st.sampled_from([None, 1, 1, 2])) if Feature.LIMITS in features else None
        outputs.append(OutputPort(port.name, port.tag, tuple(stated), rate, size, serves))
    changes: dict[str, object] = {"outputs": tuple(outputs)}
    changes["inputs"] = tuple(draw(inputs(port, features)) for port in plain.inputs)
    if hosts:
        names = [host.name for host in hosts]
        choice = draw(st.sampled_from(["any", "one", "some"]))
        changes["host"] = draw(st.sampled_from(names)) if choice == "one" else None
        changes["hosts"] = tuple(draw(st.sets(st.sampled_from(names), min_size=1))) if choice == "some" else ()
        changes["on"] = draw(SELECTORS)
        changes["memory_mb"] = draw(st.sampled_from([None, 0, 1, 2, 3]))
        changes["seen_us"] = draw(st.sampled_from([{}, {}, {names[0]: (1, 2)}, {names[-1]: (3, 0)}]))
        needs = [{}, {}, {}, {"gpu": 0}, {"gpu": 1}, {"gpu": 2}, {"power": 1}, {"power": 2}]
        changes["needs"] = draw(st.sampled_from(needs))
        changes["run"] = RunOptions(memory_mb=draw(st.sampled_from([None, None, 0, 2])))
    if Feature.CONFLICTS in features:
        changes["conflicts"] = tuple(draw(st.sets(st.sampled_from(labels), max_size=1)) - {plain.label})
        changes["conflicts_on_host"] = tuple(draw(st.sets(st.sampled_from(labels), max_size=1)) - {plain.label})
    if Feature.BESIDE in features:
        changes["beside"] = tuple(draw(st.sets(st.sampled_from(labels), max_size=1)))
    if Feature.INSTANCES in features:
        least = draw(st.sampled_from([0, 0, 0, 0, 1]))
        changes["min_instances"] = least
        changes["max_instances"] = draw(st.sampled_from([None, None, max(1, least), 2]))
        changes["per_host"] = draw(st.sampled_from([None, None, None, 1, 2]))
        changes["at_most"] = draw(st.sampled_from([{}, {}, {}, {"a": 1}, {"⊤": 1, "b": 0}, {"not h0": 1, "a": 2}]))
    if Feature.SURVIVAL in features:
        changes["standby_us"] = draw(st.sampled_from([None, 0, 1, 2]))
    return replace(plain, **changes)  # type: ignore[arg-type]


@st.composite
def inputs(draw: st.DrawFn, plain: InputPort, features: frozenset[Feature]) -> InputPort:
    """An input that may be a service's, optional, worth something, and take several streams."""
    changes: dict[str, object] = {"service": plain.feedback and draw(st.booleans())}
    if Feature.OPTIONAL in features and draw(st.booleans()):
        changes |= {"optional": True, "worth_us": draw(st.sampled_from([0, 0, 1, 3, 8]))}
    if Feature.COUNTS in features:
        changes["count"] = draw(st.sampled_from([1, 1, 2, 2, ALL]))
    return replace(plain, **changes)  # type: ignore[arg-type]


@st.composite
def fed_by_several(
    draw: st.DrawFn, plain: ComputationUnit, units: list[ComputationUnit], library: Mapping[str, Transformation]
) -> ComputationUnit:
    """A unit with further streams at the inputs that take several, and gaps at some optional ones."""
    kind = library.get(plain.transformation)
    if kind is None or plain.standby or all(port.is_usual for port in kind.inputs):
        return plain
    there = [
        Stream(u.id, p.name) for u in units if u.transformation in library for p in library[u.transformation].outputs
    ]
    fed = {s for s in plain.subscriptions if not kind.input[s.port].optional or draw(st.booleans())}
    for port in kind.inputs if there else ():
        if port.count != 1:
            fed |= {Subscription(port.name, stream) for stream in draw(st.sets(st.sampled_from(there), max_size=2))}
    return replace(plain, subscriptions=tuple(fed))


@st.composite
def targets_of(
    draw: st.DrawFn, plain: Target, hosts: tuple[Host, ...], qualities: tuple[QualityAttribute, ...]
) -> Target:
    """A target that may bound or weigh quality, beyond the attribute's scale too, and may be at a host."""
    wishes = []
    for attribute in qualities:
        ends = [max(0, end + by) for end in (attribute.worst, attribute.worst, attribute.best) for by in (-1, 0, 1, 30)]
        bound = draw(st.one_of(st.none(), VALUES, st.sampled_from(ends)))
        weight_us = draw(st.sampled_from([0, 200_000, MICRO]))
        if bound is not None or weight_us:
            wishes.append(Wish(attribute.name, bound, weight_us))
    host = draw(st.sampled_from([None, *(host.name for host in hosts)]))
    return replace(plain, quality=tuple(wishes), host=host)


@st.composite
def placed(
    draw: st.DrawFn,
    plain: ComputationUnit,
    transformation: Transformation | None,
    hosts: tuple[Host, ...],
    survive: Failures | None,
) -> ComputationUnit:
    """A running unit on some host, mostly one that its transformation allows; sometimes a cold spare."""
    host = draw(st.sampled_from([host.name for host in hosts])) if hosts else None
    if survive is not None and transformation is not None and draw(st.sampled_from([False, False, True])):
        return ComputationUnit(plain.id, plain.transformation, host=host, standby=True)
    return replace(plain, host=host)


@st.composite
def clashing_pins(draw: st.DrawFn, features: frozenset[Feature]) -> Problem:
    """A problem in which units of two pinned transformations run, which mostly conflict or take all room."""
    problem = draw(fleets(features, most=3).filter(lambda drawn: len(drawn.environment.library) > 1))
    environment = problem.environment
    labels = draw(st.permutations([t.label for t in environment.library]))[:2]
    clash = draw(st.sampled_from([{"conflicts": (labels[1],)}, {"conflicts_on_host": (labels[1],)}, {}]))
    library = tuple(
        replace(t, pinned=t.label in labels, inputs=() if draw(st.booleans()) else t.inputs)
        for t in environment.library
    )
    library = tuple(replace(t, **clash) if t.label == labels[0] else t for t in library)
    there = {unit.transformation for unit in environment.units}
    host = environment.hosts[0].name if environment.hosts else None
    new = tuple(ComputationUnit(f"{label}.1", label, host=host) for label in labels if label not in there)
    units = (*(u for u in environment.units if u.id not in {one.id for one in new}), *new)
    return replace(problem, environment=replace(environment, library=library, units=units))


@st.composite
def on_flat_scales(draw: st.DrawFn, features: frozenset[Feature], *, most: int = 3) -> Problem:
    """A problem with an attribute whose worst value is its best."""
    problem = draw(fleets(features, most=most))
    qualities = problem.environment.qualities
    which = draw(st.sampled_from(qualities)).name
    at = draw(st.sampled_from([0, 3, 9]))
    flat = tuple(replace(one, worst=at, best=at) if one.name == which else one for one in qualities)
    return replace(problem, environment=replace(problem.environment, qualities=flat))


@st.composite
def with_words_that_do_nothing(draw: st.DrawFn, plain: st.SearchStrategy[Problem]) -> Problem:
    """A problem with one more transformation, which nothing can feed, and of which something special is said."""
    problem = draw(plain)
    environment = problem.environment
    labels = [t.label for t in environment.library]
    more: dict[str, object] = draw(
        st.sampled_from(
            [
                {"required": True},
                {"pinned": True},
                {"max_instances": 2},
                {"per_host": 1},
                {"at_most": {"a": 1}},
                {"beside": (labels[0],)},
                {"conflicts": (labels[0],)},
                {"conflicts_on_host": (labels[0],)},
                {"standby_us": 0},
                {"inputs": (InputPort("z", "Z"), InputPort("o", "A", optional=True))},
                {"inputs": (InputPort("z", "Z"), InputPort("o", "A", optional=True, worth_us=5))},
                {"inputs": (InputPort("z", "Z"), InputPort("o", "A", count=2))},
                {"inputs": (InputPort("z", "Z"), InputPort("o", "A", count=ALL, feedback=True))},
                {"outputs": (OutputPort("x", "A", serves=1),)},
            ]
        )
    )
    label = draw(st.sampled_from(["a", "zz"]))
    idle = replace(Transformation(label, (InputPort("z", "Z"),), (OutputPort("x", "A"),), 0, 0), **more)  # type: ignore[arg-type]
    return replace(problem, environment=replace(environment, library=(*environment.library, idle)))


@st.composite
def with_facts(draw: st.DrawFn, plain: st.SearchStrategy[Problem]) -> Problem:
    """A problem whose transformations may require facts of the world, or of hosts if it has some."""
    problem = draw(plain)
    environment = problem.environment
    numbers = st.integers(0, 2).map(lambda value: value * MICRO)
    facts = [Fact("night", draw(st.booleans())), Fact("v", draw(numbers))]
    requirements = [None, None, None, "night", "not night", "v >= 1", "v < 2 or night"]
    if environment.hosts:
        low = draw(st.sets(st.sampled_from([host.name for host in environment.hosts]), max_size=2))
        charges = {host: draw(numbers) for host in sorted(low)}
        facts.append(Fact("charge", 2 * MICRO, of="host", hosts=charges))
        requirements += ["charge >= 1", "charge == 2 and not night", "charge > 0 or v == 2"]
    library = [replace(t, requires=draw(st.sampled_from(requirements))) for t in environment.library]
    environment = replace(environment, library=tuple(library), facts=tuple(facts))
    return replace(problem, environment=environment.possible)


def reordered(problem: Problem, draw: st.DrawFn) -> Problem:
    """The same problem with all its lists in another order."""
    environment = problem.environment
    library = [
        replace(t, inputs=tuple(draw(st.permutations(t.inputs))), outputs=tuple(draw(st.permutations(t.outputs))))
        for t in draw(st.permutations(environment.library))
    ]
    return replace(
        problem,
        environment=replace(
            environment,
            units=tuple(draw(st.permutations(environment.units))),
            library=tuple(library),
            targets=tuple(draw(st.permutations(environment.targets))),
            hosts=tuple(draw(st.permutations(environment.hosts))),
            qualities=tuple(draw(st.permutations(environment.qualities))),
        ),
    )


@st.composite
def nearly_plain(draw: st.DrawFn, *, most: int = 3) -> Problem:
    """A problem whose words do little or nothing: hosts with room, wide limits, inputs that start nothing, and all that
    is said of a transformation that can't be started.
    """
    plain = draw(problems(most=most, special=draw(st.booleans())))
    environment, labels = plain.environment, [t.label for t in plain.environment.library]
    room, rent = st.sampled_from([None, None, 5, 40]), st.sampled_from([0, 0, 1])
    speed = st.sampled_from([MICRO, MICRO, 2 * MICRO])
    hosts = tuple(
        Host(f"h{i}", draw(room), draw(room), rent_us=draw(rent), speed=draw(speed))
        for i in range(draw(st.sampled_from([0, 1, 1, 2])))
    )
    unusable = Transformation(
        "unusable",
        (InputPort("gap", "Nothing"), InputPort("i", "A", count=draw(st.sampled_from([1, 2, ALL])))),
        (OutputPort("x", "A", serves=1),),
        conflicts=(labels[0],),
        beside=(labels[-1],),
        max_instances=2,
        per_host=1,
    )
    library = [draw(with_little_said(t, hosts)) for t in environment.library]
    at = st.sampled_from([host.name for host in (*hosts[:1], *hosts)]) if hosts else st.none()
    units = [replace(unit, host=draw(at)) for unit in environment.units]
    units = [draw(fed_by_several(unit, units, {t.label: t for t in library})) for unit in units]
    minimise = draw(
        st.sampled_from([(), (), (Objective.HOSTS,), (Objective.HOSTS, Objective.REWIRED), (Objective.RENT,)])
    )
    links = (Link(("h0", "h1"), bandwidth=draw(st.sampled_from([None, 1]))),) if draw(st.booleans()) else ()
    return Problem(
        Environment(
            tuple(units),
            (*library, unusable),
            environment.targets,
            hosts,
            links=links,
            minimise=minimise,
            transfer_us=draw(st.sampled_from([0, 700_000])),
        ),
        plain.similarity,
        plain.horizon_s,
        plain.max_cost_us,
    )


@st.composite
def with_little_said(draw: st.DrawFn, plain: Transformation, hosts: tuple[Host, ...]) -> Transformation:
    """A transformation with a limit, or an input that starts nothing."""
    idle = ()
    if draw(st.booleans()):
        count = draw(st.sampled_from([1, 1, 2, ALL]))
        tag, feedback = draw(st.sampled_from("ABCD")), draw(st.booleans())
        idle = (InputPort("idle", tag, optional=True, count=count, feedback=feedback),)
    serves = draw(st.sampled_from([None, None, 1, 9]))
    rate_uhz = draw(st.sampled_from([0, MICRO])) if hosts else 0
    return replace(
        plain,
        inputs=(*plain.inputs, *idle),
        outputs=tuple(replace(port, serves=serves, rate_uhz=rate_uhz, size_bytes=1) for port in plain.outputs),
        max_instances=draw(st.sampled_from([None, None, 1, 2])),
        memory_mb=draw(st.sampled_from([None, 1, 3])) if hosts else None,
    )
