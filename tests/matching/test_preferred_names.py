"""A short name that several ontologies have means that of the preferred one."""

from __future__ import annotations

from pathlib import Path

import pytest
from cfgplan_runtime.lifecycle.changes import Individual
from cfgplan_runtime.lifecycle.worlds import with_individuals
from hypothesis import given
from hypothesis import strategies as st

import cfgplan
from cfgplan.errors import InputError, TagError
from cfgplan.matching import Ontology, instances, match
from cfgplan.matching.answer import key_of
from cfgplan.matching.names import NameTable
from cfgplan.matching.syntax import parse_tag
from cfgplan.planning import Status

OWL = "@prefix owl: <http://www.w3.org/2002/07/owl#> . @prefix rdfs: <http://www.w3.org/2000/01/rdf-schema#> .\n"
BRICK = OWL + (
    "@prefix brick: <https://brick.example/Brick#> . <https://brick.example/Brick> a owl:Ontology .\n"
    "brick:Point a owl:Class . brick:Room a owl:Class . brick:isPointOf a owl:ObjectProperty .\n"
    "brick:hall a brick:Room . brick:onlyBrick a brick:Room .\n"
)
REC = OWL + (
    "@prefix rec: <https://rec.example/> . <https://rec.example/> a owl:Ontology .\n"
    "rec:Room a owl:Class . rec:Space a owl:Class . rec:isPointOf a owl:ObjectProperty .\n"
    "rec:hall a rec:Space . rec:attic a rec:Room . rec:Room rdfs:subClassOf rec:Space .\n"
)
ENVIRONMENT = """\
format: cfgplan/1
ontology: [brick.ttl, rec.ttl]
{prefer}
transformations:
  - {{label: "show ${{Room}}", outputs: {{o: "Point and isPointOf value ${{Room}}"}}}}
targets:
  - {{label: t, topic: /t, tag: "isPointOf some Room"}}
"""
XML = """\
<environment>
  <ontology>brick.ttl</ontology>
  <ontology>rec.ttl</ontology>
  {prefer}
  <target><label>t</label><topic>/t</topic><tag>isPointOf some Room</tag></target>
</environment>
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "brick.ttl").write_text(BRICK)
    (tmp_path / "rec.ttl").write_text(REC)
    return tmp_path


def written(folder: Path, prefer: str, name: str = "env.yaml", text: str = ENVIRONMENT) -> Path:
    path = folder / name
    path.write_text(text.format(prefer=prefer))
    return path


def error_of(path: Path) -> str:
    with pytest.raises(InputError) as caught:
        cfgplan.load(path)
    return str(caught.value)


def test_a_name_of_several_ontologies_is_ambiguous_and_the_mend_names_both_ways_out(folder: Path) -> None:
    error = error_of(written(folder, ""))
    assert "the property 'isPointOf' is ambiguous" in error
    assert "write brick:isPointOf or rec:isPointOf, or `prefer: brick` in the environment" in error


@pytest.mark.parametrize(
    ("prefer", "rooms"),
    [
        ("prefer: brick", {"hall", "onlyBrick"}),
        ("prefer: 'brick:'", {"hall", "onlyBrick"}),
        ("prefer: [brick, rec]", {"hall", "onlyBrick"}),
        ("prefer: https://brick.example/Brick#", {"hall", "onlyBrick"}),
        ("prefer: [<https://brick.example/Brick#>]", {"hall", "onlyBrick"}),
        ("prefer: rec", {"attic"}),
        ("prefer: [https://rec.example/, brick]", {"attic"}),
    ],
)
def test_the_first_preferred_ontology_says_what_tags_and_templates_mean(
    folder: Path, prefer: str, rooms: set[str]
) -> None:
    world = cfgplan.load(written(folder, prefer))
    assert {transformation.label for transformation in world.environment.library} == {f"show {room}" for room in rooms}
    brick = "brick" in prefer.partition(",")[0]
    whole = "https://brick.example/Brick#" if brick else "https://rec.example/"
    meant = parse_tag(f"<{whole}isPointOf> some <{whole}Room>", world.ontology)
    assert parse_tag("isPointOf some Room", world.ontology) == meant
    assert cfgplan.solve(world).plan.status is Status.OPTIMAL


@pytest.mark.parametrize("entry", ["<prefer>brick</prefer>", "<prefer>rec</prefer>\n  <prefer>brick</prefer>"])
def test_xml_says_it_in_elements(folder: Path, entry: str) -> None:
    world = cfgplan.load(written(folder, entry, "env.xml", XML))
    first = "rec" if "rec" in entry else "brick"
    assert parse_tag("Room", world.ontology) == parse_tag(f"{first}:Room", world.ontology)


@pytest.mark.parametrize(
    ("prefer", "place", "message"),
    [
        (
            "prefer: brik",
            "env.yaml:3:9",
            "the prefix 'brik:' is unknown (the ontology declares brick:, owl:, rdfs:, rec:)",
        ),
        ("prefer: [brick, rek]", "env.yaml:3:17", "the prefix 'rek:' is unknown"),
        ("prefer: https://brick.example/Brik#", "env.yaml:3:9", "did you mean `https://brick.example/Brick#`?"),
        ("prefer: urn:none#", "env.yaml:3:9", "names in <https://brick.example/Brick#>, <https://rec.example/>"),
        ("prefer: 3", "env.yaml:3:9", "prefer"),
    ],
)
def test_an_unknown_prefix_or_namespace_is_a_fault_with_its_place(
    folder: Path, prefer: str, place: str, message: str
) -> None:
    error = error_of(written(folder, prefer))
    assert place in error
    assert message in error


def test_without_an_ontology_nothing_can_be_preferred(folder: Path) -> None:
    text = ENVIRONMENT.replace("ontology: [brick.ttl, rec.ttl]\n", "")
    assert "without `ontology:` no name has a namespace: remove it" in error_of(written(folder, "prefer: a", text=text))


def test_a_name_that_no_preferred_ontology_has_stays_ambiguous(folder: Path) -> None:
    (folder / "third.ttl").write_text(OWL + "@prefix third: <urn:third#> . third:only a owl:Class .\n")
    text = ENVIRONMENT.replace("rec.ttl]", "rec.ttl, third.ttl]")
    error = error_of(written(folder, "prefer: third", text=text))
    assert "write brick:isPointOf or rec:isPointOf, or add brick to `prefer:` in the environment" in error


def test_what_is_preferred_is_a_part_of_an_ontologys_identity_and_of_kept_answers(folder: Path) -> None:
    brick, rec = (cfgplan.load(written(folder, f"prefer: {prefix}")).ontology for prefix in ("brick", "rec"))
    assert brick != rec
    assert key_of(brick, "auto", ["Room"], ["Space"]) != key_of(rec, "auto", ["Room"], ["Space"])
    assert match(["Room"], ["Space"], brick).similarity.offers["Space"] == frozenset()
    assert match(["Room"], ["Space"], rec).similarity.offers["Space"] == {"Room"}


def test_an_individual_that_comes_leaves_what_is_preferred(folder: Path) -> None:
    ontology = cfgplan.load(written(folder, "prefer: rec")).ontology
    changed = with_individuals(ontology, [Individual("cellar", ("Room",))], [])
    assert changed.preferred == ontology.preferred
    assert instances(changed, "Room") == ("attic", "cellar")


SPACES = ("a#", "b#", "c/")
NAMES = ("x", "y", "z")


@given(
    st.sets(st.tuples(st.sampled_from(SPACES), st.sampled_from(NAMES)), min_size=1),
    st.lists(st.sampled_from(SPACES), unique=True),
    st.sets(st.sampled_from(SPACES)),
)
def test_every_name_is_found_as_it_is_written(
    names: set[tuple[str, str]], preferred: list[str], declared: set[str]
) -> None:
    prefixes = {space[0]: space for space in declared}
    table = NameTable("class", (space + name for space, name in names), prefixes, preferred)
    for space, name in names:
        assert table.find(table.written(space + name)) == space + name
    for name in {name for _, name in names}:
        having = {space for space, each in names if each == name}
        first = next((space for space in preferred if space in having), None)
        if len(having) == 1 or first is not None:
            assert table.find(name) == (first or min(having)) + name
        else:
            with pytest.raises(cfgplan.matching.UnknownNameError, match="ambiguous"):
                table.find(name)


def test_an_ambiguous_name_without_prefixes_is_to_be_written_in_full() -> None:
    ontology = Ontology(["Declaration(Class(<a#X>))", "Declaration(Class(<b#X>))"])
    with pytest.raises(TagError, match=r"ambiguous \(write <a#X> or <b#X>\)"):
        parse_tag("X", ontology)
