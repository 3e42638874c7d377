"""The paper's XML: read, checked, and converted to YAML and back with nothing lost."""

from __future__ import annotations

import tempfile
from pathlib import Path
from unicodedata import normalize

import pytest
from environments import environments
from hypothesis import given, settings
from hypothesis import strategies as st
from loading import SmallVocabulary, faults_of, load, load_text, only_fault, place_of

from cfgplan.domain import Environment, InputPort, OutputPort, Target, Transformation
from cfgplan.errors import InputError, InvalidValueError
from cfgplan.formats.assembly import build
from cfgplan.formats.document import read_document
from cfgplan.formats.dump import as_xml, as_yaml, dump_yaml, plain_environment
from cfgplan.formats.xml_dump import dump_xml

LISTING_1 = """\
<transformation type="nodelet">
  <label>undistort(cam1)</label>
  <source>package/Undistort</source>
  <params>
    <param name="configPath" type="string">
      /path/to/configuration/cam1/
    </param>
  </params>
  <ports>
    <port type="out">undist</port>
    <port type="in">rawCamera</port>
  </ports>
  <tags>
    <tag port="undist">Undistorted(cam1)</tag>
    <tag port="rawCamera">RawRGB(cam1)</tag>
  </tags>
</transformation>
"""
LISTING_2 = """\
<target>
  <label>undistortSub</label>
  <topic>/result</topic>
  <tag>Undistorted(cam1)</tag>
</target>
"""
UNDISTORT = Transformation(
    "undistort(cam1)",
    (InputPort("rawCamera", "RawRGB(cam1)"),),
    (OutputPort("undist", "Undistorted(cam1)"),),
    labor_us=1_000_000,
    source="package/Undistort",
    kind="nodelet",
    params={"configPath": "/path/to/configuration/cam1/"},
)
TARGET = Target("undistortSub", "Undistorted(cam1)", "/result")
WHOLE = """\
<?xml version="1.0" encoding="UTF-8"?>
<environment format="cfgplan/1" horizon="60" max_cost="20.5">
  <ontology>nao.ttl</ontology>
  <defaults labor="0.5"/>
  <transformation type="nodelet" labor="0.3" upkeep="0.000001" host="piff" pinned="true" required="true">
    <label>fuse(${NAO})</label>
    <params>
      <param name="none" type="null"/>
      <param name="count" type="int">3</param>
      <param name="gain" type="double">2</param>
      <param name="flag" type="bool">true</param>
      <param name="list" type="json">[1, {"a": 0.5}]</param>
      <param name="text" xml:space="preserve"> 3 </param>
    </params>
    <ports>
      <port type="in" distinct="sources">left</port>
      <port type="in" distinct="sources" feedback="true">right</port>
      <port type="out">out</port>
    </ports>
    <tags>
      <tag port="left">Position</tag>
      <tag port="right">Position</tag>
      <tag port="out">A &amp; B</tag>
    </tags>
  </transformation>
  <unit id="fuse.1" transformation="fuse(piff)">
    <input port="left"/>
    <input port="right" stream="fuse.1/out"/>
    <topic port="out">/result</topic>
  </unit>
  <target priority="2" silent="5s"><label>t</label><topic>/result</topic><tag>A</tag></target>
</environment>
"""


def test_listings_1_and_2_of_the_paper_load_by_themselves(tmp_path: Path) -> None:
    assert load_text(tmp_path, LISTING_1, "one.xml").environment.library == (UNDISTORT,)
    assert load_text(tmp_path, LISTING_2, "two.xml").environment.targets == (TARGET,)


def test_several_specifications_stand_in_a_root_element(tmp_path: Path) -> None:
    world = load_text(tmp_path, f"<specifications>{LISTING_1}{LISTING_2}</specifications>", "both.xml")
    assert world.environment == Environment(library=(UNDISTORT,), targets=(TARGET,))


def test_a_folder_of_specifications_loads(tmp_path: Path) -> None:
    (tmp_path / "a.xml").write_text(LISTING_1)
    (tmp_path / "b.xml").write_text(LISTING_2)
    assert load(tmp_path).environment == Environment(library=(UNDISTORT,), targets=(TARGET,))
    (tmp_path / "c.xml").write_text("<target/>")
    with pytest.raises(InputError, match=r"c\.xml:1:1: targets\[0\]: the key `label` is missing"):
        load(tmp_path)


def test_specifications_are_included_from_yaml(tmp_path: Path) -> None:
    (tmp_path / "specs").mkdir()
    (tmp_path / "specs" / "a.xml").write_text(LISTING_1)
    (tmp_path / "b.xml").write_text(LISTING_2)
    world = load_text(tmp_path, "format: cfgplan/1\nhorizon: 5\ninclude: [specs, b.xml]\n")
    assert world.environment == Environment(library=(UNDISTORT,), targets=(TARGET,))
    assert world.place(transformation="undistort(cam1)", port="undist") == (str(tmp_path / "specs" / "a.xml"), 14, 24)


