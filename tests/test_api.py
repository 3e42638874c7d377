"""What `import cfgplan` hands out."""

from __future__ import annotations

import copy
import json
import os
import pickle
from pathlib import Path

import pytest

import cfgplan
from cfgplan.api import plan_text, write_file
from cfgplan.errors import InputError, InvalidValueError

NAO = Path(__file__).parent.parent / "models" / "nao"


def test_every_name_that_the_package_promises_is_there() -> None:
    for name in cfgplan.__all__:
        assert getattr(cfgplan, name).__module__.startswith("cfgplan."), name


def test_an_owlready2_ontology_gives_tags_their_meaning() -> None:
    import owlready2

    ontology = owlready2.World().get_ontology("http://example.org/animals.owl")
    with ontology:
        animal = owlready2.types.new_class("Animal", (owlready2.Thing,))
        owlready2.types.new_class("Cat", (animal,))
    library = (cfgplan.Transformation("camera", outputs=(cfgplan.OutputPort("o", "Cat"),), labor_us=5),)
    targets = (cfgplan.Target("t", "Animal", "/t"),)
    world = cfgplan.world(cfgplan.Environment(library=library, targets=targets), horizon_s=1, ontology=ontology)
    plan = cfgplan.plan(cfgplan.match(world))
    assert plan.cost_us == 5


def test_a_code_built_world_refuses_a_tag_that_does_not_parse() -> None:
    library = (cfgplan.Transformation("camera", outputs=(cfgplan.OutputPort("o", "Cat and"),)),)
    world = cfgplan.world(cfgplan.Environment(library=library), horizon_s=1)
    with pytest.raises(cfgplan.InputError, match="Cat and"):
        cfgplan.match(world)


@pytest.mark.parametrize(
    ("text", "column", "key"), [("ontology: w.ttl", 11, "ontology"), ("ontology: [a.ttl, w.ttl]", 19, "ontology[1]")]
)
def test_an_ontology_that_is_missing_or_empty_is_named_where_the_environment_names_it(
    tmp_path: Path, text: str, column: int, key: str
) -> None:
    (tmp_path / "a.ttl").write_text("@prefix : <http://a/#> .\n:A a <http://www.w3.org/2002/07/owl#Class> .\n")
    path, ontology = tmp_path / "env.yaml", tmp_path / "w.ttl"
    path.write_text(f"format: cfgplan/1\n{text}\nlabel: x\n")
    for told in ("the ontology file does not exist", "the ontology file is empty"):
        with pytest.raises(InputError) as caught:
            cfgplan.load(path)
        unknown, fault = caught.value.faults
        assert unknown.key == "label"
        assert (fault.file, fault.line, fault.column, fault.key) == (str(path), 2, column, key)
        assert fault.message == f"w.ttl: {told}"
        assert fault.mend
        ontology.write_text("")
    ontology.write_text("nonsense")
    with pytest.raises(InputError) as caught:
        cfgplan.load(path)
    assert caught.value.faults[1].file == str(ontology)


def test_an_answer_that_the_judge_does_not_accept_never_reaches_the_user() -> None:
    def liar(problem: cfgplan.Problem, **_: object) -> cfgplan.Plan:
        return cfgplan.Plan("liar", cfgplan.Status.OPTIMAL, problem.environment.change_to([]), 0, 0)

    problem = cfgplan.match(cfgplan.load(NAO / "2-segmenter-lost.yaml"))
    with pytest.raises(cfgplan.UntruthfulPlanError, match="no stream is published on /result"):
        cfgplan.plan(problem, planner=liar)


