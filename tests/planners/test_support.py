"""What rests on what: closures, and cuts that forbid what holds itself up."""

from __future__ import annotations

from cfgplan.planners.solving.support import Support


def two_loops_and_what_rests_on_one() -> Support:
    """0 rests on 1 or source 5, 1 on 0; 2 on 3 or source 6, 3 on 2; 4 on 1 or source 7."""
    support = Support()
    for proposition, choices in {0: (1, 5), 2: (3, 6), 4: (1, 7)}.items():
        support.rests_on_any(proposition, choices)
    for proposition, parts in {1: (0,), 3: (2,), 5: (), 6: (), 7: ()}.items():
        support.rests_on_all(proposition, parts)
    return support


def test_what_can_be_derived_has_an_order() -> None:
    rank = two_loops_and_what_rests_on_one().grounded({0, 1, 2, 3, 4, 5})
    assert sorted(rank, key=rank.__getitem__) == [5, 0, 1, 4]


def test_a_cut_names_the_ways_into_all_that_is_not_grounded() -> None:
    support = two_loops_and_what_rests_on_one()
    assert support.cut({0, 1, 2, 3, 4}, {}) == ([0, 2, 4], [5, 6, 7])
    assert support.cut({0, 1, 2, 3, 5}, support.grounded({0, 1, 2, 3, 5})) == ([2], [6])
