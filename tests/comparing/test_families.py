from __future__ import annotations

from pathlib import Path

import pytest

from cfgplan.errors import InputError
from cfgplan.planners import PLANNERS
from cfgplan.planning import Problem, Status
from cfgplan.reasons import unmet_reasons
from cfgplan.validity import Rule, violations
from experiments.families import FAMILIES, adversarial, fleet, nao, random_library, replanning, transport
from experiments.families.adversarial import KINDS
from experiments.families.configurations import cheap_configuration
from experiments.study.instances import generated
from experiments.study.suites import wsc_sets

SMALL: list[tuple[str, dict[str, object]]] = [
    ("nao", {"robots": 3, "event": "lost"}),
    ("random_library", {"transformations": 40, "running": 0.4, "outputs": 2}),
    ("replanning", {"transformations": 40, "failures": 2, "gone": 0.5}),
    ("adversarial", {"kind": "cover", "size": 8}),
    ("transport", {"crates": 3}),
    ("fleet", {"transformations": 40, "room": 0.5, "memory": 0.5}),
    ("deployment", {"hosts": 4}),
]


@pytest.mark.parametrize(("family", "parameters"), SMALL)
def test_a_seed_gives_the_same_problem_and_another_seed_another(family: str, parameters: dict[str, object]) -> None:
    build = FAMILIES[family]
    assert build(7, **parameters) == build(7, **parameters)
    assert build(7, **parameters).environment != build(8, **parameters).environment


@pytest.mark.parametrize(("family", "parameters"), SMALL)
@pytest.mark.parametrize("seed", range(5))
def test_every_target_of_a_generated_problem_can_be_met(family: str, parameters: dict[str, object], seed: int) -> None:
    problem = FAMILIES[family](seed, **parameters)
    assert len(problem.environment.targets) > 0
    assert unmet_reasons(problem) == {}


def test_the_parameters_of_a_random_library_are_kept() -> None:
    library = random_library(1, transformations=60, depth=4, arity=3, outputs=2, targets=5).environment.library
    assert len(library) == 60
    assert {len(t.inputs) for t in library} == {0, 3}
    assert {len(t.outputs) for t in library} == {2}
    assert {t.label.split("_")[0] for t in library} == {"t0", "t1", "t2", "t3"}


def test_without_back_edges_inputs_ask_only_for_lower_layers() -> None:
    def climbs(problem: Problem) -> bool:
        return any(
            int(port.tag[1:].split("_")[0]) >= int(t.label[1:].split("_")[0])
            for t in problem.environment.library
            for port in t.inputs
        )

    assert not climbs(random_library(3, back=0.0))
    assert climbs(random_library(3, back=0.5))


def test_distinct_inputs_ask_for_the_same() -> None:
    plain, fused = (random_library(4, distinct=share).environment.library for share in (0.0, 1.0))
    assert not any(port.distinct for t in plain for port in t.inputs)
    fed = [t.inputs for t in fused if t.inputs]
    assert all(port.distinct and port.tag == ports[0].tag for ports in fed for port in ports)
    assert len(plain) == len(fused)


def test_more_sharing_means_fewer_demanded_concepts() -> None:
    def demanded(sharing: float) -> int:
        library = random_library(2, transformations=200, sharing=sharing).environment.library
        return len({port.tag for t in library for port in t.inputs})

    assert demanded(0.9) < demanded(0.0) / 2


def test_a_fleet_has_the_room_that_was_asked_for() -> None:
    def hosts(**parameters: float) -> set[tuple[int | None, int | None]]:
        return {(host.cpu_us, host.memory_mb) for host in fleet(1, targets=2, **parameters).environment.hosts}

    assert hosts(room=2.0, memory=0.5) == {(200_000, 750)}
    assert hosts(room=0) == {(None, None)}


def test_the_digest_of_a_fleet_is_also_of_its_hosts() -> None:
    digests = {generated("fleet", 1, transformations=20, targets=1, room=room).digest for room in (1.0, 1.0, 2.0)}
    assert len(digests) == 2


