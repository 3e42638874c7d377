"""Handmade hard cases of any size, each of which is the worst case of some planner.

Every tag matches itself and nothing else.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from random import Random
from types import MappingProxyType

from cfgplan.amounts import MICROSECONDS
from cfgplan.domain import Environment, InputPort, OutputPort, Similarity, Target, Transformation
from cfgplan.errors import InvalidValueError
from cfgplan.planning import Problem


def adversarial(seed: int, *, kind: str, size: int) -> Problem:
    """Return the case `kind` (a key of `KINDS`) of a size; only `cover` depends on the seed."""
    if kind not in KINDS:
        raise InvalidValueError(f"{kind!r} is no adversarial case: there are {', '.join(sorted(KINDS))}")
    if size < 1:
        raise InvalidValueError("the size of a case is at least 1")
    return KINDS[kind](size, Random(seed))


def dedicated(size: int, _: Random) -> Problem:
    """Return `size` targets: each has a transformation that costs 10, and one that costs 11 serves them all."""
    wanted = [f"q{i}" for i in range(size)]
    library = [unit(f"dedicated{i}", 10, (), (tag,)) for i, tag in enumerate(wanted)]
    return problem([*library, unit("shared", 11, (), wanted)], wanted)


def tower(size: int, _: Random) -> Problem:
    """Return `size` floors of two units that each need both units below: linear as a graph, exponential as a tree.

    An alternative costs more than the graph and less than the tree.
    """
    library = [unit("base", 1, (), ("a0", "b0"))]
    for floor in range(1, size + 1):
        below = (f"a{floor - 1}", f"b{floor - 1}")
        library += [unit(f"left{floor}", 1, below, (f"a{floor}",)), unit(f"right{floor}", 1, below, (f"b{floor}",))]
    library.append(unit("roof", 1, (f"a{size}", f"b{size}"), ("q",)))
    return problem([*library, unit("direct", 2 * size + 4, (), ("q",))], ["q"])


def blow_up(size: int, _: Random) -> Problem:
    """Return `size` floors of three alternatives with two inputs from the floor below: (2 * 3) ** size tree nodes."""
    library = [unit(f"source{i}", 3 + i, (), ("c0",)) for i in range(3)]
    for floor in range(1, size + 1):
        library += [unit(f"t{floor}_{i}", 3 + i, (f"c{floor - 1}",) * 2, (f"c{floor}",)) for i in range(3)]
    return problem(library, [f"c{size}"])


def ring(size: int, _: Random) -> Problem:
    """Return a ring of `size` free units that feed each other; any of `size` expensive sources can feed the ring."""
    library = [unit(f"ring{i}", 0, (f"c{i}",), (f"c{(i + 1) % size}", f"q{i}")) for i in range(size)]
    sources = [unit(f"source{i}", 10 + i, (), (f"c{i}",)) for i in range(size)]
    return problem([*library, *sources], [f"q{i}" for i in range(size)])


def fusion(size: int, _: Random) -> Problem:
    """Return a fusion of `size` different transformations; each of `2 * size` sources matches every input."""
    sources = [unit(f"source{i}", 1 + i, (), ("position",)) for i in range(2 * size)]
    inputs = tuple(InputPort(f"in{i}", "position", distinct="sources") for i in range(size))
    fuse = Transformation("fuse", inputs, (OutputPort("out0", "q"),), labor_us=MICROSECONDS)
    return problem([*sources, fuse], ["q"])


def cover(size: int, random: Random) -> Problem:
    """Return a weighted set cover: `size` targets and twice as many transformations that each meet three to six."""
    wanted = [f"q{i}" for i in range(size)]
    library = [unit(f"single{i}", 12, (), (tag,)) for i, tag in enumerate(wanted)]
    for i in range(2 * size):
        given = random.sample(wanted, min(size, random.randint(3, 6)))
        library.append(unit(f"set{i}", random.randint(4, 6) + len(given), (), given))
    return problem(library, wanted)


KINDS: Mapping[str, Callable[[int, Random], Problem]] = MappingProxyType(
    {
        "dedicated": dedicated,
        "tower": tower,
        "blow-up": blow_up,
        "ring": ring,
        "fusion": fusion,
        "cover": cover,
    }
)


def unit(label: str, labor_s: int, needs: Sequence[str], gives: Sequence[str]) -> Transformation:
    """Return a transformation without upkeep, with labor in seconds, demanded tags and offered tags."""
    return Transformation(
        label,
        tuple(InputPort(f"in{i}", tag) for i, tag in enumerate(needs)),
        tuple(OutputPort(f"out{i}", tag) for i, tag in enumerate(gives)),
        labor_us=labor_s * MICROSECONDS,
    )


def problem(library: Sequence[Transformation], wanted: Sequence[str]) -> Problem:
    """Return a problem in which nothing runs, with a target for each wanted tag."""
    tags = {i.tag for t in library for i in t.inputs} | {o.tag for t in library for o in t.outputs} | set(wanted)
    targets = tuple(Target(tag, tag, f"/{tag}") for tag in wanted)
    return Problem(
        Environment((), tuple(library), targets), Similarity({tag: frozenset({tag}) for tag in sorted(tags)}), 60
    )
