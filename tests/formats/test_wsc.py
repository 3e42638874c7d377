"""Web Service Challenge sets: read, solved and replayed by an executor that knows no cfgplan."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from xml.etree import ElementTree

import pytest

from cfgplan import api
from cfgplan.domain import InputPort, OutputPort, Similarity
from cfgplan.errors import InputError
from cfgplan.formats.environment_file import EnvironmentFile
from cfgplan.formats.wsc import WscObjective, read_wsc, shortest_length, wsc_texts
from cfgplan.formats.wsc_files import read_test_set
from cfgplan.planners import PLANNERS
from cfgplan.planning import Problem, Status

SETS = Path(__file__).parents[3] / "shared" / "data" / "wsc08"
TAXONOMY = """\
<taxonomy><concept name="thing">
  <concept name="place"><instance name="p1"/><concept name="city"><instance name="c1"/><instance name="c2"/></concept>
  </concept>
  <concept name="price"><instance name="e1"/></concept><instance name="t1"/>
</concept></taxonomy>
"""
SERVICES = """\
<services>
  <service name="locate"><inputs><instance name="t1"/></inputs><outputs><instance name="c1"/></outputs></service>
  <service name="name"><inputs><instance name="p1"/></inputs><outputs><instance name="c2"/></outputs></service>
  <service name="ask"><inputs><instance name="p1"/><instance name="p1"/></inputs>
    <outputs><instance name="e1"/><instance name="p1"/></outputs></service>