def test_what_the_papers_xml_lacks_is_said_by_attributes_and_elements(tmp_path: Path) -> None:
    world = load_text(tmp_path, WHOLE, "env.xml")
    assert (world.horizon_s, world.max_cost_us) == (60, 20_500_000)
    assert world.ontology_paths == (tmp_path / "nao.ttl",)
    piff = world.environment.transformation["fuse(piff)"]
    assert (piff.labor_us, piff.upkeep_us, piff.host, piff.pinned, piff.required) == (300_000, 1, "piff", True, True)
    assert piff.params == {"none": None, "count": 3, "gain": 2.0, "flag": True, "list": [1, {"a": 0.5}], "text": " 3 "}
    assert isinstance(piff.params["gain"], float)
    assert piff.inputs == (InputPort("left", "Position", "sources"), InputPort("right", "Position", "sources", True))
    assert piff.outputs == (OutputPort("out", "A & B"),)
    (unit,) = world.environment.units
    assert (unit.feeds["right"][0].unit, [p.topic for p in unit.publications]) == ("fuse.1", ["/result"])
    assert world.environment.targets[0].priority == 2
    assert world.environment.targets[0].silent_us == 5_000_000


def test_other_encodings_are_read_as_they_declare_themselves(tmp_path: Path) -> None:
    text = LISTING_2.replace("/result", "/café")
    for encoding in ("iso-8859-1", "utf-16"):
        path = tmp_path / "env.xml"
        path.write_bytes(f'<?xml version="1.0" encoding="{encoding}"?>\n{text}'.encode(encoding))
        assert load(path).environment.targets[0].topic == "/café"


@pytest.mark.parametrize(
    ("old", "new", "place", "message", "mend"),
    [
        ("<label>fuse", "<lable>x</lable><label>fuse", (6, 5), "unknown element <lable>", "did you mean `label`?"),
        ('upkeep="0', 'upkep="0', (5, 3), "the unknown attribute `upkep`", "did you mean `upkeep`?"),
        (
            'upkeep="0.000001"',
            'upkeep="dear"',
            (5, 3),
            "a number of CPU seconds, but is the text 'dear'",
            "such as 0.3",
        ),
        ('upkeep="0.000001"', 'upkeep="-1"', (5, 3), "-1 is negative", "0 or more"),
        ('pinned="true"', 'pinned="yes"', (5, 3), "true or false, but is the text 'yes'", "write true or false"),
        ('<tag port="left">Position</tag>', "", (16, 7), "the port `left` has no tag", 'add <tag port="left">'),
        ('<tag port="left">', '<tag port="lft">', (21, 7), "the tag is for the port `lft`", "did you mean `left`?"),
        ('<tag port="left">', "<tag>", (21, 7), "<tag> has no attribute `port`", 'add port="..."'),
        ('<tag port="left">', '<tag port="right">', (22, 7), "the port `right` has two tags", "join them"),
        ('<port type="out">', "<port>", (18, 7), "the port `out` has no direction", 'type="in"'),
        ('<port type="out">', '<port type="out" feedback="true">', (18, 7), "an output has no `feedback`", None),
        (">right</port>", ">left</port>", (17, 7), "the port `left` occurs twice", None),
        ('name="gain"', 'name="count"', (10, 7), "the param `count` occurs twice", None),
        ('type="int">3', 'type="int">3.5', (9, 7), "'3.5' is not of type int", None),
        ('type="int">3', 'type="integr">3', (9, 7), "unknown param type `integr`", None),
        ('type="double">2', 'type="double">inf', (10, 7), "'inf' is not of type double", None),
        ('type="bool">true', 'type="bool">1', (11, 7), "'1' is not of type bool", None),
        ('"a": 0.5', "a: 0.5", (12, 7), "this is not JSON", None),
        ("Position</tag>", "A and Bad</tag>", (21, 30), "unknown name Bad", "did you mean `Bed`?"),
        ("A &amp; B", "A &amp; Bad", (23, 23), "unknown name Bad", None),
        ("<ports>", "<ports>stray", (15, 5), "there is stray text in <ports>", "remove it"),
        ("<label>fuse", "<label>a</label><label>fuse", (6, 21), "<label> occurs twice", None),
        ('format="cfgplan/1"', 'format="cfgplan/2"', (2, 1), "`format` is 'cfgplan/2'", "cfgplan/1"),
        ('horizon="60"', 'horizon="long"', (2, 1), "a whole number", "such as 600"),
        ('transformation="fuse(piff)"', 'transformation="fuse(pif)"', (26, 3), "no transformation `fuse(pif)`", None),
        ('stream="fuse.1/out"', 'stream="fuse.1/ou"', (28, 5), "has no output `ou`", "did you mean `out`?"),
        ('<topic port="out">/result', '<topic port="out">/res', (29, 23), "no target names the topic `/res`", None),
        ("<topic>/result</topic>", "", (31, 3), "the key `topic` is missing", None),
        ("</params>", "</parms>", (14, 7), "this is not XML: mismatched tag", "in the order"),
        ("A &amp; B", "A & B", (23, 26), "this is not XML: not well-formed", None),
        ("A &amp; B", "&nothing;", (23, 23), "this is not XML: undefined entity", "&amp; for &"),
        ("</environment>", "</environment><target/>", (32, 15), "this is not XML: junk after", "<environment>"),
        (' encoding="UTF-8"?>', ' encoding="klingon"?>', (None, None), "unknown encoding", "UTF-8"),
    ],
)
def test_a_fault_in_xml_has_its_place_and_its_mend(
    tmp_path: Path, old: str, new: str, place: tuple[int | None, int | None], message: str, mend: str | None
) -> None:
    assert old in WHOLE
    faults = faults_of(tmp_path, WHOLE.replace(old, new, 1), "env.xml")
    fault = next(fault for fault in faults if message in fault.message)
    assert place_of(fault) == place
    assert mend is None or (fault.mend is not None and mend in fault.mend)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "the file is empty"),
        ("<environment/>", "<environment> has no specification in it"),
        ("<target>" * 100, "elements are nested more than 64 deep"),
        ("<target>" * 100_000, "elements are nested more than 64 deep"),
        ("not xml", "this is not XML"),
    ],
)
def test_what_is_no_specification_has_one_fault(tmp_path: Path, text: str, message: str) -> None:
    assert message in only_fault(tmp_path, text, "env.xml").message


