"""Hosts, quality, conflicts, instances and spares in environment files: read, written back, and what is wrong."""

from __future__ import annotations

from pathlib import Path

import pytest
from loading import load, load_text, only_fault, place_of

from cfgplan.domain import Host
from cfgplan.errors import InputError, InvalidValueError
from cfgplan.formats.dump import dump_yaml, plain_environment
from cfgplan.formats.xml_dump import dump_xml
from cfgplan.planning import Failures
from cfgplan.qualities import Better, Contribution, Over, QualityAttribute, QualityRule, Wish

HEAD = """\
format: cfgplan/1
transfer: 0.01
survive: 1
hosts: [{name: base, cpu: 1.5, memory: 100}, {name: piff}]
qualities:
  - {name: error, better: lower, unit: m, worst: 5}
  - {name: rate, better: higher, rule: limit, best: 30}
"""
REST = """\
transformations:
  - label: camera(${NAO})
    host: [base, "${NAO}"]
    memory: 20
    standby: 0.001
    conflicts: [other]
    min_instances: 1
    max_instances: 2
    outputs:
      image: {tag: Image, rate: 2.5, size: 3, quality: {error: {scale: 0.7, of: mean}, rate: 30}}
  - {label: other, host: base}
units:
  - {id: camera.1, transformation: camera(piff), host: piff}
  - {id: camera.2, transformation: camera(piff), host: base, standby: true}
  - {id: other.1, transformation: other}
targets:
  - {label: t, topic: /t, tag: Image, host: base, quality: {error: {at_most: 0.3, weight: 2}, rate: {at_least: 10}}}
"""
TEXT = HEAD + REST.replace("${NAO}", "piff")


def test_all_that_a_fleet_says_is_read(tmp_path: Path) -> None:
    world = load_text(tmp_path, TEXT)
    environment = world.environment
    camera = environment.transformation["camera(piff)"]
    assert environment.hosts == (Host("base", 1_500_000, 100), Host("piff"))
    assert environment.qualities == (
        QualityAttribute("error", Better.LOWER, unit="m", worst=5_000_000),
        QualityAttribute("rate", Better.HIGHER, QualityRule.LIMIT, best=30_000_000),
    )
    assert (environment.transfer_us, world.survive) == (10_000, Failures.HOSTS)
    assert (camera.hosts, camera.memory_mb, camera.standby_us) == (("base", "piff"), 20, 1000)
    assert (camera.conflicts, camera.min_instances, camera.max_instances) == (("other",), 1, 2)
    assert camera.output["image"].bytes_per_s == 8
    assert camera.output["image"].quality == (
        Contribution("error", QualityRule.SCALE, 700_000, Over.MEAN),
        Contribution("rate", QualityRule.LIMIT, 30_000_000),
    )
    assert [(u.id, u.host, u.standby) for u in environment.units] == [
        ("camera.1", "piff", False),
        ("camera.2", "base", True),
        ("other.1", "base", False),
    ]
    wishes = environment.target["t"].quality
    assert wishes == (Wish("error", 300_000, 2_000_000), Wish("rate", 10_000_000))


def test_cpu_and_memory_are_resources_among_others(tmp_path: Path) -> None:
    hosts = "[{name: base, offers: {gpu: 2, memory: 100, cpu: 1.5}}, {name: piff}]"
    text = TEXT.replace("[{name: base, cpu: 1.5, memory: 100}, {name: piff}]", hosts)
    text = text.replace("    memory: 20\n", "    needs: {memory: 20, gpu: 1}\n")
    world = load_text(tmp_path, text)
    assert world.environment.hosts == (Host("base", 1_500_000, 100, {"gpu": 2}), Host("piff"))
    assert [world.environment.host["piff"].room(resource) for resource in ("cpu", "memory", "gpu")] == [None, None, 0]
    camera = world.environment.transformation["camera(piff)"]
    assert (camera.memory_mb, camera.needs) == (20, {"gpu": 1})
    assert camera.takes == {"cpu": 0, "memory": 20, "gpu": 1}
    again = dump_yaml(plain_environment(world.environment, horizon_s=world.horizon_s, survive=world.survive))
    assert "cpu: 1.5\n  memory: 100\n  offers:\n    gpu: 2\n" in again
    assert load_text(tmp_path, again, "again.yaml").digest == world.digest != load_text(tmp_path, TEXT).digest


def test_a_fleet_is_the_same_written_and_read_again(tmp_path: Path) -> None:
    world = load_text(tmp_path, TEXT)
    text = dump_yaml(plain_environment(world.environment, horizon_s=world.horizon_s, survive=world.survive))
    again = load_text(tmp_path, text, "again.yaml")
    assert again.environment == world.environment
    assert again.digest == world.digest


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("cpu: 1.5", "cpu: 1.6"),
        ("survive: 1", "survive: units"),
        ("worst: 5", "worst: 6"),
        ("of: mean", "of: best"),
        ("size: 3", "size: 4"),
        ("standby: 0.001", "standby: 0.002"),
        ("max_instances: 2", "max_instances: 3"),
        ("weight: 2", "weight: 3"),
        ("transfer: 0.01", "transfer: 0.02"),
    ],
)
def test_the_digest_tells_whatever_a_plan_depends_on(tmp_path: Path, old: str, new: str) -> None:
    assert load_text(tmp_path, TEXT).digest != load_text(tmp_path, TEXT.replace(old, new), "other.yaml").digest


