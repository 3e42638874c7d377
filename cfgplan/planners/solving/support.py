"""Support: the AND-OR graph over a model's booleans, its closure, and cuts from it."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection

from cfgplan.onward import derivations


class Support:
    """Each proposition rests on *any* of some others, or on *all* of them; sources rest on all of none.

    A set of true propositions is grounded when each can be derived from sources, in some order.
    Propositions are the indices of a model's booleans.
    """

    def __init__(self) -> None:
        self.any_of: dict[int, tuple[int, ...]] = {}
        self.all_of: dict[int, tuple[int, ...]] = {}
        self._above: dict[int, list[int]] = defaultdict(list)

    def rests_on_any(self, proposition: int, choices: Collection[int]) -> None:
        self.any_of[proposition] = tuple(choices)
        for choice in choices:
            self._above[choice].append(proposition)

    def rests_on_all(self, proposition: int, parts: Collection[int]) -> None:
        self.all_of[proposition] = tuple(dict.fromkeys(parts))
        for part in self.all_of[proposition]:
            self._above[part].append(proposition)

    def grounded(self, true: Collection[int]) -> dict[int, int]:
        """The true propositions that can be derived within `true`, each with its place in the order."""
        missing = defaultdict(int, {p: len(self.all_of[p]) if p in self.all_of else 1 for p in true})
        order = sorted(p for p, number in missing.items() if not number)
        for proposition, _ in derivations(order, self._above, missing):  # those that are not true go below 0
            order.append(proposition)
        return {p: rank for rank, p in enumerate(order)}

    def cut(self, true: Collection[int], rank: Collection[int]) -> tuple[list[int], list[int]]:
        """The ungrounded booleans as a cut (propositions, ways in): any proposition needs one of the ways in.

        The propositions are the true ones that rest on any of others and can't be derived.
        """
        unfounded = [p for p in sorted(true) if p in self.any_of and p not in rank]
        return unfounded, self._ways_into(unfounded)

    def _ways_into(self, unfounded: list[int]) -> list[int]:
        """The choices by which some unfounded propositions can be derived first.

        A choice is dead if it can only be derived after one of them: one of all the parts that it rests on is dead, or
        every choice that it rests on is. Dead choices are left out.
        """
        dead = set(unfounded)
        ahead = list(unfounded)
        alive_choices: dict[int, int] = {}
        while ahead:
            for above in self._above[ahead.pop()]:
                if above in dead:
                    continue
                if above in self.any_of:
                    alive_choices[above] = alive_choices.get(above, len(self.any_of[above])) - 1
                    if alive_choices[above] > 0:
                        continue
                dead.add(above)
                ahead.append(above)
        return sorted({choice for p in unfounded for choice in self.any_of[p] if choice not in dead})
