from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from cfgplan import cache_folder
from cfgplan.errors import InputError
from cfgplan.matching import load_ontology, ontology, ontology_document, ontology_files

TURTLE = """@prefix : <http://w.example/#> .
@prefix owl: <http://www.w3.org/2002/07/owl#> .
@prefix rdfs: <http://www.w3.org/2000/01/rdf-schema#> .
<http://w.example/> a owl:Ontology ; owl:imports <other.ttl> .
:Camera a owl:Class ; rdfs:subClassOf <#Device> , [ a owl:Restriction ; owl:onProperty :has ; owl:cardinality "x" ] .
:has a owl:ObjectProperty .
"""
OTHER = (
    "<http://o.example/> a <http://www.w3.org/2002/07/owl#Ontology> . <http://o.example/A> a <http://w.example/#B> ."
)


@pytest.fixture
def files(tmp_path: Path) -> Path:
    """An ontology with an import, a relative name and a loss."""
    (tmp_path / "world.ttl").write_text(TURTLE)
    (tmp_path / "other.ttl").write_text(OTHER)
    return tmp_path / "world.ttl"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path / "cache"


def kept(folder: Path) -> list[Path]:
    return sorted(folder.rglob("*.json"))


def no_parser(*_: object) -> None:
    raise AssertionError("a file is parsed")