def test_the_share_of_running_units_is_what_was_asked_for() -> None:
    assert random_library(1, running=0.0).environment.units == ()
    problem = random_library(1, transformations=200, running=0.5)
    assert 80 <= len(problem.environment.units) <= 120
    gaps_only = {Rule.FED, Rule.LEAN, Rule.MET}
    assert {v.rule for v in violations(problem.environment, problem.similarity)} <= gaps_only


@pytest.mark.parametrize("seed", range(5))
def test_the_configuration_that_a_replanning_starts_from_is_valid(seed: int) -> None:
    problem = random_library(seed, targets=5)
    running = cheap_configuration(problem.environment, problem.similarity, problem.horizon_s)
    assert violations(running, problem.similarity) == []
    failed = replanning(seed, targets=5, failures=2).environment
    assert set(running.unit) > set(failed.unit)
    assert len(running.units) - len(failed.units) == 2


@pytest.mark.parametrize("seed", range(4))
def test_to_bring_a_crate_elsewhere_takes_one_action_of_each_kind(seed: int) -> None:
    plan = PLANNERS["cpsat"](transport(seed, places=2, trucks=1, crates=1, pallets=1))
    assert plan.cost_us == 5_000_000
    assert plan.change_set is not None
    kinds = sorted(unit.transformation.split("_")[0] for unit in plan.change_set.started)
    assert kinds == ["drive", "drop", "lift", "load", "unload"]


def test_facts_of_a_transport_give_each_other_back() -> None:
    library = transport(0).environment.library
    by_label = {t.label: t for t in library}
    forth, back = by_label["load_crate0_truck0_1"], by_label["unload_crate0_truck0_1"]
    assert {port.tag for port in forth.outputs} <= {port.tag for port in back.inputs}
    assert {port.tag for port in back.outputs} <= {port.tag for port in forth.inputs}


def test_the_paper_mends_the_lost_segmenter_by_one_new_unit() -> None:
    plan = PLANNERS["cpsat"](nao(0, robots=2, event="lost"))
    assert plan.change_set is not None
    assert [unit.transformation for unit in plan.change_set.started] == ["segmenter(nao01)"]
    assert [unit.id for unit in plan.change_set.rewired] == ["ball_detector(nao01).1"]
    assert plan.change_set.stopped == ()


def test_a_fusion_of_three_robots_runs_three_pipelines() -> None:
    plan = PLANNERS["cpsat"](nao(0, robots=5, fusion=3))
    assert plan.status is Status.OPTIMAL
    assert plan.change_set is not None
    assert len([u for u in plan.change_set.started if u.transformation.startswith("ball_localization")]) == 3


@pytest.mark.parametrize(
    ("kind", "size", "optimum_s"),
    [("dedicated", 5, 11), ("tower", 5, 12), ("blow-up", 4, 15), ("ring", 4, 10), ("fusion", 3, 7)],
)
def test_the_optimum_of_a_hand_made_case_is_what_its_sentence_says(kind: str, size: int, optimum_s: int) -> None:
    plan = PLANNERS["cpsat"](adversarial(0, kind=kind, size=size))
    assert plan.status is Status.OPTIMAL
    assert plan.cost_us == optimum_s * 1_000_000


def test_every_hand_made_case_can_be_solved() -> None:
    for kind in KINDS:
        assert PLANNERS["cpsat"](adversarial(0, kind=kind, size=4)).status is Status.OPTIMAL


def test_a_set_of_the_web_service_challenge_is_two_instances() -> None:
    folder = Path(__file__).parents[3] / "shared" / "data" / "wsc08"
    if not folder.exists():
        pytest.skip("the sets of the Web Service Challenge are not beside the checkout")
    first, shortest = (i for i in wsc_sets(folder) if i.parameters["set"] == "set01")
    assert PLANNERS["cpsat"](first.problem).cost_us == PLANNERS["cpsat"](shortest.problem).cost_us == 10_000_000
    assert first.digest != shortest.digest


def test_a_folder_without_sets_is_bad_input(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no set"):
        wsc_sets(tmp_path)
