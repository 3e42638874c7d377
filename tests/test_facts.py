"""Facts of the world: what transformations require of them, and that the rest of the library is what is planned."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cfgplan import api
from cfgplan.domain import Environment, Transformation
from cfgplan.errors import InputError, InvalidValueError, TagError
from cfgplan.facts import Fact, FactValue, requirement
from cfgplan.formats.dump import dump_yaml, plain_environment
from cfgplan.planning import Status

SURVEY = """
format: cfgplan/1
qualities: [{name: coverage, better: higher, rule: limit, worst: 0, best: 1}]
facts: {visibility: {declared: 1, unit: m}, night: {declared: false}, mode: {declared: survey}}
transformations:
  - {label: high, requires: visibility >= 3.25 and not night, outputs: {p: {tag: Path, quality: {coverage: 1}}}}
  - {label: low, requires: not night, outputs: {p: {tag: Path, quality: {coverage: 0.4}}}}
targets: [{label: path, topic: /path, tag: Path, quality: {coverage: {weight: 0.1}}}]
"""
FACTS: dict[str, st.SearchStrategy[FactValue]] = {
    "v": st.integers(-3, 3).map(lambda value: value * 500_000),
    "night": st.booleans(),
    "mode": st.sampled_from(["survey", "transit"]),
}
COMPARISONS = st.one_of(
    st.builds(
        "v {} {}".format, st.sampled_from([">=", "<=", "<", ">", "=="]), st.sampled_from(["-1", "0", "0.5", "1.5"])
    ),
    st.sampled_from(["night", "night == true", "night == false", "mode == survey", "mode == transit"]),
)
EXPRESSIONS = st.recursive(
    COMPARISONS,
    lambda parts: st.one_of(
        st.builds("({} and {})".format, parts, parts),
        st.builds("({} or {})".format, parts, parts),
        st.builds("not ({})".format, parts),
    ),
    max_leaves=6,
)


@pytest.fixture
def survey(tmp_path: Path) -> Path:
    path = tmp_path / "survey.yaml"
    path.write_text(SURVEY, encoding="utf-8")
    return path


@given(requires=st.lists(EXPRESSIONS, min_size=1, max_size=4), values=st.fixed_dictionaries(FACTS))
def test_what_is_left_out_is_what_python_says_is_false(requires: list[str], values: dict[str, FactValue]) -> None:
    library = tuple(Transformation(f"t{number}", requires=text) for number, text in enumerate(requires))
    facts = tuple(Fact(name, value) for name, value in values.items())
    names = {"v": values["v"] / 1_000_000, "night": values["night"], "mode": values["mode"]}  # type: ignore[operator]
    words = {"true": True, "false": False, "survey": "survey", "transit": "transit"}
    wrong = {f"t{number}" for number, text in enumerate(requires) if not eval(text, {**names, **words})}
    environment = Environment(library=library, facts=facts)
    assert set(environment.left_out) == wrong
    assert {t.label for t in environment.possible.library} == {t.label for t in library} - wrong


def test_the_plan_is_that_of_a_file_without_what_is_left_out(survey: Path) -> None:
    world = api.load(survey)
    found, other = api.plan(api.match(world)), api.plan(api.match(api.what_if(world, without=["high"])))
    assert (found.status, found.change_set, found.cost_us) == (other.status, other.change_set, other.cost_us)
    assert dict(world.environment.left_out) == {"high": "visibility is 1 m"}


@pytest.mark.parametrize(
    ("settings", "started", "left_out"),
    [
        ({"facts.visibility": "4"}, "high.1", {}),
        ({"facts.visibility": "3.25"}, "high.1", {}),
        ({"facts.night": "true"}, None, {"high": "visibility is 1 m and night is true", "low": "night is true"}),
        ({"facts.mode": "transit"}, "low.1", {"high": "visibility is 1 m"}),
    ],
)
def test_other_facts_give_another_plan(
    survey: Path, settings: dict[str, str], started: str | None, left_out: dict[str, str]
) -> None:
    world = api.what_if(api.load(survey), settings=settings)
    assert world.environment.left_out == left_out
    plan = api.plan(api.match(world))
    if started is None:
        assert plan.status is Status.INFEASIBLE
    else:
        assert plan.change_set is not None
        assert [unit.id for unit in plan.change_set.started] == [started]


@pytest.mark.parametrize("setting", [("facts.nite", "true"), ("facts.night", "3"), ("facts.visibility", "dark")])
def test_a_fact_that_can_not_be_so_is_not_supposed(survey: Path, setting: tuple[str, str]) -> None:
    with pytest.raises(InputError, match=re.escape(f"--set {setting[0]}={setting[1]}: ")):
        api.what_if(api.load(survey), settings=dict([setting]))


def test_a_running_unit_that_may_not_run_any_more_is_stopped(survey: Path) -> None:
    world = api.what_if(api.load(survey), settings={"facts.visibility": "4"})
    plan = api.plan(api.match(world))
    assert plan.change_set is not None
    running = replace(world, environment=world.environment.update(plan.change_set))
    changed = api.plan(api.match(api.what_if(running, settings={"facts.visibility": "1"}))).change_set
    assert changed is not None
    assert ([unit.id for unit in changed.started], list(changed.stopped)) == (["low.1"], ["high.1"])


@pytest.mark.parametrize(
    ("requires", "message"),
    [
        ("nihgt", "there is no fact `nihgt`"),
        ("visibility", "fact `visibility` is a number, but is compared with true"),
        ("visibility > deep", "'deep' is not a number"),
        ("visibility >", "a value is missing after >"),
        ("mode >= 3", "fact `mode` is a word, but is compared with 3"),
        ("not (night or", "the requirement ends where a fact is expected"),
        ("night == 1", "fact `night` is true or false, but is compared with 1"),
    ],
)
def test_what_no_fact_can_say_is_refused_with_its_place(survey: Path, requires: str, message: str) -> None:
    survey.write_text(SURVEY.replace("requires: not night", f'requires: "{requires}"'), encoding="utf-8")
    with pytest.raises(InputError) as refused:
        api.load(survey)
    (fault,) = refused.value.faults
    assert message in fault.message
    assert fault.line == 7
    assert fault.mend


@pytest.mark.parametrize("requires", ["visibility = 3", "mode != survey", "visibility ≥ 3"])
def test_a_comparison_of_another_language_gets_the_signs_of_this_one(requires: str) -> None:
    with pytest.raises(TagError) as refused:
        requirement(requires)
    assert refused.value.mend == "compare by >=, <=, >, < or ==; write `not NAME == VALUE` for values that differ"


@pytest.mark.parametrize(
    ("written", "number"),
    [("3.25m", "3.25"), ("3 m", "3"), ("-5%", "-5"), ("3km/h", "3"), ("2e-3 bar", "2e-3")],
)
def test_a_number_with_a_unit_is_asked_for_without_it(written: str, number: str) -> None:
    for spaced in (f"visibility >= {written}", f"night or visibility<{written}"):
        with pytest.raises(TagError) as refused:
            requirement(spaced)
        assert refused.value.mend == f"write the number without its unit: {number}"
    assert requirement(f"visibility >= {number}").comparisons[0].sign == ">="


def test_a_fact_with_a_dot_in_its_name_is_asked_for_in_quotes() -> None:
    with pytest.raises(TagError) as refused:
        requirement("r1.battery > 20")
    assert refused.value.mend == """write a name with such signs in quotes: "'r1.battery'\""""
    assert requirement("'r1.battery' > 20").comparisons[0].fact == "r1.battery"