def test_an_ontology_is_parsed_once_and_is_the_same_then(
    files: Path, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    alone, first = load_ontology([files]), load_ontology([files], cache=folder)
    assert len(kept(folder)) == 2
    monkeypatch.setattr(ontology_files, "_document_of", no_parser)
    again = load_ontology([files], cache=folder)
    assert again == first == alone
    assert again.warnings == alone.warnings != ()
    assert (again.files, again.digest) == (alone.files, alone.digest)
    assert (again.classes, again.individuals) == (alone.classes, alone.individuals)


def test_a_kept_file_gives_its_names_without_its_trees(
    files: Path, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    load_ontology([files], cache=folder)
    monkeypatch.setattr(ontology, "parse", no_parser)
    again = load_ontology([files], cache=folder)
    assert {*again.classes} == {"A", "B", "Camera", "Device"} - {"A"}
    assert {*again.individuals} == {"A"}
    monkeypatch.undo()
    more = again.with_axioms([*again.axioms, "Declaration(Class(<http://w.example/#New>))"])
    assert "New" in more.classes


def test_names_of_rules_that_are_left_out_are_left_out(tmp_path: Path, folder: Path) -> None:
    (tmp_path / "rules.ofn").write_text(
        "Prefix(:=<http://w.example/#>) Ontology(<http://w.example/> Declaration(Class(:A)) "
        "DLSafeRule(Body(ClassAtom(:A Variable(<urn:x>)))Head(ClassAtom(:OnlyInTheRule Variable(<urn:x>)))))"
    )
    for _ in range(2):
        assert "OnlyInTheRule" in load_ontology([tmp_path / "rules.ofn"], cache=folder).classes
        assert {*load_ontology([tmp_path / "rules.ofn"], cache=folder, ignores_rules=True).classes} == {"A"}


def test_another_content_another_place_or_other_code_is_another_file(
    files: Path, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    load_ontology([files], cache=folder)
    files.write_text(TURTLE.replace(":Camera", ":Lidar"))
    assert "Lidar" in load_ontology([files], cache=folder).classes
    moved = files.with_name("moved.ttl")
    moved.write_text(TURTLE)
    assert load_ontology([moved], cache=folder) == load_ontology([moved]) != load_ontology([files])
    monkeypatch.setattr(ontology_document, "_mark_of_readers", lambda: ())
    before = len(kept(folder))
    load_ontology([moved], cache=folder)
    assert len(kept(folder)) == before + 2


def test_the_mark_of_the_code_has_the_parsers_and_the_readers() -> None:
    names = {name for name, _, _ in ontology_document._mark_of_readers()}
    assert {"ontology_files.py", "rdf.py", "functional.py"} <= names
    for parser in ("pyhornedowl.", "pyoxigraph."):
        assert any(name.startswith(parser) for name in names)


def test_faults_are_told_each_time_and_nothing_is_kept(tmp_path: Path, folder: Path) -> None:
    (tmp_path / "world.ttl").write_text("a b")
    for _ in range(2):
        with pytest.raises(InputError, match="can't be read as Turtle"):
            load_ontology([tmp_path / "world.ttl"], cache=folder)
    assert not kept(folder)


@pytest.mark.parametrize(
    "damage",
    [
        b"",
        b"[]",
        b"\xff",
        b"[" * 100_000,
        {"format": "cfgplan-ontology/0"},
        {"key": "other"},
        {"iri": 3},
        {"axioms": None},
        {"axioms": [3]},
        {"imports": [[]]},
        {"prefixes": ["a"]},
        {"prefixes": {"a": 3}},
        {"dropped": 1},
        {"lost_rules": ["abc"]},
        {"lost_rules": [["a", 3]]},
        {"signature": None},
        {"signature": [[], []]},
        {"signature": [[], [], [3]]},
    ],
)
def test_a_damaged_or_foreign_file_is_ignored_and_written_anew(
    damage: bytes | dict[str, object], files: Path, folder: Path
) -> None:
    files.write_text(TURTLE.replace(" ; owl:imports <other.ttl>", ""))
    first = load_ontology([files], cache=folder)
    (file,) = kept(folder)
    good = json.loads(file.read_bytes())
    file.write_bytes(damage if isinstance(damage, bytes) else json.dumps({**good, **damage}).encode())
    assert load_ontology([files], cache=folder) == first
    anew = json.loads(file.read_bytes())
    assert {**anew, "axioms": sorted(anew["axioms"])} == {**good, "axioms": sorted(good["axioms"])}


def test_a_folder_that_can_not_be_written_is_no_error(files: Path, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    assert load_ontology([files], cache=tmp_path / "file") == load_ontology([files])


def test_the_oldest_files_go_first(files: Path, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cache_folder, "MOST_BYTES", 3_000)
    for number in range(9):
        files.write_text(TURTLE.replace("Camera", f"Camera{number}"))
        load_ontology([files], cache=folder)
    assert 0 < sum(file.stat().st_size for file in kept(folder)) <= 3_000
    assert any("Camera8" in file.read_text() for file in kept(folder))


def test_an_ontology_of_many_files_is_kept_as_a_whole(
    files: Path, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """If an ontology had more files than were kept, each was dropped before it was read again."""
    imports = "".join(f", <part{number}.ttl>" for number in range(100))
    files.write_text(TURTLE.replace("<other.ttl>", f"<other.ttl>{imports}"))
    for number in range(100):
        (files.parent / f"part{number}.ttl").write_text(OTHER.replace("o.example", f"o{number}.example"))
    first = load_ontology([files], cache=folder)
    monkeypatch.setattr(ontology_files, "_document_of", no_parser)
    assert load_ontology([files], cache=folder) == first


def test_a_content_that_is_larger_than_the_folder_may_be_drops_no_other(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    part = cache_folder.CachePart("part", "form/1")
    part.keep(folder, "small", {"text": ""})
    monkeypatch.setattr(cache_folder, "MOST_BYTES", 100)
    part.keep(folder, "large", {"text": 100 * "a"})
    assert [path.name for path in kept(folder)] == ["small.json"]


def test_an_interrupted_writing_leaves_no_file(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(path: Path, text: str) -> None:
        path.write_bytes(text.encode()[:9])
        raise KeyboardInterrupt

    monkeypatch.setattr(cache_folder.Path, "write_text", interrupted)
    with pytest.raises(KeyboardInterrupt):
        cache_folder.CachePart("part", "form/1").keep(folder, "key", {})
    assert [path.name for path in folder.rglob("*")] == ["part"]


def test_files_that_killed_processes_left_half_written_go_with_the_oldest(
    files: Path, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cache_folder, "MOST_FILES", 1)
    load_ontology([files], cache=folder)
    (file,) = kept(folder)
    half = file.with_suffix(".7.tmp")
    half.write_text("{")
    os.utime(half, (0, 0))
    files.write_text(TURTLE.replace("Camera", "Lamp"))
    load_ontology([files], cache=folder)
    assert not half.exists()


def test_a_user_without_a_home_has_no_cache(monkeypatch: pytest.MonkeyPatch) -> None:
    def home() -> Path:
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setattr(cache_folder.Path, "home", home)
    assert cache_folder.cache_folder() is None
