"""Transport: crates in stacks, trucks that carry them, hoists that lift them; no action deletes a fact.

These are the depots of the planning competitions without delete effects. Since actions are reversible, facts support
each other in many long cycles, and all actions cost the same.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import permutations, product
from random import Random

from cfgplan.amounts import MICROSECONDS
from cfgplan.domain import Environment, InputPort, OutputPort, Similarity, Target, Transformation
from cfgplan.errors import InvalidValueError
from cfgplan.planning import Problem

Action = tuple[str, tuple[str, ...], tuple[str, ...]]
"""A name, the facts that it needs, and the facts that it gives."""


def transport(seed: int, *, places: int = 3, trucks: int = 2, crates: int = 4, pallets: int = 2) -> Problem:
    """Return a problem of crates in random stacks on the `pallets` of each place; targets are other random stacks.

    Each place has a hoist. A truck drives from any place to any other. Every action is a transformation that costs a
    second; it has inputs and outputs only for facts that do not hold at first.
    """
    if min(places - 1, trucks, crates, pallets) < 1:
        raise InvalidValueError("transport needs two places, a truck, a crate and a pallet at each place")
    random = Random(seed)
    place_of = {f"pallet{place}_{i}": place for place in range(places) for i in range(pallets)}
    names = [f"crate{i}" for i in range(crates)]
    below = _stacked(random, [*place_of], names)
    wanted = below
    while wanted == below:
        wanted = _stacked(random, [*place_of], names)
    place_of |= {crate: place_of[_pallet_under(crate, below)] for crate in names}
    holds = {f"{crate}_on_{surface}" for crate, surface in below.items()}
    holds |= {f"{one}_at_{place}" for one, place in place_of.items()}
    holds |= {f"{one}_clear" for one in place_of if one not in below.values()}
    holds |= {f"truck{i}_at_{random.randrange(places)}" for i in range(trucks)}

    def unmet(facts: Iterable[str]) -> list[str]:
        return [fact for fact in facts if fact not in holds]

    actions = _actions(range(places), [f"truck{i}" for i in range(trucks)], names, place_of)
    library = [_transformation(name, unmet(needs), unmet(gives)) for name, needs, gives in actions]
    tags = {port.tag for action in library for port in (*action.inputs, *action.outputs)}
    targets = [
        Target(tag, tag, f"/{tag}") for tag in unmet(f"{crate}_on_{surface}" for crate, surface in wanted.items())
    ]
    environment = Environment((), tuple(action for action in library if action.outputs), tuple(targets))
    return Problem(environment, Similarity({tag: frozenset({tag}) for tag in sorted(tags)}), 60)


def _stacked(random: Random, pallets: Sequence[str], crates: Sequence[str]) -> dict[str, str]:
    """Return the pallet or crate below each crate: in random order, each is put on a free pallet or crate."""
    below: dict[str, str] = {}
    free = [*pallets]
    for crate in random.sample(crates, len(crates)):
        below[crate] = free.pop(random.randrange(len(free)))
        free.append(crate)
    return below


def _pallet_under(crate: str, below: Mapping[str, str]) -> str:
    surface = below[crate]
    return _pallet_under(surface, below) if surface in below else surface


def _actions(
    places: Sequence[int], trucks: Sequence[str], crates: Sequence[str], surfaces: Mapping[str, int]
) -> Iterator[Action]:
    """All that trucks and hoists may do. `surfaces` are pallets, which stay where they are, and crates."""
    for truck, (here, there) in product(trucks, permutations(places, 2)):
        yield f"drive_{truck}_{here}_{there}", (f"{truck}_at_{here}",), (f"{truck}_at_{there}",)
    for crate, place in product(crates, places):
        lifted, is_here = f"{crate}_lifted_at_{place}", f"{crate}_at_{place}"
        for truck in trucks:
            needs = (f"{truck}_at_{place}",)
            yield f"load_{crate}_{truck}_{place}", (lifted, *needs), (f"{crate}_in_{truck}",)
            yield f"unload_{crate}_{truck}_{place}", (f"{crate}_in_{truck}", *needs), (lifted,)
        for surface, at in surfaces.items():
            if surface != crate and (surface in crates or at == place):
                on, clear = f"{crate}_on_{surface}", f"{surface}_clear"
                yield f"lift_{crate}_{surface}_{place}", (on, is_here, f"{crate}_clear"), (lifted, clear)
                needs = (lifted, clear, f"{surface}_at_{place}")
                yield f"drop_{crate}_{surface}_{place}", needs, (on, is_here, f"{crate}_clear")


def _transformation(label: str, needs: Sequence[str], gives: Sequence[str]) -> Transformation:
    return Transformation(
        label,
        tuple(InputPort(f"in{i}", fact) for i, fact in enumerate(needs)),
        tuple(OutputPort(f"out{i}", fact) for i, fact in enumerate(gives)),
        labor_us=MICROSECONDS,
    )
