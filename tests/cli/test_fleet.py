"""Fleets at the command line: where units run, what quality is reached, what failures cost."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from command import MODELS, Run

FLEET = MODELS / "fleet"


def test_solve_tells_hosts_quality_and_transfers(run: Run) -> None:
    out = run("solve", FLEET / "5-memory-taken.yaml").out
    assert "+ start   small_detector(r2).2    on base" in out
    assert "- stop    small_detector(r2).1    on r2" in out
    assert "Target obstacles: error 0.45 m (at most 0.5 m is asked)" in out
    assert "Host r2: 2 units, 9 % of a core (limit 40 %), 160 of 300 MB." in out
    assert "camera(r2).1/image: r2 -> base, 1.0368 s" in out


def test_the_plan_file_holds_hosts_spares_and_figures(run: Run) -> None:
    document = run("solve", FLEET / "4-base-may-fail.yaml", "--json").document
    spares = [unit for unit in document["change_set"]["started"] if unit.get("standby")]
    assert len(spares) == 4
    assert all("host" in unit for unit in document["change_set"]["started"])
    assert document["survive"] == "hosts"
    assert sum(document["figures"]["cost_us"].values()) == document["cost_us"]
    assert document["figures"]["quality"]["obstacles"]["error"] == 0.45


def test_what_is_to_be_survived_can_be_said_at_the_command_line(run: Run) -> None:
    stage = MODELS / "nao" / "3-puff-registered.yaml"
    assert run("solve", stage, "--json").document["cost_us"] == 18_600_000
    assert run("solve", stage, "--survive", "1", "--json").document["cost_us"] == 19_320_000
    unasked = run("solve", FLEET / "4-base-may-fail.yaml", "--survive", "0", "--json").document
    assert unasked["survive"] is None and unasked["cost_us"] == 163_500_000
    refused = run("solve", stage, "--survive", "hosts")
    assert refused.code == 30 and "no hosts are declared" in refused.err


def test_check_tells_what_a_fleet_violates(run: Run) -> None:
    result = run("check", FLEET / "5-memory-taken.yaml")
    assert result.code == 1
    assert "capacity: the units on r2 take 460 MB of memory, but it has 300 MB of memory" in result.out
    survived = run("check", FLEET / "5-memory-taken.yaml", "--survive", "units", "--json").document
    assert {"capacity", "survives"} == {violation["rule"] for violation in survived["violations"]}


def test_the_front_tells_what_better_quality_costs(run: Run, tmp_path: Path) -> None:
    plot = tmp_path / "front.svg"
    result = run("solve", FLEET / "3-best-map.yaml", "--front", "error", "--json", "--plot", plot)
    assert result.code == 0 and result.document["complete"]
    points = [(point["cost_us"], point["quality"]) for point in result.document["points"]]
    assert points == [(163_501_404, 0.45), (334_138_708, 0.27), (436_037_304, 0.2), (605_638_708, 0.195)]
    assert plot.read_text().startswith("<?xml")


def test_the_front_asks_which_attribute_is_meant(run: Run) -> None:
    result = run("solve", FLEET / "1-start.yaml", "--front")
    assert result.code == 30
    assert "obstacles:error, obstacles:latency" in result.err


def test_a_picture_has_a_frame_for_each_host(run: Run) -> None:
    out = run("graph", FLEET / "4-base-may-fail.yaml", "--format", "mermaid").out
    assert out.count("subgraph") == 3
    assert "(cold spare)" in out and "error 0.45 m" in out


def test_explain_names_the_bound_that_no_wiring_meets(run: Run, tmp_path: Path) -> None:
    text = (MODELS / "nao" / "6-fusion-for-quality.yaml").read_text().replace("at_most: 0.2", "at_most: 0.1")
    for name in ("nao.ttl", "piff.ttl", "puff.ttl", "pipeline.yaml"):
        (tmp_path / name).write_text((MODELS / "nao" / name).read_text())
    path = tmp_path / "env.yaml"
    path.write_text(text)
    result = run("explain", path)
    assert result.code == 10
    assert "asks for error of at most 0.1 m, but the best that any wiring reaches is 0.18 m" in result.out


GPUS = """\
format: cfgplan/1
hosts: [{name: big, offers: {gpu: 2}}, {name: small}]
transformations:
  - {label: detector, needs: {gpu: 2}, outputs: {out: Boxes}}
  - {label: camera, outputs: {out: Image}}
