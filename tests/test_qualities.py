"""How quality propagates: each rule once, rounding and the ends of the scale, and that no rule prefers worse inputs."""

from __future__ import annotations

from decimal import Decimal

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cfgplan.errors import InvalidValueError
from cfgplan.qualities import (
    LARGEST_FACTOR,
    LARGEST_QUALITY,
    Better,
    Contribution,
    Over,
    QualityAttribute,
    QualityRule,
    Teller,
    Told,
    Wish,
    is_met,
    micro_units,
    price_us,
    propagated,
    units,
)

LATENCY = QualityAttribute("latency", Better.LOWER)
RATE = QualityAttribute("rate", Better.HIGHER, QualityRule.LIMIT, best=30_000_000)
ERROR = QualityAttribute("error", Better.LOWER, QualityRule.SCALE, worst=5_000_000)


def says(attribute: QualityAttribute, rule: QualityRule, value: int, over: Over = Over.WORST) -> Contribution:
    return Contribution(attribute.name, rule, value, over)


def test_a_latency_is_added_to_that_of_the_slowest_input() -> None:
    assert propagated(LATENCY, says(LATENCY, QualityRule.ADD, 5), [3, 20]) == 25


def test_a_rate_is_that_of_the_slowest_part() -> None:
    assert propagated(RATE, says(RATE, QualityRule.LIMIT, 10), [30, 20]) == 10
    assert propagated(RATE, says(RATE, QualityRule.LIMIT, 25), [30, 20]) == 20


def test_a_fusion_improves_the_mean_of_its_inputs() -> None:
    fusion = says(ERROR, QualityRule.SCALE, 500_000, Over.MEAN)
    assert propagated(ERROR, fusion, [300_000, 500_000]) == 200_000


def test_each_step_rounds_to_the_worse_side() -> None:
    assert propagated(ERROR, says(ERROR, QualityRule.SCALE, 500_000, Over.MEAN), [1, 2]) == 1
    assert propagated(ERROR, says(ERROR, QualityRule.SCALE, 1_000_000, Over.MEAN), [1, 2]) == 2
    assert propagated(RATE, says(RATE, QualityRule.SCALE, 1_000_000, Over.MEAN), [1, 2]) == 1


def test_values_stay_within_the_scale() -> None:
    assert propagated(ERROR, says(ERROR, QualityRule.ADD, 5_000_000), [1]) == 5_000_000
    assert propagated(RATE, says(RATE, QualityRule.SET, 90_000_000), [1]) == 30_000_000
    assert propagated(LATENCY, says(LATENCY, QualityRule.ADD, -5), [3]) == 0


def test_an_output_that_states_nothing_passes_on_the_worst_and_a_source_has_the_worst_there_is() -> None:
    assert propagated(LATENCY, None, [3, 20]) == 20
    assert propagated(ERROR, None, []) == 5_000_000
    assert propagated(RATE, None, []) == 0


def test_a_source_has_its_own_value_whatever_the_rule() -> None:
    assert [propagated(ERROR, says(ERROR, rule, 7), []) for rule in QualityRule] == [7, 7, 7, 7]


def test_the_price_is_for_what_the_best_is_missed_by_rounded_up() -> None:
    assert price_us(RATE, Wish("rate", weight_us=2), 29_000_000) == 2
    assert price_us(LATENCY, Wish("latency", weight_us=1), 1) == 1
    assert price_us(LATENCY, Wish("latency", weight_us=1), 0) == 0


def test_a_bound_is_met_by_itself_and_by_what_is_better() -> None:
    assert [is_met(RATE, Wish("rate", 10), value) for value in (9, 10, 11)] == [False, True, True]
    assert [is_met(ERROR, Wish("error", 10), value) for value in (9, 10, 11)] == [True, True, False]


def test_values_are_exact_in_micro_units() -> None:
    assert micro_units(Decimal("0.3")) == 300_000
    assert units(300_000) == Decimal("0.3")
    for wrong in ("0.0000001", "100001", "NaN"):
        with pytest.raises(InvalidValueError):
            micro_units(Decimal(wrong))


def test_a_scale_the_wrong_way_round_is_refused() -> None:
    with pytest.raises(InvalidValueError, match="scale of rate"):
        QualityAttribute("rate", Better.HIGHER, worst=5, best=4)


@given(st.data())
def test_a_better_input_never_gives_a_worse_output(data: st.DataObject) -> None:
    values = st.integers(0, LARGEST_QUALITY)
    attribute = QualityAttribute("q", data.draw(st.sampled_from(Better)))
    rule = data.draw(st.sampled_from(QualityRule))
    own = data.draw(st.integers(0, LARGEST_FACTOR if rule is QualityRule.SCALE else LARGEST_QUALITY))
    contribution = says(attribute, rule, own, data.draw(st.sampled_from(Over)))
    pairs = data.draw(st.lists(st.tuples(values, values), min_size=1, max_size=4))
    better = [min(pair) if attribute.better is Better.LOWER else max(pair) for pair in pairs]
    worse = [max(pair) if attribute.better is Better.LOWER else min(pair) for pair in pairs]
    after = propagated(attribute, contribution, better), propagated(attribute, contribution, worse)
    assert not attribute.is_better(after[1], after[0])


@pytest.mark.parametrize(
    ("observe", "rule", "message"),
    [
        ("diagnostics.error", QualityRule.SET, r"write diagnostics\.STATUS\.KEY"),
        ("statistics", QualityRule.SET, r"write statistics\.NODE\.age"),
        ("statistics.map.aeg", QualityRule.SET, "topic statistics have no 'aeg': did you mean .age."),
        ("statistics.map.age", QualityRule.ADD, "write `set` in place of `add`"),
    ],
)
def test_what_no_topic_tells_is_refused_with_the_mend(observe: str, rule: QualityRule, message: str) -> None:
    with pytest.raises(InvalidValueError, match=message):
        Contribution("error", rule, 1, observe=observe)


def test_what_a_topic_tells_is_named_by_status_and_key_and_not_read_from_elements() -> None:
    told = Contribution("error", QualityRule.ADD, 1, observe="diagnostics.arm.left: grip.error")
    assert (told.told, told.of_stream) == (Told(Teller.DIAGNOSTICS, "arm.left: grip", "error"), None)
    field = Contribution("error", QualityRule.ADD, 1, observe="pose.error")
    assert (field.told, field.of_stream) == (None, "pose.error")
