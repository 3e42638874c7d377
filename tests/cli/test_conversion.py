"""`cfgplan import` and `cfgplan export`: the paper's XML, test sets and the schema."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from command import MODELS, Run

import cfgplan

WSC = Path(__file__).parents[3] / "shared" / "data" / "wsc08"
LISTINGS = """<specifications>
  <transformation type="nodelet">
    <label>undistort(cam1)</label>
    <source>package/Undistort</source>
    <params><param name="configPath" type="string">/path/to/configuration/cam1/</param></params>
    <ports><port type="out">undist</port><port type="in">rawCamera</port></ports>
    <tags><tag port="undist">Undistorted(cam1)</tag><tag port="rawCamera">RawRGB(cam1)</tag></tags>
  </transformation>
  <target><label>undistortSub</label><topic>/result</topic><tag>Undistorted(cam1)</tag></target>
</specifications>
"""


def test_the_papers_listings_become_an_environment_and_come_back(run: Run, tmp_path: Path) -> None:
    xml, env, back = tmp_path / "listings.xml", tmp_path / "env.yaml", tmp_path / "back.xml"
    xml.write_text(LISTINGS)
    assert run("import", "xml", xml, "--out", env).code == 0
    assert run("export", "xml", env, "--out", back).code == 0
    environment = cfgplan.load(env).environment
    assert environment.transformation["undistort(cam1)"].params == {"configPath": "/path/to/configuration/cam1/"}
    assert environment == cfgplan.load(xml).environment == cfgplan.load(back).environment


def test_templates_survive_the_way_through_xml(run: Run, tmp_path: Path) -> None:
    env = MODELS / "nao" / "3-puff-registered.yaml"
    for name in ("nao.ttl", "piff.ttl", "puff.ttl"):
        (tmp_path / name).write_bytes((MODELS / "nao" / name).read_bytes())
    assert run("export", "xml", env, "--out", tmp_path / "nao.xml").code == 0
    assert "${NAO}" in (tmp_path / "nao.xml").read_text()
    assert cfgplan.load(tmp_path / "nao.xml").environment == cfgplan.load(env).environment


def test_the_schema_describes_the_environment_file(run: Run) -> None:
    schema = json.loads(run("export", "schema").out)
    assert "json-schema.org" in schema["$schema"]
    assert "transformations" in schema["properties"]


@pytest.mark.skipif(not WSC.is_dir(), reason="the WSC 2008 sets are not beside this checkout")
def test_a_test_set_is_imported_and_solved_through_its_ontology(run: Run, tmp_path: Path) -> None:
    out = tmp_path / "set01.yaml"
    assert run("import", "wsc", WSC / "set01", "--out", out).code == 0
    document = run("solve", out, "--json").document
    assert document["status"] == "optimal"
    assert document["cost_us"] == 10_000_000


def test_a_test_set_needs_a_name_for_its_two_files(run: Run, tmp_path: Path) -> None:
    result = run("import", "wsc", tmp_path)
    assert result.code == 30
    assert "--out" in result.err


def test_a_graph_of_ros_nodes_needs_a_name_for_its_two_files(run: Run) -> None:
    result = run("import", "ros1", "live")
    assert result.code == 30
    assert "name the environment file with --out" in result.err


def test_what_is_no_graph_of_ros_nodes_is_refused(run: Run, tmp_path: Path) -> None:
    result = run("import", "ros1", tmp_path / "nowhere.bag", "--out", tmp_path / "env.yaml")
    assert result.code == 30
    assert "there is no such file" in result.err


def test_one_xml_specification_is_converted_at_a_time(run: Run, tmp_path: Path) -> None:
    result = run("import", "xml", tmp_path / "a.xml", tmp_path / "b.xml")
    assert result.code == 30
    assert "`import xml` takes one path" in result.err


def test_what_a_test_set_says_and_nobody_reads_is_told(run: Run, tmp_path: Path) -> None:
    taxonomy = '<taxonomy><concept name="thing"><instance name="a"/><instance name="b"/></concept></taxonomy>'
    service = '<service name="s"><inputs><instance name="a"/></inputs><outputs><instance name="b"/></outputs></service>'
    ends = '<provided><instance name="a"/></provided><wanted><instance name="b"/></wanted>'
    (tmp_path / "taxonomy.xml").write_text(taxonomy)
    (tmp_path / "problem.xml").write_text(f'<problemStructure><task name="t">{ends}</task></problemStructure>')
    (tmp_path / "services.xml").write_text(f"<services>{service}</services>")
    assert "not read" not in run("import", "wsc", tmp_path, "--out", tmp_path / "env.yaml").err
    with_quality = service.replace("<service ", '<service responseTime="5" ')
    (tmp_path / "services.xml").write_text(f"<services>{with_quality}</services>")
    (tmp_path / "taxonomy.owl").write_text("")
    said = run("import", "wsc", tmp_path, "--out", tmp_path / "env.yaml")
    assert said.code == 0, said.err
    assert "not read: the attribute responseTime of services, taxonomy.owl; " in said.err
