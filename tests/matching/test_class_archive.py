"""The archive of HermiT's classes: made once it pays, used from then on, and never in the way."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import textwrap
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

from cfgplan.matching import Ontology, class_archive, hermit, match

one_archive = pytest.mark.xdist_group("class archive")
DOCUMENT = "Ontology(<t:o> Declaration(Class(<t:0>)) Declaration(Class(<t:1>)) DisjointClasses(<t:0> <t:1>))"


@pytest.fixture
def asked_once() -> None:
    """These tests are about each start of Java."""


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache" / "cfgplan" / "hermit"


def ask(time_limit_s: float | None = None) -> dict[str, bool]:
    return hermit.satisfiable(DOCUMENT, ["t:0"], time_limit_s=time_limit_s)


def archives(cache: Path) -> list[Path]:
    return sorted(cache.glob("*/"))


class Made(NamedTuple):
    """A cache folder with an archive, how many archives were there before and after three processes that asked at once,
    and the exit codes of these, which are 0 if they were answered.
    """

    folder: Path
    before: int
    after: int
    ended: list[int]


@pytest.fixture(scope="module")
def made_for_all(tmp_path_factory: pytest.TempPathFactory) -> Made:
    """Making an archive costs some seconds of CPU time, and its second part knows the place of the first."""
    home = tmp_path_factory.mktemp("made")
    folder = home / "cfgplan" / "hermit"
    code = textwrap.dedent(
        f"""
        from cfgplan.matching import class_archive, hermit
        class_archive.PAYS_AFTER = 2
        assert hermit.satisfiable({DOCUMENT!r}, ["t:0"]) == {{"t:0": True}}
        """
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(home))
        patch.setattr(class_archive, "PAYS_AFTER", 2)
        assert ask() == {"t:0": True}
        before = len(archives(folder))
        running = [subprocess.Popen([sys.executable, "-c", code]) for _ in range(3)]
        ended = [process.wait() for process in running]
    return Made(folder, before, len(archives(folder)), ended)


@pytest.fixture
def made(made_for_all: Made, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The folder of the archive that all these tests use; its files are given back as they were."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(made_for_all.folder.parent.parent))
    (made,) = archives(made_for_all.folder)
    kept = shutil.copytree(made, tmp_path / "kept")
    yield made
    shutil.rmtree(made)
    shutil.copytree(kept, made)


@one_archive
def test_the_archive_is_made_once_it_pays_and_then_used(made_for_all: Made, made: Path) -> None:
    assert (made_for_all.before, made_for_all.after) == (0, 1)
    assert {path.name for path in made.iterdir()} >= {"java.jsa", "hermit.jsa"}
    before = {path: path.stat().st_mtime_ns for path in made_for_all.folder.rglob("*.*")}
    assert ask() == {"t:0": True}
    assert {path: path.stat().st_mtime_ns for path in made_for_all.folder.rglob("*.*")} == before
    loaded = classes_from_the_archive(made)
    assert any("org.semanticweb.HermiT" in line for line in loaded)


def classes_from_the_archive(made: Path) -> list[str]:
    """The lines of Java's log on classes that came from an archive, while it is asked as `hermit` asks it."""
    archive = class_archive.archive_for(hermit._java_command(), hermit._OPTIONS, hermit._jar(), hermit._MAIN)
    assert archive is not None
    assert archive.folder == made
    question = made.parent / "question.ofn"
    question.write_text(DOCUMENT)
    flags = [flag for flag in archive.use() if not flag.startswith("-Xlog")]
    asked = ["-cp", str(archive.jar), archive.main, "--consistency=t:0", question.as_uri()]
    command = [archive.java, *archive.options, *flags, "-Xlog:class+load", *asked]
    said = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    return [line for line in said.splitlines() if "shared objects file" in line]


@one_archive
@pytest.mark.parametrize("damage", ["cut", "flipped", "emptied"])
def test_a_damaged_archive_changes_no_answer(damage: str, made: Path) -> None:
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
    archive = class_archive.archive_for(hermit._java_command(), hermit._OPTIONS, hermit._jar(), hermit._MAIN)
    assert archive is not None
    archive.folder.mkdir(parents=True)
    (archive.folder / "question.ofn").write_text("")
    ask()
    assert [path.name for path in archive.folder.iterdir()] == ["question.ofn"]
    assert archives(cache) == [archive.folder]
    monkeypatch.setattr(class_archive.ClassArchive, "_run", lambda made, *_: (made.folder / "hermit.jsa.part").touch())
    long_ago = archive.folder.stat().st_mtime - 2 * class_archive._ABANDONED_S
    os.utime(archive.folder, (long_ago, long_ago))
    archive.count(None)
    assert (archive.folder / "hermit.jsa").exists()


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
    assert archive.use() == ()


def test_another_java_jar_or_option_has_another_archive(tmp_path: Path) -> None:
    jar = tmp_path / "some.jar"
    jar.write_text("1")
    made = [class_archive.archive_for(sys.executable, options, jar, "Main") for options in ((), ("-Xss64m",))]
    jar.write_text("12")
    made += [class_archive.archive_for(java, (), jar, "Main") for java in (sys.executable, "/bin/sh")]
    assert len({archive.folder for archive in made if archive is not None}) == 4
    assert class_archive.archive_for("no-such-java", (), jar, "Main") is None


@pytest.mark.usefixtures("cache")
def test_the_archives_that_were_used_last_are_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(class_archive, "PAYS_AFTER", 1)
    monkeypatch.setattr(class_archive.ClassArchive, "_run", lambda made, *_: (made.folder / "hermit.jsa.part").touch())
    jars = [Path(__file__), Path(class_archive.__file__), Path(pytest.__file__), Path(os.__file__)]
    made = [class_archive.archive_for(sys.executable, (), jar, "Main") for jar in jars]
    for number, archive in enumerate(made):
        assert archive is not None
        archive.count(None)
        os.utime(archive.folder, (number, number))
        if number == class_archive.MOST_ARCHIVES - 1:
            assert made[0] is not None and made[0].use(), "it is no longer the one that was not used for longest"
    assert [archive is not None and bool(archive.use()) for archive in made] == [True, False, True, True]
    dropped = made[1]
    assert dropped is not None and not dropped.folder.with_suffix(".asked").exists(), "it may be made again as soon"


@one_archive
def test_processes_that_ask_at_once_make_one_archive_and_all_answer(
    made_for_all: Made, made: Path, streams: Ontology
) -> None:
    assert made_for_all.ended == [0, 0, 0]
    assert archives(made_for_all.folder) == [made]
    assert match(["Image"], ["¬Device"], streams).similarity.holds("Image", "¬Device")
