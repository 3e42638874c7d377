"""Facts that are said to a run: what may not run any more is replaced, what may again comes back at once."""

from __future__ import annotations

import pytest
from cfgplan_runtime.lifecycle.changes import SetFact
from cfgplan_runtime.lifecycle.perturbations import FactsChanged
from cfgplan_runtime.lifecycle.reports import Decision
from living import Life, source, started, worker

from cfgplan import api
from cfgplan.domain import Environment, Target
from cfgplan.errors import InputError
from cfgplan.facts import Fact

CLEAR = "visibility >= 3.25"


def life() -> Life:
    library = source(), worker(requires=CLEAR), worker("dear", upkeep_us=900_000)
    facts = Fact("visibility", 4_000_000, "m"), Fact("night", False)
    target = Target("result", worker().outputs[0].tag, "/result")
    environment = Environment(library=library, targets=(target,), facts=facts)
    return started(world=api.world(environment, horizon_s=60))


def test_what_may_not_run_is_replaced_and_comes_back_as_soon_as_it_may() -> None:
    run = life()
    assert run.units == {"count.1", "work.1"}
    review = run.reviewed(SetFact("visibility", "1.5"))
    assert (run.units, dict(review.avoided)) == ({"count.1", "dear.1"}, {"work": "visibility is 1.5 m"})
    assert dict(run.manager.snapshot().left_out) == {"work": "visibility is 1.5 m"}
    back = run.reviewed(SetFact("visibility", "3.25"))
    assert (run.units, back.decision) == ({"count.1", "work.1"}, Decision.APPLIED)
    assert run.perturbations(FactsChanged) == [FactsChanged(("work",)), FactsChanged((), ("work",))]


@pytest.mark.parametrize(("name", "value"), [("visibility", "7"), ("night", "true")])
def test_a_value_on_the_same_side_is_known_and_makes_no_review(name: str, value: str) -> None:
    run = life()
    reviews = len(run.reviews)
    assert run.ask(SetFact(name, value)) is None
    assert (len(run.reviews), run.units) == (reviews, {"count.1", "work.1"})
    assert f"{name} is {value}" in [str(fact).removesuffix(" m") for fact in run.manager.snapshot().facts]


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [("visibilty", "1", "there is no fact"), ("visibility", "dark", "is a number"), ("night", "1", "is true or false")],
)
def test_what_can_not_be_so_is_refused(name: str, value: str, message: str) -> None:
    run = life()
    with pytest.raises(InputError, match=message):
        run.ask(SetFact(name, value))
    assert run.units == {"count.1", "work.1"}


def test_a_preview_and_a_given_plan_see_the_facts_that_were_said() -> None:
    run = life()
    run.reviewed(SetFact("visibility", "1"))
    future = run.manager.preview()
    run.settle()
    assert dict(future.result(0).thought.avoided) == {"work": "visibility is 1 m"}
