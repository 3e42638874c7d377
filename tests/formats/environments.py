"""Hypothesis strategies: environments as a file can say them."""

from __future__ import annotations

from hypothesis import strategies as st

from cfgplan.canonical import normal
from cfgplan.domain import (
    START_MODES,
    ComputationUnit,
    Environment,
    InputPort,
    OutputPort,
    Publication,
    RunOptions,
    Stream,
    Subscription,
    Target,
    Transformation,
)

_TRICKY = """on 1.0 1e-3 0x1F null ~ 2026-11-20 ${x} $${NAO} ' " << é⊓ {a} [a] &a *a !t % @ ` | > ? true .inf -.5 =
    <a>&amp; ]]> 🤖"""
TRICKY = st.sampled_from([*_TRICKY.split(), "a b", "a: b", "# no", "- x", "a  b"])
PLAIN = st.text(st.characters(exclude_categories=["C", "Z"]), min_size=1, max_size=6).map(normal)
NAMES = TRICKY | PLAIN
PORTS = NAMES.filter(lambda name: "/" not in name)
TAGS = NAMES
COSTS = st.integers(0, 10**12)
SCALARS = (
    st.none()
    | st.booleans()
    | st.integers(-(10**30), 10**30)
    | st.floats(allow_nan=False, allow_infinity=False)
    | TRICKY
    | st.text(st.characters(exclude_categories=["Cs"]), max_size=8)
)
VALUES = st.recursive(
    SCALARS,
    lambda below: st.lists(below, max_size=3) | st.dictionaries(TRICKY | PLAIN, below, max_size=3),
    max_leaves=6,
)


def run_options(inputs: list[str]) -> st.SearchStrategy[RunOptions]:
    """How units may run that have these input ports."""
    return st.builds(
        RunOptions,
        st.sampled_from([*START_MODES, *inputs]),
        COSTS,
        st.none() if inputs else st.none() | st.floats(0.001, 1000),
        st.integers(1, 1000),
        st.booleans(),
        st.sampled_from([None, 0, 2_000_000, 2_500_001, 10**12]),
        st.none() | st.integers(1, 1000),
        st.booleans(),
        st.booleans(),
        st.sampled_from([None, 1, 2_000_000, 10**12]),
    )


@st.composite
def transformations(draw: st.DrawFn, label: str) -> Transformation:
    """A transformation with any ports, costs and params."""
    ports = draw(st.lists(PORTS, max_size=4, unique=True))
    first_output = draw(st.integers(0, len(ports)))
    return Transformation(
        label,
        tuple(
            InputPort(name, draw(TAGS), draw(st.none() | NAMES), draw(st.booleans())) for name in ports[:first_output]
        ),
        tuple(OutputPort(name, draw(TAGS)) for name in ports[first_output:]),
        draw(COSTS),
        draw(COSTS),
        pinned=draw(st.booleans()),
        required=draw(st.booleans()),
        source=draw(st.none() | NAMES),
        host=draw(st.none() | NAMES),
        kind=draw(st.none() | NAMES),
        params=draw(st.dictionaries(TRICKY | PLAIN, VALUES, max_size=3)),
        run=draw(run_options(ports[:first_output])),
    )


@st.composite
def environments(draw: st.DrawFn) -> Environment:
    """An environment whose references hold and whose units feed each other in no ring."""
    library = [draw(transformations(label)) for label in draw(st.lists(NAMES, max_size=3, unique=True))]
    topics = draw(st.lists(NAMES, max_size=3, unique=True))
    labels = draw(st.lists(NAMES, min_size=len(topics), max_size=len(topics), unique=True))
    targets = [
        Target(label, draw(TAGS), topic, draw(st.integers(-3, 3))) for label, topic in zip(labels, topics, strict=True)
    ]
    units: list[ComputationUnit] = []
    streams: list[Stream] = []
    for unit_id in draw(st.lists(NAMES, max_size=3, unique=True)) if library else ():
        transformation = draw(st.sampled_from(library))
        feeds = {
            p.name: draw(st.lists(st.sampled_from(streams), min_size=1, max_size=2, unique=True))
            for p in transformation.inputs
            if streams and draw(st.booleans())
        }
        published = draw(st.lists(st.sampled_from(topics), max_size=2, unique=True)) if topics else []
        units.append(
            ComputationUnit(
                unit_id,
                transformation.label,
                tuple(Subscription(port, stream) for port, several in feeds.items() for stream in several),
                tuple(
                    Publication(draw(st.sampled_from(transformation.outputs)).name, topic)
                    for topic in published
                    if transformation.outputs
                ),
            )
        )
        streams += [Stream(unit_id, port.name) for port in transformation.outputs]
    return Environment(tuple(units), tuple(library), tuple(targets))