def test_a_fact_that_is_none_hides_no_other_fault_and_makes_none(survey: Path) -> None:
    survey.write_text(SURVEY.replace("declared: false", "declared: []"), encoding="utf-8")
    with pytest.raises(InputError) as refused:
        api.load(survey)
    assert [fault.message for fault in refused.value.faults] == ["this can't be the value of a fact"]


def test_an_environment_made_in_python_asks_only_about_its_facts() -> None:
    with pytest.raises(InvalidValueError, match="there is no fact `night`"):
        _ = Environment(library=(Transformation("t", requires="night"),)).left_out


def test_an_environment_without_facts_is_not_copied_for_them() -> None:
    environment = Environment(library=(Transformation("camera", (), (), 1, 1),))
    assert environment.with_facts({}) is environment


def test_the_digest_knows_the_side_of_a_comparison_not_the_number(survey: Path) -> None:
    digests = {}
    for value in ("1", "2", "4"):
        survey.write_text(SURVEY.replace("declared: 1,", f"declared: {value},"), encoding="utf-8")
        digests[value] = api.load(survey).digest
    assert digests["1"] == digests["2"] != digests["4"]


OBSERVED = """
format: cfgplan/1
facts: {visibility: {declared: 1, by: Visibility, field: sonar.range, silent: 5s}, night: {declared: false}}
transformations:
  - {label: sensor, inputs: {echo: Echo, map: {tag: Map, optional: true}}, outputs: {v: Visibility}}
  - {label: sonar, outputs: {e: Echo}}
  - {label: mapper, outputs: {m: Map}}
  - {label: high, requires: visibility >= 3.25, outputs: {p: Path}}
targets: [{label: path, topic: /path, tag: Path}]
"""