@pytest.mark.parametrize(
    "declaration",
    [
        '<!DOCTYPE t [<!ENTITY a "ha"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;&a;&a;">]>',
        '<!DOCTYPE t [<!ENTITY a SYSTEM "file:///etc/passwd">]>',
        '<!DOCTYPE t SYSTEM "http://127.0.0.1/t.dtd">',
    ],
)
def test_document_types_and_with_them_entity_bombs_are_refused(tmp_path: Path, declaration: str) -> None:
    fault = only_fault(tmp_path, f"{declaration}\n{LISTING_2}", "env.xml")
    assert (fault.message, fault.line) == ("a document type is declared", 1)


def test_columns_count_characters_not_bytes(tmp_path: Path) -> None:
    text = LISTING_2.replace("<tag>Undistorted(cam1)", "<tag>⊓⊓é Bad")
    assert place_of(only_fault(tmp_path, text, "env.xml")) == (4, 12)


def test_xml_becomes_yaml_and_xml_again_with_templates_as_they_were(tmp_path: Path) -> None:
    (tmp_path / "env.xml").write_text(WHOLE)
    as_written = as_yaml(read_document(tmp_path / "env.xml"))
    assert "label: fuse(${NAO})" in as_written
    assert "labor: 0.3\n" in as_written
    (tmp_path / "env.yaml").write_text(as_written)
    again = as_xml(read_document(tmp_path / "env.yaml"))
    assert as_yaml(read_document(write(tmp_path / "again.xml", again))) == as_written
    worlds = [load(tmp_path / name) for name in ("env.xml", "env.yaml", "again.xml")]
    assert worlds[0].environment == worlds[1].environment == worlds[2].environment
    assert worlds[0].digest == worlds[1].digest == worlds[2].digest


def test_converting_writes_what_is_included_into_the_one_file(tmp_path: Path) -> None:
    (tmp_path / "a.xml").write_text(LISTING_1)
    (tmp_path / "env.yaml").write_text("format: cfgplan/1\nhorizon: 5\ninclude: [a.xml]\n")
    text = as_yaml(read_document(tmp_path / "env.yaml"))
    assert "include" not in text
    assert load_text(tmp_path, text, "whole.yaml").environment.library == (UNDISTORT,)


def test_a_document_with_faults_is_not_converted(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="unknown key `upkep`"):
        as_xml(read_document(write(tmp_path / "env.yaml", "format: cfgplan/1\nupkep: 1\n")))


def test_a_name_that_xml_cannot_say_is_refused() -> None:
    environment = Environment(targets=(Target("t", "A\x01", "/t"),))
    with pytest.raises(InvalidValueError, match="control character"):
        dump_xml(plain_environment(environment, horizon_s=1))


@given(environments(), st.integers(0, 10**9), st.none() | st.integers(0, 2**53 - 1))
@settings(max_examples=150, deadline=None)
def test_what_is_written_as_xml_loads_back(environment: Environment, horizon_s: int, max_cost_us: int | None) -> None:
    plain = plain_environment(environment, horizon_s=horizon_s, max_cost_us=max_cost_us, ontology=["o n.ttl"])
    with tempfile.TemporaryDirectory() as folder:
        document = read_document(write(Path(folder) / "env.xml", dump_xml(plain)))
        world = build(document, SmallVocabulary())
        assert world.environment == environment
        assert (world.horizon_s, world.max_cost_us) == (horizon_s, max_cost_us)
        as_before = dump_yaml(plain)
        assert load_text(Path(folder), as_yaml(document)).digest == load_text(Path(folder), as_before).digest


def write(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


def test_a_port_and_its_tag_meet_however_their_accents_are_encoded(tmp_path: Path) -> None:
    text = LISTING_1.replace("undist<", "größe<").replace('"undist"', normalize("NFD", '"größe"'))
    (found,) = load_text(tmp_path, text, "a.xml").environment.library
    assert [port.name for port in (*found.inputs, *found.outputs)] == ["rawCamera", "größe"]