def test_a_device_or_a_link_is_written_through_and_never_replaced(tmp_path: Path) -> None:
    """`--out /dev/null` as root once made a plain file of the device."""
    pipe, link, file = tmp_path / "pipe", tmp_path / "link", tmp_path / "file"
    os.mkfifo(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    cfgplan.api.write_file(pipe, b"through")
    assert os.read(reader, 100) == b"through"
    os.close(reader)
    assert pipe.is_fifo()
    link.symlink_to(file)
    cfgplan.api.write_file(link, b"content")
    assert link.is_symlink()
    assert file.read_bytes() == b"content"


def test_a_file_that_can_not_be_written_leaves_nothing_behind(tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    for path in (tmp_path / "folder", tmp_path / "nowhere" / "file", Path("/")):
        with pytest.raises(InputError, match="can't be written"):
            cfgplan.api.write_file(path, b"content")
    assert [path.name for path in tmp_path.iterdir()] == ["folder"]


@pytest.fixture(scope="module")
def lost() -> tuple[cfgplan.World, cfgplan.Problem, cfgplan.Plan]:
    world = cfgplan.load(NAO / "2-segmenter-lost.yaml")
    problem = cfgplan.match(world)
    return world, problem, cfgplan.plan(problem)


def test_problems_and_plans_go_to_other_processes_and_are_copied(lost: tuple[object, object, object]) -> None:
    for value in lost[1:]:
        assert pickle.loads(pickle.dumps(value)) == value
        assert copy.deepcopy(value) == value


def test_what_is_not_there_is_bad_input_that_names_the_nearest(
    lost: tuple[cfgplan.World, cfgplan.Problem, cfgplan.Plan],
) -> None:
    world, problem, plan = lost
    with pytest.raises(InputError, match="did you mean `cpsat`"):
        cfgplan.plan(problem, planner="cp-sat")
    with pytest.raises(InputError, match=r"did you mean `segmenter\(piff\)\.1`"):
        cfgplan.why(problem, plan, "unit", "segmenter(piff)")
    with pytest.raises(InputError, match="no output `bottom_cam`"):
        cfgplan.why(problem, plan, "stream", "bottom_cam")
    with pytest.raises(InvalidValueError, match="kind must be 'unit' or 'transformation' or 'stream', but is 'topic'"):
        cfgplan.why(problem, plan, "topic", "/ball")  # type: ignore[arg-type]
    with pytest.raises(InputError, match="no transformation `segmenter`"):
        cfgplan.sensitivity(problem, upkeep_of="segmenter")
    with pytest.raises(InputError, match="no target `nothing`"):
        cfgplan.front(problem, "nothing", "error")
    with pytest.raises(InvalidValueError, match="count must be a whole number of 1 or more, but is -1"):
        cfgplan.alternatives(problem, -1)
    with pytest.raises(InvalidValueError, match=r"without must be a list, .* but is 'segmenter\(piff\)'"):
        cfgplan.what_if(world, without="segmenter(piff)")
    with pytest.raises(InputError, match="why_not"):
        cfgplan.why(problem, cfgplan.Plan("none", cfgplan.Status.INFEASIBLE), "transformation", "segmenter(piff)")


def test_a_file_that_is_written_anew_keeps_its_permissions(tmp_path: Path) -> None:
    path = tmp_path / "plan.json"
    path.touch(mode=0o600)
    write_file(path, b"{}")
    assert (path.read_bytes(), path.stat().st_mode & 0o777) == (b"{}", 0o600)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everything")
def test_a_file_that_may_not_be_written_is_not_replaced(tmp_path: Path) -> None:
    path = tmp_path / "plan.json"
    path.touch(mode=0o444)
    with pytest.raises(InputError, match="Permission denied"):
        write_file(path, b"{}")
    assert path.read_bytes() == b""


TAMPERED = {
    "cost": lambda plan: plan | {"cost_us": plan["cost_us"] - 1, "bound_us": plan["bound_us"] - 1},
    "wiring": lambda plan: plan | {"change_set": plan["change_set"] | {"started": []}},
    "bound": lambda plan: plan | {"bound_us": plan["bound_us"] + 1},
    "status": lambda plan: plan | {"status": "feasible"},
    "refusal": lambda plan: plan | {"status": "infeasible", "change_set": None},
    "environment": lambda plan: plan | {"environment": "0"},
}


@pytest.mark.parametrize("part", TAMPERED)
def test_a_plan_that_was_changed_is_not_carried_out(part: str, tmp_path: Path) -> None:
    world = cfgplan.load(NAO / "2-segmenter-lost.yaml")
    problem = cfgplan.match(world)
    plan = cfgplan.plan(problem)
    text = plan_text(world, problem, plan)
    path = tmp_path / "plan.json"
    path.write_text(text)
    assert cfgplan.load_plan(world, problem, path).change_set == plan.change_set
    path.write_text(json.dumps(TAMPERED[part](json.loads(text))))
    with pytest.raises(InputError, match=r"plan\.json.*(contradicts itself|is stale)"):
        cfgplan.load_plan(world, problem, path)
