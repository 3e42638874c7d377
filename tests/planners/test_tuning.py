"""The numbers that the planner is tuned by: which they are, and that none of them stands elsewhere."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

import cfgplan.planners
from cfgplan.planners.tuning import USUAL

ROOM = Path(cfgplan.planners.__file__).parent
README = Path(__file__).parents[2] / "experiments" / "planning" / "README.md"
NOT_TUNED = {
    "networks/core.py": {"MOST_PASSES", "MOST_DEMANDS", "MOST_LISTED"},
    "networks/greedy.py": {"COST_CAP", "FREE"},
    "closing/program.py": {"FROM_THE_LAST_BASIS", "FINEST", "LARGEST_CHARGES"},
    "closing/separation.py": {"WHOLE", "CREEP"},
    "exact/answer_sets.py": {"LARGEST_WEIGHT"},
    "exact/patterns.py": {"FINE"},
    "exact/quality_numbers.py": {"LEAST_SKIP", "MOST_SKIPS"},
    "exact/search.py": {"EXACT", "LARGEST"},
    "solving/clock.py": {"STOPPING_S", "FIRST_PLAN_S", "FIRST_PLAN_PART_S", "_SLOWEST"},
    "solving/engine.py": {"WIDEST", "LARGEST_PRODUCT"},
}
"""Numbers of which answers, their exactness or what a function means hang, not when it comes to one."""
PARTS = ("bounding", "closing", "exact", "networks", "solving")


def test_the_table_of_the_documentation_is_that_of_the_value() -> None:
    rows = [f"| `{name}` | {value} | {said.unit} | {said.what} | {said.origin} |" for name, value, said in USUAL.rows()]
    table = "\n".join(["| number | value | unit | what it does | chosen on |", "|---|---|---|---|---|", *rows])
    assert table in README.read_text(encoding="utf-8"), table


def test_every_number_says_what_it_does_and_what_it_was_chosen_on() -> None:
    assert len(list(USUAL.rows())) > 60
    assert all(said.what and said.origin for _, _, said in USUAL.rows())


def test_every_number_is_read_by_the_planner() -> None:
    trees = [ast.parse(path.read_text(encoding="utf-8")) for path in ROOM.rglob("*.py")]
    attributes = [node for tree in trees for node in ast.walk(tree) if isinstance(node, ast.Attribute)]
    read = {(ast.unparse(one.value).rpartition(".")[2].strip("_"), one.attr) for one in attributes}
    for part, number in (name.rpartition(".")[::2] for name, _, _ in USUAL.rows()):
        assert not read.isdisjoint((of, number) for of in (part, "tuning", "own")), f"{part}.{number}"


@pytest.mark.parametrize("path", sorted(path for part in PARTS for path in (ROOM / part).glob("*.py")), ids=str)
def test_no_number_stands_at_the_head_of_another_module(path: Path) -> None:
    named = {
        name.id
        for node in ast.parse(path.read_text(encoding="utf-8")).body
        if isinstance(node, ast.Assign) and any(isinstance(n, ast.Constant) for n in ast.walk(node.value))
        for target in node.targets
        for name in ast.walk(target)
        if isinstance(name, ast.Name) and name.id.isupper()
    }
    assert named <= NOT_TUNED.get(path.relative_to(ROOM).as_posix(), set())