@pytest.fixture
def observed(tmp_path: Path) -> Path:
    path = tmp_path / "observed.yaml"
    path.write_text(OBSERVED, encoding="utf-8")
    return path


def test_what_observes_a_fact_is_planned_as_a_target_of_the_lowest_priority(observed: Path) -> None:
    world = api.what_if(api.load(observed), settings={"facts.visibility": "4"})
    target = world.environment.target["fact visibility"]
    assert (target.tag, target.topic) == ("Visibility", "/facts/visibility")
    assert target.priority < min(each.priority for each in world.environment.targets if each is not target)
    plan = api.plan(api.match(world))
    assert plan.change_set is not None
    assert [unit.transformation for unit in plan.change_set.started] == ["high", "sensor", "sonar"]


def test_an_observed_fact_is_written_without_its_target(observed: Path, tmp_path: Path) -> None:
    environment = api.load(observed).environment
    written = plain_environment(environment, horizon_s=600)
    assert [target["label"] for target in written["targets"]] == ["path"]
    again = tmp_path / "again.yaml"
    again.write_text(dump_yaml(written), encoding="utf-8")
    assert api.load(again).environment == environment


@pytest.mark.parametrize(
    ("label", "message"),
    [
        ("sensor", "sensor requires visibility, and observes it"),
        ("sonar", "sonar requires visibility, and feeds sensor, which observes it"),
    ],
)
@pytest.mark.parametrize("by_tag", [True, False])
def test_what_observes_a_fact_or_feeds_that_may_not_require_it(
    observed: Path, label: str, message: str, *, by_tag: bool
) -> None:
    text = OBSERVED.replace(f"label: {label},", f"label: {label}, requires: night or visibility < 9,")
    if not by_tag:
        text = text.replace("by: Visibility", "topic: /v").replace(
            "targets: [", "targets: [{label: v, topic: /v, tag: Visibility}, "
        )
    observed.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=re.escape(message)) as refused:
        api.match(api.load(observed))
    (fault,) = refused.value.faults
    assert fault.line == text[: text.index("night or")].count("\n") + 1
    assert fault.mend


def test_what_feeds_only_an_optional_input_of_what_observes_may_require_it(observed: Path) -> None:
    observed.write_text(OBSERVED.replace("mapper,", "mapper, requires: visibility > 2,"), encoding="utf-8")
    assert api.plan(api.match(api.what_if(api.load(observed), without=["path"]))).change_set is not None