def test_templates_name_hosts_too(tmp_path: Path) -> None:
    text = HEAD.replace("{name: piff}", "{name: piff}, {name: puff}") + REST
    environment = load_text(tmp_path, text).environment
    assert environment.transformation["camera(puff)"].hosts == ("base", "puff")


def test_a_library_may_say_more_of_quality_and_hosts_than_an_environment_asks(tmp_path: Path) -> None:
    text = "format: cfgplan/1\ntransformations:\n  - label: a\n    host: piff\n"
    plain = load_text(tmp_path, text + "    outputs: {o: T}\n")
    rich = load_text(tmp_path, text + "    outputs: {o: {tag: T, quality: {error: 1}}}\n", "rich.yaml")
    assert rich.environment == plain.environment
    assert rich.digest == plain.digest


@pytest.mark.parametrize(
    ("old", "new", "message", "mend"),
    [
        ("host: base}\nunits", "host: bas}\nunits", "there is no host `bas`", "did you mean `base`?"),
        ('host: [base, "piff"]', "host: [base, poff]", "there is no host `poff`", "did you mean `piff`?"),
        ("camera(piff), host: piff", "camera(piff)", "does not say on which host it runs", "base, piff"),
        ("conflicts: [other]", "conflicts: [othr]", "no transformation `othr`", "did you mean `other`?"),
        ("conflicts: [other]", "conflicts: [camera(piff)]", "conflicts with itself", "max_instances: 1"),
        (
            "survive: 1",
            "links: [{between: [base, piff and]}]",
            "the selector ends where a label is expected",
            "write a label",
        ),
        (
            "survive: 1",
            "links: [{between: [base, piff], latency: 2}]",
            "no `adds` that names the quality",
            "error, rate",
        ),
        ("survive: 1", "links: [{between: [base, piff], adds: error}]", "no `latency` to add", "add `latency:`"),
        ("survive: 1", "links: [{between: [base, piff], latency: 2, adds: eror}]", "attribute `eror`", "mean `error`?"),
        (
            "survive: 1",
            "links: [{between: [base, piff], latency: 2, adds: rate}]",
            "higher values are",
            "`better: lower`",
        ),
        ("memory: 20", "with: [othr]", "no transformation `othr`", "did you mean `other`?"),
        ("memory: 20", "on: robot and", "the selector ends where a label is expected", "write a label"),
        ("conflicts: [other]", "conflicts: {host: [camera(piff)]}", "conflicts with itself", "per_host: 1"),
        ("conflicts: [other]", "conflicts: {system: [], host: [othr]}", "no transformation `othr`", "mean `other`?"),
        ("conflicts: [other]", "conflicts: {hosts: [other]}", "unknown key `hosts`", "did you mean `host`?"),
        (
            "max_instances: 2",
            "max_instances: 0",
            "`min_instances` is 1, but `max_instances` is 0",
            "raise max_instances",
        ),
        ("quality: {error: {scale", "quality: {eror: {scale", "no quality attribute `eror`", "did you mean `error`?"),
        ("{scale: 0.7, of: mean}", "{scale: 0.7, add: 1}", "exactly one of add, limit, scale and set", None),
        ("scale: 0.7", "scale: 70", "the factor 70 of error is out of range", "write 0 to 10"),
        ("error: {at_most", "error: {at_least", "a lower error is better", "write `at_most`"),
        (
            "rate: {at_least: 10}",
            "rate: {}",
            "the target states no demand on rate",
            "write `at_least`, a `weight`, or both",
        ),
        ("at_most: 0.3", "at_most: -0.3", "-0.3 is negative", "0 or more"),
        ("at_most: 0.3", "at_most: 0.0000001", "finer than a millionth", "at most six decimals"),
        ("worst: 5", "worst: 5, best: 6", "the scale of error is wrong", "exchange worst and best"),
        ("{name: piff}]", "{name: piff}, {name: base}]", "`base` occurs twice", "remove one of them"),
        ("standby: true}", "standby: true, topics: {image: [/t]}}", "it can't have inputs or topics", None),
        ("memory: 20", "memory: 20\n    needs: {memory: 3}", "is written under `memory`", "remove it here"),
        ("memory: 20", "needs: {cpu: 3}", "how much cpu a unit takes is written under `upkeep`", "remove it here"),
        ("memory: 20", "needs: {gpu: 0.5}", "there can't be 0.5 of `gpu`", "write a whole number"),
        ("memory: 20", "needs: {gpu: -1}", "-1 can't be an amount of a resource", "write a whole number from 0 to"),
        ("memory: 20", "needs: {gpu: .nan}", "NaN can't be an amount of a resource", None),
        ("memory: 20", "run: {rate: .nan}", "a rate of NaN is out of range", "write a number above 0"),
        ("memory: 20", 'needs: {"": 1}', "the name is empty", None),
        ("memory: 20", "needs: [gpu]", "this must be a mapping of keys to values", None),
        ("memory: 100}", "memory: 100, offers: {memory: 3}}", "`memory` is said twice", "remove one of the two"),
        (
            "memory: 100}",
            "speed: 0}",
            "0 can't be the speed of a host",
            "write a number from 0.001 to 1000; 1 is where costs",
        ),
        ("memory: 100}", "speed: -1}", "-1 can't be the speed of a host", "write a number from 0.001 to 1000"),
        ("memory: 100}", "offers: {memory: 0.5}}", "there can't be 0.5 of `memory`", None),
        ("host: base, quality", "host: moon, quality", "there is no host `moon`", None),
    ],
)
def test_what_is_wrong_is_told_with_its_mend(
    tmp_path: Path, old: str, new: str, message: str, mend: str | None
) -> None:
    assert old in TEXT
    fault = only_fault(tmp_path, TEXT.replace(old, new))
    assert message in fault.message
    assert mend is None or mend in (fault.mend or "")
    line, column = place_of(fault)
    assert line is not None and line > 1 and column is not None


