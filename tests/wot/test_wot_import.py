"""`cfgplan import wot`: sources of what things offer, their tags, and what is told where a description is broken."""

from __future__ import annotations

import json
import socket
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import pytest

import cfgplan
from cfgplan.cli import main

THERMOSTAT = Path(__file__).parent / "thermostat.td.json"
TD = "https://www.w3.org/2022/wot/td/v1.1"
FORM = {"href": "mqtt://127.0.0.1/x", "op": "observeproperty"}


class Said(NamedTuple):
    code: int
    err: str
    world: cfgplan.World | None


Import = Callable[..., Said]


@pytest.fixture
def imported(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Import:
    def refuse(*_: object) -> None:
        raise AssertionError("nothing is fetched")

    monkeypatch.setattr(socket.socket, "connect", refuse)

    def imported(*arguments: object, out: str = "env.yaml") -> Said:
        code = main(["import", "wot", *map(str, arguments), "--out", str(tmp_path / out)])
        err = " ".join(capsys.readouterr().err.split())
        return Said(code, err, cfgplan.load(tmp_path / out) if code == 0 else None)

    return imported


@pytest.fixture
def write(tmp_path: Path) -> Callable[..., Path]:
    """Write the description of a thing, the given keys in place of its own."""

    def write(name: str = "lamp.td.json", **keys: Any) -> Path:
        thing = {"@context": TD, "title": "Lamp", "properties": {"on": {"forms": [FORM]}}, **keys}
        path = tmp_path / name
        path.write_text(json.dumps({key: value for key, value in thing.items() if value is not None}, indent=1))
        return path

    return write


def library(said: Said) -> dict[str, Any]:
    assert said.world is not None, said.err
    return {each.label: each for each in said.world.environment.library}


def test_properties_and_events_become_sources_of_what_they_mean(imported: Import) -> None:
    said = imported(THERMOSTAT)
    found = library(said)
    assert {label: each.source for label, each in found.items()} == {
        "Hall_thermostat-history": None,
        "Hall_thermostat-humidity": "cfgplan_runtime.http:Poller",
        "Hall_thermostat-temperature": "cfgplan_runtime.mqtt:Subscriber",
        "Hall_thermostat-window_open": "cfgplan_runtime.mqtt:Subscriber",
    }
    assert found["Hall_thermostat-temperature"].outputs[0].tag == (
        "Temperature and inUnit some degreeCelsius and ofThing some (Hall_thermostat and HVAC)"
        " and Hall_thermostat-temperature"
    )
    assert dict(found["Hall_thermostat-temperature"].params) == {
        "broker": "mqtt://127.0.0.1:1883",
        "topic": "house/hall/temperature",
        "payload": "number",
    }
    assert dict(found["Hall_thermostat-window_open"].params) == {
        "broker": "mqtt://127.0.0.1:1883",
        "topic": "house/+/window",
        "payload": "json",
        "qos": 2,
    }
    assert dict(found["Hall_thermostat-humidity"].params) == {
        "url": "http://127.0.0.1:8080/humidity",
        "payload": "json",
    }
    assert found["Hall_thermostat-humidity"].run.rate_hz == 1
    assert "Hall_thermostat-history by coap (readproperty): no unit knows how to reach them" in said.err


def test_terms_have_the_iris_of_their_contexts(imported: Import, tmp_path: Path) -> None:
    """So an ontology that is named too, such as SAREF's, says what is what."""
    imported(THERMOSTAT)
    (tmp_path / "saref.ttl").write_text(
        "@prefix owl: <http://www.w3.org/2002/07/owl#> .\n@prefix rdfs: <http://www.w3.org/2000/01/rdf-schema#> .\n"
        "<https://saref.etsi.org/core/> a owl:Ontology .\n<https://saref.etsi.org/core/Property> a owl:Class .\n"
        "<https://saref.etsi.org/core/Temperature> a owl:Class ;"
        " rdfs:subClassOf <https://saref.etsi.org/core/Property> .\n"
    )
    text = (tmp_path / "env.yaml").read_text().replace("ontology: env.ttl", "ontology: [env.ttl, saref.ttl]")
    (tmp_path / "env.yaml").write_text(f"{text}targets:\n  - {{label: t, topic: /t, tag: Property}}\n")
    problem, plan = cfgplan.solve(cfgplan.load(tmp_path / "env.yaml"))
    assert plan.change_set is not None
    assert [unit.transformation for unit in plan.change_set.started] == ["Hall_thermostat-temperature"]
    assert problem is not None


def test_the_target_that_the_head_proposes_is_met(imported: Import, tmp_path: Path) -> None:
    imported(THERMOSTAT)
    text = (tmp_path / "env.yaml").read_text()
    lines = [line.removeprefix("# ") for line in text.splitlines() if line.startswith("#   ")]
    (tmp_path / "env.yaml").write_text(text + "\n".join(line.removeprefix("  ") for line in lines) + "\n")
    _, plan = cfgplan.solve(cfgplan.load(tmp_path / "env.yaml"))
    assert (plan.status, plan.change_set is not None) == ("optimal", True)


def test_a_file_stands_for_a_context_that_is_never_fetched(
    imported: Import, write: Callable[..., Path], tmp_path: Path
) -> None:
    url = "https://example.org/context?v=1"
    thing = write(**{"@context": [TD, url], "properties": {"on": {"@type": "State", "forms": [FORM]}}})
    said = imported(thing)
    assert f"not imported: the context {url}, which is never fetched: `--context {url}=FILE` names a file" in said.err
    assert "no context defines State" in said.err
    (tmp_path / "base.json").write_text('{"@context": {"ex": "https://example.org/names#"}}')
    (tmp_path / "context.json").write_text('{"@context": ["https://example.org/base", {"State": "ex:OnOffState"}]}')
    base = f"https://example.org/base={tmp_path / 'base.json'}"
    said = imported(thing, "--context", f"{url}={tmp_path / 'context.json'}", "--context", base)
    assert "not imported" not in said.err
    assert "OnOffState and ofThing some Lamp and Lamp-on" in [each.outputs[0].tag for each in library(said).values()]
    assert "<https://example.org/names#OnOffState> a owl:Class" in (tmp_path / "env.ttl").read_text()


def test_terms_of_one_name_and_different_iris_are_different_concepts(
    imported: Import, write: Callable[..., Path]
) -> None:
    context = [TD, {"a": "https://a.org/", "b": "https://b.org/"}]
    properties = {name: {"@type": f"{name}:State", "forms": [FORM]} for name in ("a", "b")}
    found = library(imported(write(**{"@context": context, "properties": properties})))
    assert [each.outputs[0].tag.split()[0] for each in found.values()] == [
        "<https://a.org/State>",
        "<https://b.org/State>",
    ]
    state = {"@type": ["a:State", "nowhere:State", "a:Lamp", "a:Device"], "forms": [FORM]}
    said = imported(write(**{"@context": context, "title": "State", "properties": {"on": state}}))
    assert "no context defines nowhere:State" in said.err
    (own,) = library(said).values()
    assert own.outputs[0].tag == (
        "State and nowhere_State and Lamp and <https://a.org/Device> and ofThing some State_ and State_-on"
    )


def test_several_things_of_one_title_stay_apart_and_a_file_may_hold_a_list(
    imported: Import, write: Callable[..., Path], tmp_path: Path
) -> None:
    one = json.loads(write().read_text())
    (tmp_path / "lamps.td.json").write_text(json.dumps([one, one]))
    said = imported(tmp_path / "lamps.td.json", write(title="Desk lamp"))
    assert [*library(said)] == ["Desk_lamp-on", "Lamp-on", "Lamp_-on"]
    assert "3 sources of 3 things" in said.err


def test_security_is_told_with_the_params_for_it(imported: Import, write: Callable[..., Path]) -> None:
    definitions = {"login": {"scheme": "basic", "in": "header"}}
    said = imported(write(securityDefinitions=definitions, security=["login"]))
    assert "Lamp asks for security (basic): add `username` with `password_env` to its params" in said.err


def test_urls_keep_no_password(imported: Import, write: Callable[..., Path]) -> None:
    form = {"href": "mqtts://bob:sesame@127.0.0.1/a%20b", "op": "observeproperty", "contentType": "image/png"}
    (lamp,) = library(imported(write(properties={"on": {"forms": [form]}}))).values()
    assert dict(lamp.params) == {"broker": "mqtts://127.0.0.1", "topic": "a b", "payload": "bytes"}


@pytest.mark.parametrize(
    ("keys", "message", "place"),
    [
        ({"@context": "https://example.org"}, "this is not a Thing Description: its `@context` names none", ":2:14"),
        ({"@context": None}, "this is not a Thing Description", ":1:1"),
        ({"@context": [TD, 5]}, "a context is a URL or a mapping", ":2:"),
        ({"@context": [TD, {"@vocab": 7}]}, "its `@context` can't be used: @vocab value must be a string", ""),
        ({"title": None}, "the thing has no title", ":1:1"),
        ({"base": 5}, "`base` is a URL", ":"),
        ({"properties": ["on"]}, "`properties` is a mapping", ":4:"),
        ({"properties": {"on": 5}}, "a property is a mapping", ":5:"),
        ({"properties": {"on": {}}}, "`on` has no `forms`", ":5:"),
        ({"properties": {"on": {"forms": []}}}, "`on` has no `forms`", ":"),
        ({"properties": {"on": {"forms": [{}]}}}, "a form has an `href`", ":"),
        ({"properties": {"on": {"forms": [{"href": "on"}]}}}, "`on` is not a complete URL", ":"),
        (
            {"properties": {"on": {"forms": [{**FORM, "op": "readpropert"}]}}},
            "`readpropert` is not an operation of a property",
            ":",
        ),
        ({"properties": {"on": {"@type": 5, "forms": [FORM]}}}, "`@type` is a term or a list of terms", ":"),
        ({"properties": {"on": {"unit": 5, "forms": [FORM]}}}, "`unit` is a term", ":"),
        ({"events": {"e": {"data": 5, "forms": [{"href": "mqtt://h/x"}]}}}, "`data` is a schema", ":"),
        ({"security": "login"}, "`login` is not in `securityDefinitions`", ":"),
        ({"properties": {}}, "nothing that 1 thing describe can be a source", ""),
    ],
)
def test_a_broken_description_is_told_with_its_place_and_a_mend(
    keys: dict[str, Any], message: str, place: str, imported: Import, write: Callable[..., Path], tmp_path: Path
) -> None:
    path = write(**keys)
    said = imported(path)
    assert said.code == 30
    assert message in said.err
    if place:
        assert f"{path}{place}" in said.err
    assert not (tmp_path / "env.yaml").exists()


def test_all_faults_of_all_files_are_told_at_once(imported: Import, write: Callable[..., Path], tmp_path: Path) -> None:
    (tmp_path / "text.td.json").write_text('{"title": ')
    form = {**FORM, "op": "readpropert"}
    said = imported(
        write(title=None, properties={"on": {}, "off": {"forms": [form, {"href": "off"}]}}),
        tmp_path / "text.td.json",
        tmp_path / "absent.json",
    )
    for text in (
        "the thing has no title",
        'add "title": "..."',
        'add "forms": [{"href": "..."}]',
        "did you mean `readproperty`?",
        'write one, or add "base": "..." to the thing',
        "this is not JSON",
        "absent.json: there is no such file",
    ):
        assert text in said.err
    assert "Errno" not in said.err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["import", "wot", "x.json"], "name the environment file with --out"),
        (["import", "xml", "x.xml", "--context", "a=b"], "--context: `import xml` does not take this option"),
    ],
)
def test_options_that_can_not_be_meant_are_told(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(arguments) == 30
    assert message in " ".join(capsys.readouterr().err.split())


@pytest.mark.parametrize("content", ["{", "[]", "{}", None])
def test_a_file_that_is_no_context_is_told(content: str | None, imported: Import, tmp_path: Path) -> None:
    file = tmp_path / "context.json"
    if content is not None:
        file.write_text(content)
    said = imported(THERMOSTAT, "--context", f"https://example.org={file}")
    assert (said.code, "context.json" in said.err, "Errno" in said.err) == (30, True, False)