@pytest.mark.parametrize(
    ("fact", "message"),
    [
        ("declared: 1, by: Visibility, topic: /path", "a fact is observed `by` a tag or on a `topic`, not by both"),
        ("declared: 1, field: range", "`field` is only for facts with `by` or `topic`"),
        ("declared: 1, silent: 5s", "`silent` is only for facts with `by` or `topic`"),
        ("declared: 1, topic: /pth", "no target has the topic `/pth`"),
        ("declared: 1, by: Visibility and", "the tag ends where"),
    ],
)
def test_what_can_not_observe_is_refused_with_its_place(observed: Path, fact: str, message: str) -> None:
    observed.write_text(
        OBSERVED.replace("declared: 1, by: Visibility, field: sonar.range, silent: 5s", fact), encoding="utf-8"
    )
    with pytest.raises(InputError) as refused:
        api.load(observed)
    (fault,) = refused.value.faults
    assert message in fault.message
    assert (fault.line, bool(fault.mend)) == (3, True)


@pytest.mark.parametrize(
    ("declared", "field", "element", "value"),
    [
        (1, None, 2.25, 2_250_000),
        (1, "range", {"range": 1 / 3}, 333_333),
        (1, "fluid_pressure", {"fluid_pressure": 101_325.5}, 101_325_500_000),
        (1, None, 1_795_881_600.123456789, 1_795_881_600_123_457),
        (1, "sonar.range", {"sonar": {"range": 4}}, 4_000_000),
        (True, None, False, False),
        ("survey", "mode", {"mode": "transit"}, "transit"),
        (1, None, " 12.5 ", 12_500_000),
        (1, None, "0.30000000000000004", 300_000),
        (1, None, "1e-05", 10),
        (1, None, "-2.5E+3", -2_500_000_000),
        (True, None, "False", False),
    ],
)
def test_an_element_says_the_value_of_a_fact(
    declared: FactValue, field: str | None, element: object, value: FactValue
) -> None:
    assert Fact("f", declared, by="F", field=field).value_in(element) == value


@pytest.mark.parametrize(
    ("field", "element", "message"),
    [
        ("range", {"rng": 1}, "has no field 'range'"),
        ("range", 3, "has no field 'range'"),
        (None, {"range": 3}, "is a number, not {'range': 3}"),
        (None, "deep", "is a number, not 'deep'"),
        (None, True, "is a number, not True"),
        (None, None, "is a number, not None"),
        (None, float("nan"), "is not a finite number"),
        (None, "nan", "is not a finite number"),
        (None, float("inf"), "is not a finite number"),
        (None, "-Infinity", "is not a finite number"),
        (None, "snan", "is not a finite number"),
        (None, 1e300, "is too large: the limit is 1,000,000,000,000"),
        (None, 1e13, "is too large: the limit is 1,000,000,000,000"),
    ],
)
def test_an_element_that_says_no_value_is_refused(field: str | None, element: object, message: str) -> None:
    with pytest.raises(InvalidValueError, match=re.escape(message)):
        Fact("f", 1, by="F", field=field).value_in(element)


@pytest.mark.parametrize(("text", "value"), [("1e3", 1_000_000_000), ("2.5e-3", 2_500), (str(0.00001), 10)])
def test_numbers_with_an_exponent_are_numbers_in_files_and_requests(text: str, value: int) -> None:
    assert Fact("f", 1).read(text) == value
    (comparison,) = requirement(f"f >= {text}").comparisons
    assert comparison.value == value


FOLLOWING = """
format: cfgplan/1
qualities: [{name: error, better: lower, unit: m, worst: 5}]
facts: {light: {declared: 1}, night: {declared: false}}
transformations:
  - {label: camera, outputs: {i: {tag: Image, quality: {error: {set: {by: light, points: [[0.2, 0.9], [1, 0.1]]}}}}}}
  - {label: sonar, upkeep: 0.3, outputs: {i: {tag: Image, quality: {error: 0.4}}}}
targets: [{label: image, topic: /image, tag: Image, quality: {error: {at_most: 0.5}}}]
"""