def test_hosts_can_not_fail_where_none_are_declared(tmp_path: Path) -> None:
    fault = only_fault(tmp_path, "format: cfgplan/1\nsurvive: hosts\n")
    assert place_of(fault) == (2, 10)
    assert fault.mend == "declare `hosts:`, or write `survive: units`"


def test_the_xml_format_refuses_what_it_can_not_say(tmp_path: Path) -> None:
    world = load_text(tmp_path, TEXT)
    with pytest.raises(InvalidValueError, match="the XML format has no"):
        dump_xml(plain_environment(world.environment, horizon_s=world.horizon_s))


def test_the_xml_format_says_memory_instances_and_standby(tmp_path: Path) -> None:
    text = (
        "format: cfgplan/1\ntransformations: [{label: a, memory: 3, min_instances: 1, max_instances: 2, standby: 0.1}]"
    )
    world = load_text(tmp_path, text)
    path = tmp_path / "a.xml"
    path.write_text(dump_xml(plain_environment(world.environment, horizon_s=world.horizon_s)))
    assert load(path).environment == world.environment


def test_copies_are_hosts_with_numbers_whose_name_stands_for_all(tmp_path: Path) -> None:
    text = "hosts: [{name: web, copies: 3, memory: 9, labels: [spot]}, {name: base}]\n"
    more = "transformations: [{label: t, host: web}, {label: u, host: [base, web]}, {label: v, on: web}]\n"
    world = load_text(tmp_path, "format: cfgplan/1\n" + text + more).environment
    webs = ("web.1", "web.2", "web.3")
    assert world.hosts == (Host("base"), *(Host(name, memory_mb=9, labels=("spot", "web")) for name in webs))
    assert [world.hosts_for(t) for t in world.library] == [webs, ("base", *webs), webs]
    assert load_text(tmp_path, dump_yaml(plain_environment(world, horizon_s=1))).environment == world


@pytest.mark.parametrize(
    ("line", "message", "mend"),
    [
        ("hosts: [{name: a, copies: 2}, {name: a.2}]", "`a.2` occurs twice", "remove one of them"),
        ("hosts: [{name: a, copies: 2}, {name: a}]", "`a` occurs twice", "remove one of them"),
        (
            "hosts: [{name: a, copies: 2}]\ntargets: [{label: t, topic: /t, tag: T, host: a}]",
            "`a` stands for 2 hosts",
            "write which one, such as a.1",
        ),
    ],
)
def test_a_name_of_several_hosts_is_taken_and_is_no_one_host(
    tmp_path: Path, line: str, message: str, mend: str
) -> None:
    fault = only_fault(tmp_path, f"format: cfgplan/1\n{line}\n")
    assert (fault.message, fault.mend) == (message, mend)


def test_no_host_has_the_name_of_who_gives_orders_to_hosts(tmp_path: Path) -> None:
    fault = only_fault(tmp_path, "format: cfgplan/1\nhosts: [{name: base}, {name: manager}]\n")
    assert (fault.line, fault.mend) == (2, "name it otherwise")
    assert fault.message == "no host can be called 'manager': the manager has this name"


def test_a_selector_that_is_a_key_is_pointed_at_where_it_ends(tmp_path: Path) -> None:
    path = tmp_path / "env.yaml"
    line = '  - {label: a, outputs: {o: X}, at_most: {"spot and": 1}}'
    head, rest = (
        "format: cfgplan/1\nhosts: [{name: h}]\ntransformations:\n",
        "targets:\n  - {label: t, topic: /t, tag: X}\n",
    )
    path.write_text(f"{head}{line}\n{rest}", encoding="utf-8")
    with pytest.raises(InputError) as caught:
        load(path)
    (fault,) = caught.value.faults
    assert (fault.line, fault.column) == (4, line.index('": 1') + 1)
