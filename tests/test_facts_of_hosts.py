"""Facts of hosts: where transformations may run, why not, and that the plan is that of a file with the choice of hosts
written out.
"""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from cfgplan import api
from cfgplan.domain import Environment, Host, Transformation
from cfgplan.errors import InputError, InvalidValueError
from cfgplan.facts import Fact
from cfgplan.formats.dump import dump_yaml, plain_environment
from cfgplan.formats.plan_file import dump_plan
from cfgplan.planning import Status
from cfgplan.validity import violations
from cfgplan.validity.rules import Rule

FLEET = """
format: cfgplan/1
hosts: [{name: r1}, {name: r2, speed: 0.5}, {name: base, copies: 2, speed: 0.1}]
facts:
  battery: {of: host, declared: 100, unit: "%", hosts: {r2: 90, base: 50}}
  night: {declared: false}
transformations:
  - {label: mapper, requires: battery > 20 and not night, upkeep: 0.1, outputs: {m: Map}}
targets: [{label: map, topic: /map, tag: Map}]
"""


@pytest.fixture
def fleet(tmp_path: Path) -> Path:
    path = tmp_path / "fleet.yaml"
    path.write_text(FLEET, encoding="utf-8")
    return path


def started(path: Path, **settings: str) -> dict[str, str | None]:
    """The host of each unit that the plan starts."""
    named = {f"facts.{name.replace('__', '.')}": value for name, value in settings.items()}
    plan = api.plan(api.match(api.what_if(api.load(path), settings=named)))
    assert plan.change_set is not None
    return {unit.transformation: unit.host for unit in plan.change_set.started}


def test_a_transformation_runs_on_the_cheapest_host_whose_facts_allow_it(fleet: Path) -> None:
    assert started(fleet) == {"mapper": "r1"}
    assert started(fleet, r1__battery="20") == {"mapper": "r2"}
    assert started(fleet, r1__battery="20", r2__battery="3") == {"mapper": "base.1"}


def test_hosts_that_are_barred_are_named_with_the_comparison_and_the_value(fleet: Path) -> None:
    environment = api.what_if(api.load(fleet), settings={"facts.r1.battery": "15"}).environment
    assert environment.left_out == {}
    reason = "needs battery > 20 and not night, battery is 15 % on r1"
    assert environment.barred == {"mapper": {"r1": reason}}
    assert environment.sides["r1.battery > 20"] is False
    assert environment.sides["r2.battery > 20"] is True


def test_what_may_run_on_no_host_is_left_out(fleet: Path) -> None:
    low = {f"facts.{host}.battery": "1" for host in ("r1", "r2", "base.1", "base.2")}
    world = api.what_if(api.load(fleet), settings=low)
    hosts = "base.1", "base.2", "r1", "r2"
    assert world.environment.left_out == {"mapper": " and ".join(f"battery is 1 % on {host}" for host in hosts)}
    assert world.environment.barred == {}
    assert api.plan(api.match(world)).status is Status.INFEASIBLE
    night = api.what_if(api.load(fleet), settings={"facts.night": "true"}).environment
    assert night.left_out == {"mapper": "night is true"}


@pytest.mark.parametrize("pinned", ["false", "true"])
def test_a_unit_moves_away_from_a_host_where_it_may_not_run_any_more(fleet: Path, pinned: str) -> None:
    fleet.write_text(
        FLEET.replace("upkeep: 0.1", f"upkeep: 0.1, pinned: {pinned}")
        + "units: [{id: mapper.1, transformation: mapper, host: r1, topics: {m: [/map]}}]\n",
        encoding="utf-8",
    )
    world = api.what_if(api.load(fleet), settings={"facts.r1.battery": "15"})
    problem = api.match(world)
    (found,) = violations(problem.environment, problem.similarity, None)
    assert (found.rule, found.unit) == (Rule.PLACED, "mapper.1")
    assert "mapper may not run for now: it needs battery > 20" in found.text
    changes = api.plan(problem).change_set
    assert changes is not None
    assert ([unit.host for unit in changes.started], changes.stopped) == (["r2"], ("mapper.1",))


def test_the_digest_knows_the_hosts_that_are_barred_not_the_number(fleet: Path) -> None:
    digests = {}
    for value in ("20", "5", "90"):
        fleet.write_text(FLEET.replace("r2: 90", f"r2: {value}"), encoding="utf-8")
        digests[value] = api.load(fleet).digest
    assert digests["20"] == digests["5"] != digests["90"]


def test_facts_of_hosts_are_written_as_they_are(fleet: Path, tmp_path: Path) -> None:
    environment = api.load(fleet).environment
    now = environment.with_facts({"r1.battery": 15_000_000, "base.2.battery": 1_000_000, "x.battery": 1})
    again = tmp_path / "again.yaml"
    again.write_text(dump_yaml(plain_environment(now, horizon_s=600)), encoding="utf-8")
    read = api.load(again).environment
    assert {key: fact.value for key, fact in read.variable.items()} == {
        "r1.battery": 15_000_000,
        "r2.battery": 90_000_000,
        "base.1.battery": 50_000_000,
        "base.2.battery": 1_000_000,
        "night": False,
    }
    assert now.as_declared.variable == environment.as_declared.variable


