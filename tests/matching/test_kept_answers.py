from __future__ import annotations

import json
from pathlib import Path

import pytest

from cfgplan import cache_folder
from cfgplan.matching import Matching, Ontology, match, session

OFFERED = ["Undistorted ⊓ ∃hasSource.{cam1}", "Undistorted", "RawRGB ⊓ Camera"]
DEMANDED = ["Undistorted ⊓ ∃hasSource.Camera", "Image"]


def kept(folder: Path) -> list[Path]:
    return sorted(folder.rglob("*.json"))


def test_the_second_answer_comes_from_the_cache_and_is_the_same(
    streams: Ontology, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = match(OFFERED, DEMANDED, streams, cache=tmp_path)
    monkeypatch.delattr(session, "Matcher")
    assert match(list(reversed(OFFERED)), DEMANDED, streams, cache=tmp_path) == first
    assert first.warnings


@pytest.mark.parametrize(
    "damage",
    [b"", b"{", b"[]", b"null", b'{"format": "cfgplan-matching/3"}', b"\xff\xfe", b'{"format": 5, "rows": []}'],
)
def test_a_damaged_or_foreign_file_is_ignored_and_written_anew(
    damage: bytes, streams: Ontology, tmp_path: Path
) -> None:
    first = match(OFFERED, DEMANDED, streams, cache=tmp_path)
    (file,) = kept(tmp_path)
    good = file.read_bytes()
    file.write_bytes(damage)
    assert match(OFFERED, DEMANDED, streams, cache=tmp_path) == first
    assert file.read_bytes() == good


@pytest.mark.parametrize("rows", [[[0]], [[7], [0]], [["0"], []], [[-1], []], {"a": 1}])
def test_rows_that_do_not_fit_the_tags_are_ignored(rows: object, streams: Ontology, tmp_path: Path) -> None:
    first = match(OFFERED, DEMANDED, streams, cache=tmp_path)
    (file,) = kept(tmp_path)
    file.write_text(json.dumps({**json.loads(file.read_text()), "rows": rows}))
    assert match(OFFERED, DEMANDED, streams, cache=tmp_path) == first


def test_other_axioms_tags_or_reasoners_are_other_answers(streams: Ontology, tmp_path: Path) -> None:
    match(OFFERED, DEMANDED, streams, cache=tmp_path)
    match(OFFERED, DEMANDED[:1], streams, cache=tmp_path)
    match(OFFERED, DEMANDED, streams, cache=tmp_path, reasoner="el")
    more = Ontology([*streams.axioms, "SubClassOf(<w#RawRGB> <w#Undistorted>)"], streams.prefixes)
    assert match(["RawRGB"], ["Undistorted"], more, cache=tmp_path).similarity.holds("RawRGB", "Undistorted")
    assert not match(["RawRGB"], ["Undistorted"], streams, cache=tmp_path).similarity.holds("RawRGB", "Undistorted")
    assert len(kept(tmp_path)) == 5


def test_what_is_unknown_is_not_kept(streams: Ontology, tmp_path: Path) -> None:
    match(["Image"], ["¬Camera"], streams, cache=tmp_path, reasoner="el")
    assert not kept(tmp_path)


def test_a_cache_that_can_not_be_written_is_no_error(streams: Ontology, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    assert isinstance(match(OFFERED, DEMANDED, streams, cache=tmp_path / "file"), Matching)


def test_the_oldest_answers_go_first(streams: Ontology, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cache_folder, "MOST_FILES", 2)
    for number in range(1, 5):
        match(OFFERED[:1], ["Image", f"≥{number} hasSource.Device"][: number % 2 + 1], streams, cache=tmp_path)
    assert len(kept(tmp_path)) <= 2
