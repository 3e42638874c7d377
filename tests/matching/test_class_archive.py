"""The archive of HermiT's classes: made once it pays, used from then on, and never in the way."""

from __future__ import annotations

import os
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

from cfgplan.matching import Ontology, class_archive, hermit, match

DOCUMENT = "Ontology(<t:o> Declaration(Class(<t:0>)) Declaration(Class(<t:1>)) DisjointClasses(<t:0> <t:1>))"


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache" / "cfgplan" / "hermit"


def ask(time_limit_s: float | None = None) -> dict[str, bool]:
    return hermit.satisfiable(DOCUMENT, ["t:0"], time_limit_s=time_limit_s)


def archives(cache: Path) -> list[Path]:
    return sorted(cache.glob("*/"))


def test_the_archive_is_made_once_it_pays_and_then_used(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(class_archive, "PAYS_AFTER", 2)
    assert ask() == {"t:0": True}
    assert archives(cache) == []
    assert ask() == {"t:0": True}
    (made,) = archives(cache)
    assert {path.name for path in made.iterdir()} >= {"java.jsa", "hermit.jsa"}
    before = {path: path.stat().st_mtime_ns for path in cache.rglob("*")}
    assert ask() == {"t:0": True}
    assert {path: path.stat().st_mtime_ns for path in cache.rglob("*")} == before
    loaded = classes_from_the_archive(made)
    assert any("org.semanticweb.HermiT" in line for line in loaded)


def classes_from_the_archive(made: Path) -> list[str]:
    """The lines of Java's log on classes that came from an archive, while it is asked as `hermit` asks it."""
    archive = class_archive.archive_for(hermit._java_command(), hermit._OPTIONS, hermit._jar(), hermit._MAIN)
    assert archive is not None
    assert archive.folder == made
    question = made.parent / "question.ofn"
    question.write_text(DOCUMENT)
    flags = [flag for flag in archive.flags if not flag.startswith("-Xlog")]
    asked = ["-cp", str(archive.jar), archive.main, "--consistency=t:0", question.as_uri()]
    command = [archive.java, *archive.options, *flags, "-Xlog:class+load", *asked]
    said = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    return [line for line in said.splitlines() if "shared objects file" in line]


@pytest.mark.parametrize("damage", ["cut", "flipped", "emptied"])
def test_a_damaged_archive_changes_no_answer(damage: str, cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(class_archive, "PAYS_AFTER", 1)
    ask()
    (made,) = archives(cache)
    for path in made.glob("*.jsa"):
        content = bytearray(path.read_bytes())
        if damage == "flipped":
            content[8192::4096] = bytes(byte ^ 255 for byte in content[8192::4096])
        path.chmod(0o644)
        path.write_bytes({"cut": content[: len(content) // 2], "flipped": content, "emptied": b""}[damage])
    assert ask() == {"t:0": True}


def test_an_archive_that_another_process_makes_is_left_alone_until_it_was_given_up(
    cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(class_archive, "PAYS_AFTER", 1)
    ask()
    (made,) = archives(cache)
    (made / "hermit.jsa").unlink()
    (made / "java.jsa").unlink()
    ask()
    assert [path.name for path in made.iterdir()] == ["question.ofn"]
    long_ago = made.stat().st_mtime - 2 * class_archive._ABANDONED_S
    os.utime(made, (long_ago, long_ago))
    ask(), ask()
    assert (made / "hermit.jsa").exists()


def test_without_a_folder_to_write_to_questions_are_answered(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(class_archive, "PAYS_AFTER", 1)
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    assert ask() == {"t:0": True}


def test_a_question_in_a_hurry_makes_no_archive(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(class_archive, "PAYS_AFTER", 1)
    assert ask(class_archive.NO_HURRY_S - 1) == {"t:0": True}
    assert archives(cache) == []


def test_an_archive_that_cannot_be_made_is_tried_again_ever_more_rarely(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked, tried = 0, []
    monkeypatch.setattr(class_archive.ClassArchive, "make", lambda _: tried.append(asked))
    archive = class_archive.archive_for(sys.executable, (), Path(__file__), "Main")
    assert archive is not None
    while asked < 100:
        asked += 1
        archive.count(None)
    assert tried == [8, 16, 32, 64]
    assert archive.flags == ()


def test_another_java_jar_or_option_has_another_archive(tmp_path: Path) -> None:
    jar = tmp_path / "some.jar"
    jar.write_text("1")
    made = [class_archive.archive_for(sys.executable, options, jar, "Main") for options in ((), ("-Xss64m",))]
    jar.write_text("12")
    made += [class_archive.archive_for(java, (), jar, "Main") for java in (sys.executable, "/bin/sh")]
    assert len({archive.folder for archive in made if archive is not None}) == 4
    assert class_archive.archive_for("no-such-java", (), jar, "Main") is None


def test_only_a_few_archives_are_kept(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(class_archive, "PAYS_AFTER", 1)
    for number in range(5):
        (cache / f"old{number}").mkdir(parents=True)
        os.utime(cache / f"old{number}", (number, number))
    ask()
    assert len(archives(cache)) == class_archive.MOST_ARCHIVES
    assert not (cache / "old0").exists()


def test_processes_that_ask_at_once_make_one_archive_and_all_answer(cache: Path, streams: Ontology) -> None:
    code = textwrap.dedent(
        f"""
        from cfgplan.matching import class_archive, hermit
        class_archive.PAYS_AFTER = 1
        for _ in range(2):
            assert hermit.satisfiable({DOCUMENT!r}, ["t:0"]) == {{"t:0": True}}
        """
    )
    running = [subprocess.Popen([sys.executable, "-c", code]) for _ in range(3)]
    assert [process.wait() for process in running] == [0, 0, 0]
    assert len(archives(cache)) == 1
    assert match(["Image"], ["¬Device"], streams).similarity.holds("Image", "¬Device")