targets:
  - {label: boxes, topic: /boxes, tag: Boxes}
  - {label: image, topic: /image, tag: Image}
"""


def test_a_resource_that_no_host_has_is_named(run: Run, tmp_path: Path) -> None:
    path = tmp_path / "env.yaml"
    path.write_text(GPUS)
    out = run("solve", path).out
    assert "Host big: " in out and " MB, 2 of 2 gpu." in out
    path.write_text(GPUS.replace("gpu: 2}}, {name", "gpu: 1}}, {name"))
    result = run("explain", path)
    assert result.code == 10
    assert "target boxes would have no stream: no host where detector may run has 2 gpu" in result.out


def test_a_resource_that_all_hosts_together_have_too_little_of_is_named(run: Run, tmp_path: Path) -> None:
    path = tmp_path / "env.yaml"
    path.write_text(GPUS.replace("{label: camera,", "{label: camera, needs: {gpu: 1},"))
    result = run("explain", path)
    assert result.code == 10
    assert "asked together: camera, detector need 3 gpu, but all hosts have 2" in result.out
    path.write_text(path.read_text().replace("name: small", "name: small, offers: {gpu: 1}"))
    assert run("solve", path).code == 0


def test_units_that_take_more_of_a_resource_than_their_host_has_are_named(run: Run, tmp_path: Path) -> None:
    path = tmp_path / "env.yaml"
    path.write_text(GPUS + "units: [{id: detector.1, transformation: detector, host: small, topics: {out: [/boxes]}}]")
    assert "capacity: the units on small take 2 gpu, but it has 0" in run("check", path).out


def test_hosts_say_the_power_that_their_energy_lasts_for_and_links_what_they_carry(run: Run) -> None:
    out = run("solve", MODELS / "rescue" / "4-mule-lost.yaml").out
    assert "140 of 500 MB, 3 of 3 W." in out and "11 of 11 W." in out
    assert "Link robot - robot or station: 51120 of 1000000 bytes/s." in out
    assert "No unit on r1." in run("solve", FLEET / "1-start.yaml").out


def test_explain_tells_a_spare_and_a_failure_that_nothing_survives(run: Run) -> None:
    stage = MODELS / "nao" / "7-robot-may-fail.yaml"
    spare = run("explain", stage, "--unit", "bottom_cam(puff).1").out
    assert "is a spare for when something fails" in spare
    assert "without it, target ball would have no stream if host piff fails" in spare


def test_a_run_on_one_computer_refuses_hosts(run: Run) -> None:
    result = run("run", FLEET / "1-start.yaml", "--for", "1s")
    assert result.code == 30
    assert "this run is on one computer, and can't place units on hosts (base, r1, r2)" in result.err


def test_a_run_of_what_has_no_unit_code_says_so_once(run: Run) -> None:
    result = run("run", MODELS / "building" / "office.yaml", "--for", "1s")
    assert result.code == 30
    assert "nothing can be started" in result.err
    assert "no transformation names its unit code" in result.err
    assert "no output matches" not in result.err + result.out


def test_a_selector_that_chooses_no_host_is_warned_of(run: Run, write: Callable[[str], Path]) -> None:
    fleet = (
        "hosts: [{name: base}, {name: r1, labels: [robot]}]\n"
        "links: [{between: [robt, base], bandwidth: 1000}]\n"
        "transformations:\n"
        "  - {label: a, on: robt or spot, outputs: {x: X}}\n"
        "  - {label: b, at_most: {robt: 0, r1: 1}, outputs: {x: X}}\n"
        "targets: [{label: t, topic: /t, tag: X}]\n"
    )
    told = run("check", write(fleet))
    assert told.code == 0
    assert [line for line in told.err.splitlines() if line.startswith("warning: no host fits")] == [
        "warning: no host fits `robt` (did you mean `robot`?): the link between 'robt' and 'base' has no effect",
        "warning: no host fits `robt or spot`: a can't run on any host",
        "warning: no host fits `robt` (did you mean `robot`?): it limits no units of b",
    ]
    assert "no host fits" not in run("check", write(fleet.replace("robt", "robot"))).err
    alone = run("check", write(fleet[fleet.index("transformations") :])).err
    assert "no host fits" not in alone