</services>
"""
PROBLEM = """\
<problemStructure><task><provided><instance name="t1"/></provided><wanted><instance name="e1"/></wanted></task>
<solutions><solution><instance name="not in the taxonomy"/></solution></solutions></problemStructure>
"""


def small_set(folder: Path, *, taxonomy: str = TAXONOMY, services: str = SERVICES, problem: str = PROBLEM) -> Path:
    for name, text in (("taxonomy", taxonomy), ("services", services), ("problem", problem)):
        (folder / f"{name}.xml").write_text(text)
    return folder


def test_a_service_is_a_transformation_tagged_by_the_concepts_of_its_instances(tmp_path: Path) -> None:
    world, similarity = read_wsc(small_set(tmp_path))
    ask = world.environment.transformation["ask"]
    assert ask.inputs == (InputPort("in_p1", "place"),)
    assert ask.outputs == (OutputPort("out_e1", "price"), OutputPort("out_p1", "place"))
    assert (ask.labor_us, ask.upkeep_us, world.horizon_s) == (1_000_000, 0, 0)
    assert world.environment.transformation["provided"].labor_us == 0
    assert [(target.tag, target.topic) for target in world.environment.targets] == [("price", "/wanted/e1")]
    assert similarity.offers == {
        "thing": frozenset({"thing", "place", "city", "price"}),
        "place": frozenset({"place", "city"}),
        "price": frozenset({"price"}),
    }


def test_what_is_provided_keeps_off_the_name_of_a_service(tmp_path: Path) -> None:
    world, _ = read_wsc(small_set(tmp_path, services=SERVICES.replace('"name"', '"provided"', 1)))
    assert {"provided", "provided_"} <= set(world.environment.transformation)


def test_layers_hold_only_what_can_be_had_and_is_of_use_in_time(tmp_path: Path) -> None:
    world, similarity = read_wsc(small_set(tmp_path), "length")
    assert set(world.environment.transformation) == {"provided", "locate@1", "ask@2"}
    ask = world.environment.transformation["ask@2"]
    assert ask.inputs[0].tag == "place and by1"
    assert similarity.holds("city and by1", "place and by1")
    assert not similarity.holds("price and by2", "place and by1")


def test_the_files_that_are_written_say_the_same_as_the_direct_way(tmp_path: Path) -> None:
    source = tmp_path / "set"
    source.mkdir()
    small_set(source)
    objectives: tuple[WscObjective, ...] = ("services", "length")
    for objective in objectives:
        text, ontology = wsc_texts(source, objective, ontology="taxonomy.ofn")
        (tmp_path / "env.yaml").write_text(text)
        (tmp_path / "taxonomy.ofn").write_text(ontology)
        loaded = api.load(tmp_path / "env.yaml")
        world, similarity = read_wsc(source, objective)
        assert loaded.environment == world.environment
        assert loaded.horizon_s == world.horizon_s
        assert api.match_ports(loaded, use_cache=False).similarity.offers == similarity.offers


@pytest.mark.parametrize(
    ("file", "old", "new", "message"),
    [
        ("services", 'name="c1"', 'name="c9"', "services.xml:2:73: the instance c9 is not in the taxonomy"),
        ("problem", 'name="t1"', 'name="t9"', "problem.xml:1:35: the instance t9 is not in the taxonomy"),
        ("problem", "wanted>", "desired>", "problem.xml: <wanted> is missing"),
        ("services", 'name="name"', 'name="ask"', "services.xml:4:3: the service ask occurs twice"),
        ("services", '<service name="name">', "<service>", "services.xml:3:3: <service> has no name"),
        ("services", "inputs>", "input>", "services.xml:2:26: unknown element <input> here"),
        ("taxonomy", 'name="c2"', 'name="c1"', "taxonomy.xml:2:88: the instance c1 is in two concepts"),
        ("taxonomy", '"city"', '"place"', "taxonomy.xml:2:46: the concept place stands at two places"),
        ("taxonomy", "</taxonomy>", "", "taxonomy.xml:6:1: this is not XML"),
        ("taxonomy", "<taxonomy>", "<!DOCTYPE a><taxonomy>", "a document type is declared"),
    ],
)
def test_a_broken_set_has_its_fault(tmp_path: Path, file: str, old: str, new: str, message: str) -> None:
    texts = {"taxonomy": TAXONOMY, "services": SERVICES, "problem": PROBLEM}
    assert old in texts[file]
    texts[file] = texts[file].replace(old, new, 2 if old in ("wanted>", "inputs>") else 1)
    with pytest.raises(InputError) as caught:
        read_wsc(small_set(tmp_path, **texts))
    assert message in str(caught.value)


def test_a_folder_that_is_no_set_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"taxonomy\.xml: there is no such file"):
        read_wsc(tmp_path)


# --- the challenge's own sets: name, fewest services, shortest length, fewest services at that length ---

PROVEN = [("set01", 10, 3, 10), ("set02", 5, 3, 5), ("set03", 40, 23, 40), ("set04", 10, 5, 10)]
with_sets = pytest.mark.skipif(not SETS.is_dir(), reason="the sets are not beside the checkout (../shared/data/wsc08)")


@with_sets
@pytest.mark.parametrize(("name", "fewest", "length", "fewest_at_length"), PROVEN)
def test_the_proven_optima_are_found_and_the_plans_run(
    name: str, fewest: int, length: int, fewest_at_length: int
) -> None:
    assert shortest_length(read_test_set(SETS / name)) == length
    services = planned_services(*read_wsc(SETS / name))
    assert len(services) == fewest
    assert layers_until_done(SETS / name, services) is not None
    services = planned_services(*read_wsc(SETS / name, "length"))
    assert len(services) == fewest_at_length
    assert layers_until_done(SETS / name, services) == length


@with_sets
def test_a_set_that_nothing_solves_is_proven_infeasible() -> None:
    for world, similarity in (read_wsc(SETS / "set09"), read_wsc(SETS / "set09", "length")):
        plan = PLANNERS["cpsat"](Problem(world.environment, similarity, world.horizon_s))
        assert plan.status is Status.INFEASIBLE


def planned_services(world: EnvironmentFile, similarity: Similarity) -> set[str]:
    """The services that the optimal plan starts, without their layers."""
    plan = PLANNERS["cpsat"](Problem(world.environment, similarity, world.horizon_s))
    assert plan.status is Status.OPTIMAL
    assert plan.change_set is not None
    labels = [unit.transformation for unit in plan.change_set.started]
    return {label.partition("@")[0] for label in labels} - {"provided"}


def layers_until_done(folder: Path, services: Collection[str]) -> int | None:
    """Run services in layers on what a set provides; how many it takes to have all that is wanted."""
    line: dict[str, tuple[str, ...]] = {}

    def climb(element: ElementTree.Element, above: tuple[str, ...]) -> None:
        for child in element:
            if child.tag == "concept":
                climb(child, (*above, child.attrib["name"]))
            else:
                line[child.attrib["name"]] = above

    def instances(element: ElementTree.Element, path: str) -> list[str]:
        return [found.attrib["name"] for found in element.iterfind(f"{path}/instance")]

    climb(ElementTree.parse(folder / "taxonomy.xml").getroot(), ())
    problem = ElementTree.parse(folder / "problem.xml").getroot()
    described = ElementTree.parse(folder / "services.xml").getroot()
    waiting = [service for service in described if service.attrib["name"] in services]
    there = {concept for instance in instances(problem, "task/provided") for concept in line[instance]}
    for layer in range(len(waiting) + 1):
        if all(line[instance][-1] in there for instance in instances(problem, "task/wanted")):
            return layer
        ready = [s for s in waiting if all(line[instance][-1] in there for instance in instances(s, "inputs"))]
        there |= {concept for s in ready for instance in instances(s, "outputs") for concept in line[instance]}
        waiting = [s for s in waiting if s not in ready]
    return None
