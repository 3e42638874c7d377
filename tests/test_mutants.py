"""The table of mutants goes along with the code that it breaks."""

from __future__ import annotations

from pathlib import Path

import pytest

from experiments.mutation.table import MUTANTS, Mutant

PROJECT = Path(__file__).parents[1]


@pytest.mark.parametrize("file", sorted({mutant.file for mutant in MUTANTS}))
def test_the_text_that_a_mutant_replaces_stands_once_and_its_tests_are_there(file: str) -> None:
    text = (PROJECT / file).read_text(encoding="utf-8")
    mutants: list[Mutant] = [mutant for mutant in MUTANTS if mutant.file == file]
    assert {mutant.broken: text.count(mutant.old) for mutant in mutants} == {mutant.broken: 1 for mutant in mutants}
    assert all((PROJECT / test.partition("::")[0]).exists() for mutant in mutants for test in mutant.tests)
