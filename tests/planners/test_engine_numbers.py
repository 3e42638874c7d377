"""The engine is not believed beyond its numbers."""

from __future__ import annotations

import pytest
from ortools.sat.python.cp_model import (
    FEASIBLE,
    INFEASIBLE,
    OPTIMAL,
    UNKNOWN,
    CpModel,
    CpSolver,
    CpSolverSolutionCallback,
    CpSolverStatus,
    IntVar,
)

from cfgplan.planners.solving.clock import Clock
from cfgplan.planners.solving.engine import LARGEST_PRODUCT, WIDEST, ExactModel, repeatable_solver, solve


def least_of_three(least: int, largest: int) -> tuple[ExactModel, IntVar]:
    """One of three is taken, the cheapest at `least`, unless all of it counts as the largest."""
    model = ExactModel()
    badness, is_worst = model.new_int_var(0, largest, ""), model.new_bool_var("")
    taken = [model.new_bool_var("") for _ in range(3)]
    model.add_exactly_one(taken)
    model.add(badness == largest).only_enforce_if(is_worst)
    for one, bad in zip(taken, (largest, largest, least), strict=True):
        model.add(badness >= bad).only_enforce_if([one, ~is_worst])
    model.minimize(badness)
    return model, badness


def full_solver() -> CpSolver:
    return repeatable_solver(small=True, tiny=True, time_limit_s=20)


def test_the_engine_is_right_where_it_says_infeasible_of_a_model_with_a_solution() -> None:
    model, badness = least_of_three(99_999_000_000, 100_000_000_000)
    if full_solver().solve(model) != INFEASIBLE:
        pytest.skip("this version of OR-Tools answers right by itself")
    solver, bounds = full_solver(), list[float]()
    assert solve(solver, model, Clock(), learn=bounds.append) == OPTIMAL
    assert solver.value(badness) == 99_999_000_000
    assert max(bounds) <= 99_999_000_000


@pytest.mark.parametrize("largest", [WIDEST, WIDEST + 1])
def test_a_model_is_exact_if_the_engine_can_take_its_variables(largest: int) -> None:
    model, badness = least_of_three(1, largest)
    assert model.is_exact() == (largest == WIDEST)
    solver = full_solver()
    assert solve(solver, model, Clock()) == OPTIMAL
    assert solver.value(badness) == 1


@pytest.mark.parametrize("is_too_large", [False, True])
@pytest.mark.parametrize("where", ["constraint", "objective", "added later"])
def test_a_model_is_exact_if_its_products_are(where: str, is_too_large: bool) -> None:
    model = ExactModel()
    number, runs = model.new_int_var(0, 4, ""), model.new_bool_var("")
    product = (LARGEST_PRODUCT // 4 + is_too_large) * number - runs
    if where == "objective":
        model.maximize(product)
    else:
        if where == "added later":
            assert model.is_exact()
        model.add(product <= 3).only_enforce_if(runs)
    assert model.is_exact() != is_too_large


class Liar(CpSolver):
    """Solves, but says something else."""

    def __init__(self, said: CpSolverStatus) -> None:
        super().__init__()
        self.said = said

    def solve(self, model: CpModel, solution_callback: CpSolverSolutionCallback | None = None) -> CpSolverStatus:
        del solution_callback
        first = model.clone()
        first.clear_objective()  # type: ignore[no-untyped-call]
        first.add(first.get_int_var_from_proto_index(0) == 2 * WIDEST)
        super().solve(first)
        return self.said


@pytest.mark.parametrize(("said", "believed"), [(INFEASIBLE, UNKNOWN), (OPTIMAL, FEASIBLE)])
def test_a_word_of_the_engine_about_large_numbers_stands_only_if_it_says_it_twice(
    said: CpSolverStatus, believed: CpSolverStatus
) -> None:
    model, _ = least_of_three(WIDEST, 2 * WIDEST)
    bounds: list[float] = []
    assert solve(Liar(said), model, Clock(), learn=bounds.append) == believed
    assert not bounds


def test_a_large_objective_that_is_maximised_is_confirmed_too() -> None:
    model = ExactModel()
    number = model.new_int_var(0, 4 * WIDEST, "")
    model.add(3 * number <= 6 * WIDEST + 2)
    model.maximize(2 * number + 1)
    solver, bounds = full_solver(), list[float]()
    assert solve(solver, model, Clock(), learn=bounds.append) == OPTIMAL
    assert solver.value(number) == 2 * WIDEST
    assert bounds[-1] == 4 * WIDEST + 1
