"""Random worlds with facts and observed qualities: plans, the oracle, the judge and the run's review agree."""

from __future__ import annotations

from experiments.observed.worlds import compared

WORLDS = range(12)


def test_plans_of_random_worlds_are_those_of_the_same_worlds_written_out_and_of_the_runs_next_review() -> None:
    counts, differences = compared(WORLDS)
    assert differences == []
    assert counts["worlds"] == len(WORLDS)
    kinds = ("with units", "with some left out", "with some barred from hosts", "with qualities of hosts")
    assert all(counts[kind] for kind in kinds)