@pytest.fixture
def following(tmp_path: Path) -> Path:
    path = tmp_path / "following.yaml"
    path.write_text(FOLLOWING, encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("light", "error"), [(0, "0.9"), (0.2, "0.9"), (0.4, "0.7"), (0.999999, "0.100001"), (1, "0.1"), (7, "0.1")]
)
def test_a_quality_follows_a_fact(following: Path, light: float, error: str) -> None:
    world = api.what_if(api.load(following), settings={"facts.light": f"{light}"})
    assert world.environment.qualities_now == {"camera/i error": f"{error} m, light is {light}"}
    plan = api.plan(api.match(world))
    assert plan.change_set is not None
    assert [unit.transformation for unit in plan.change_set.started] == ["camera" if light > 0.5 else "sonar"]


def test_the_plan_is_that_of_a_file_with_the_quality_that_follows(following: Path, tmp_path: Path) -> None:
    plain = tmp_path / "plain.yaml"
    plain.write_text(FOLLOWING.replace("{by: light, points: [[0.2, 0.9], [1, 0.1]]}", "0.5"), encoding="utf-8")
    one, other = api.what_if(api.load(following), settings={"facts.light": "0.6"}), api.load(plain)
    assert one.digest == other.digest
    assert api.plan(api.match(one)).change_set == api.plan(api.match(other)).change_set


def test_a_quality_that_follows_a_fact_is_written_so(following: Path, tmp_path: Path) -> None:
    environment = api.load(following).environment
    again = tmp_path / "again.yaml"
    again.write_text(dump_yaml(plain_environment(environment, horizon_s=600)), encoding="utf-8")
    assert api.load(again).environment == environment


def test_facts_bounds_and_points_may_be_pressures_in_pascal(following: Path, tmp_path: Path) -> None:
    """Qualities end at 100,000, facts don't."""
    text = FOLLOWING.replace("light: {declared: 1}", "light: {declared: 101325, by: Light, noise: 250000}")
    text = text.replace("[0.2, 0.9], [1, 0.1]", "[100000, 0.9], [200000, 0.1]")
    following.write_text(text.replace("sonar, upkeep", 'sonar, requires: "light < 150000.5", upkeep'), encoding="utf-8")
    world = api.what_if(api.load(following), settings={"facts.light": "150000"})
    assert world.environment.qualities_now == {"camera/i error": "0.5 m, light is 150000"}
    again = tmp_path / "again.yaml"
    again.write_text(dump_yaml(plain_environment(api.load(following).environment, horizon_s=600)), encoding="utf-8")
    assert api.load(again).environment == api.load(following).environment


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("by: light", "by: lihgt", "there is no fact `lihgt`"),
        ("by: light", "by: night", "a quality can't follow fact `night`, which is true or false"),
        ("[0.2, 0.9], [1", "[1, 0.9], [0.2", "the points by light do not rise"),
        ("[0.2, 0.9], [1", "[1, 0.9], [1", "the points by light do not rise"),
        ("0.9]", "-0.9]", "the value -0.9 of error is out of range"),
        ("[1, 0.1]", "[3, 900000]", "the value 900000 of error is out of range"),
    ],
)
def test_what_follows_no_fact_is_refused_with_its_place(following: Path, old: str, new: str, message: str) -> None:
    following.write_text(FOLLOWING.replace(old, new), encoding="utf-8")
    with pytest.raises(InputError) as refused:
        api.load(following)
    (fault,) = refused.value.faults
    assert message in fault.message
    assert (fault.line, bool(fault.mend)) == (6, True)


def test_a_plan_file_says_which_facts_were_used_and_what_is_declared(survey: Path) -> None:
    world = api.what_if(api.load(survey), settings={"facts.visibility": "4"})
    problem = api.match(world)
    assert json.loads(api.plan_text(world, problem, api.plan(problem)))["facts"] == {
        "visibility": {"declared": 1.0, "used": 4.0},
        "night": {"declared": False, "used": False},
        "mode": {"declared": "survey", "used": "survey"},
    }