def test_a_plan_file_has_the_facts_of_each_host(fleet: Path) -> None:
    world = api.what_if(api.load(fleet), settings={"facts.r1.battery": "15"})
    problem = api.match(world)
    assert '"r1.battery": {\n      "declared": 100.0,\n      "used": 15.0' in dump_plan(api.plan(problem), problem, "x")


OBSERVED = """
format: cfgplan/1
hosts: [{name: r1}, {name: r2}]
facts: {battery: {of: host, declared: 100, by: "Battery_{host}", field: percent, silent: 5s}}
transformations:
  - {label: gauge_r1, host: r1, outputs: {b: Battery_r1}}
  - {label: gauge_r2, host: r2, outputs: {b: Battery_r2}}
  - {label: mapper, requires: battery > 20, outputs: {m: Map}}
targets: [{label: map, topic: /map, tag: Map}]
"""


def test_each_host_has_a_target_for_the_stream_that_observes_its_fact(fleet: Path) -> None:
    fleet.write_text(OBSERVED, encoding="utf-8")
    target = api.load(fleet).environment.target["fact r2.battery"]
    assert (target.tag, target.topic, target.host) == ("Battery_r2", "/facts/r2.battery", "r2")
    assert started(fleet).keys() == {"gauge_r1", "gauge_r2", "mapper"}


def test_what_observes_a_fact_of_a_host_may_not_require_it(fleet: Path) -> None:
    fleet.write_text(OBSERVED.replace("gauge_r2,", "gauge_r2, requires: battery > 5,"), encoding="utf-8")
    with pytest.raises(InputError, match=r"gauge_r2 requires r2\.battery, and observes it"):
        api.match(api.load(fleet))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("of: host, ", "", "a fact of the world has one value for all hosts"),
        ("r2: 90", "r3: 90", "there is no host `r3`"),
        ("r2: 90", "r2: full", "the value on r2 is a word, but its `declared` is a number"),
        ("declared: 100", "declared: 100, by: Battery", "all hosts would get the value of one stream"),
        ("declared: 100", "declared: 100, topic: /battery", "all hosts would get the value of one stream"),
        ("of: host", "of: robot", "this must be host"),
        (
            "hosts: [{name: r1}, {name: r2, speed: 0.5}, {name: base, copies: 2, speed: 0.1}]",
            "",
            "no hosts are",
        ),
    ],
)
def test_what_no_fact_of_hosts_can_be_is_refused_with_its_place(fleet: Path, old: str, new: str, message: str) -> None:
    text = FLEET.replace(old, new, 1)
    fleet.write_text(text, encoding="utf-8")
    with pytest.raises(InputError) as refused:
        api.load(fleet)
    fault = refused.value.faults[0]
    assert message in fault.message
    assert (text.splitlines()[(fault.line or 0) - 1].strip()[:8], bool(fault.mend)) == ("battery:", True)


def test_no_quality_follows_a_fact_of_hosts(fleet: Path) -> None:
    quality = "outputs: {m: {tag: Map, quality: {error: {set: {by: battery, points: [[0, 1], [100, 0]]}}}}}"
    fleet.write_text(
        FLEET.replace("outputs: {m: Map}", quality) + "qualities: [{name: error, better: lower}]\n", encoding="utf-8"
    )
    with pytest.raises(
        InputError, match="a quality can't follow fact `battery`, whose value differs from host to host"
    ):
        api.load(fleet)


def test_a_fact_that_is_set_on_an_unknown_host_is_refused_with_the_ones_there_are(fleet: Path) -> None:
    with pytest.raises(InputError, match=re.escape("there is no fact `r3.battery` (did you mean `r2.battery`?)")):
        api.what_if(api.load(fleet), settings={"facts.r3.battery": "1"})


def test_an_environment_made_in_python_has_facts_of_hosts() -> None:
    with pytest.raises(InvalidValueError, match="a fact of the world has one value for all hosts"):
        Fact("battery", 1, hosts={"a": 2})
    fact = Fact("hot", False, of="host", hosts={"b": True})
    environment = Environment(
        (), (Transformation("t", requires="not hot"),), hosts=(Host("a"), Host("b")), facts=(fact,)
    )
    assert environment.hosts_for(environment.library[0]) == ("a",)
    assert environment.barred == {"t": {"b": "needs not hot, hot is true on b"}}


def test_a_fact_of_the_world_named_like_a_fact_of_one_host_is_refused(fleet: Path) -> None:
    fleet.write_text(FLEET.replace("  night:", "  r1.battery: {declared: 3}\n  night:"), encoding="utf-8")
    with pytest.raises(InputError) as refused:
        api.load(fleet)
    (fault,) = refused.value.faults
    assert "the fact `r1.battery` is taken" in fault.message
    assert (fault.line, bool(fault.mend)) == (6, True)
    with pytest.raises(InvalidValueError, match=r"r1\.battery"):
        Environment(hosts=(Host("r1"),), facts=(Fact("battery", 1, of="host"), Fact("r1.battery", 1)))
