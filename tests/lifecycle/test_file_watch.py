"""The environment file as the way to change a running system."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from unittest import mock

import pytest
from cfgplan_runtime.lifecycle import file_watch
from cfgplan_runtime.lifecycle.file_watch import WorldWatch
from real_run import eventually

from cfgplan.api import World
from cfgplan.errors import Fault
from cfgplan.matching import ontology_files

ONTOLOGY = "@prefix : <http://e.org/o#> .\n@prefix owl: <http://www.w3.org/2002/07/owl#> .\n:Image a owl:Class .\n"
MAIN = "format: cfgplan/1\nontology: o.ttl\ninclude: [more]\ntargets: [{label: t, topic: /t, tag: Image}]\n"
PART = "transformations:\n  - {label: LABEL, outputs: {y: Image}}\n"


class Watched:
    def __init__(self, folder: Path, *, use_cache: bool = False) -> None:
        self.folder = folder
        self.worlds: list[World] = []
        self.faults: list[tuple[Fault, ...]] = []
        (folder / "more").mkdir()
        self.write("o.ttl", ONTOLOGY)
        self.write("more/a.yaml", PART.replace("LABEL", "a"))
        self.write("env.yaml", MAIN)
        self.watching = WorldWatch(
            folder / "env.yaml",
            lambda world, _: self.worlds.append(world),
            lambda _, faults: self.faults.append(faults),
            use_cache=use_cache,
        )
        self.watching.start()
        eventually(lambda: len(self.worlds) == 1)

    def write(self, name: str, text: str) -> None:
        """As editors do it: a new file takes the place of the old one."""
        new = self.folder / "new"
        new.write_text(text)
        new.replace(self.folder / name)

    def await_labels(self, *labels: str) -> None:
        eventually(lambda: [t.label for t in self.worlds[-1].environment.library] == list(labels))


@pytest.fixture
def watched(tmp_path: Path) -> Iterator[Watched]:
    watched = Watched(tmp_path)
    yield watched
    watched.watching.close()


@pytest.mark.parametrize(("use_cache", "parsed"), [(True, 2), (False, 3)])
def test_an_ontology_that_has_not_changed_is_parsed_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, parsed: int, *, use_cache: bool
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    with mock.patch.object(ontology_files, "_document_of", wraps=ontology_files._document_of) as read:
        watched = Watched(tmp_path, use_cache=use_cache)
        with closing(watched.watching):
            watched.write("env.yaml", MAIN + "horizon: 7\n")
            eventually(lambda: watched.worlds[-1].horizon_s == 7)
            watched.write("o.ttl", ONTOLOGY + ":Photo a owl:Class .\n")
            eventually(lambda: "Photo" in watched.worlds[-1].ontology.classes)
        assert read.call_count == parsed


def test_a_changed_file_is_read_anew(watched: Watched) -> None:
    watched.write("env.yaml", MAIN + "horizon: 7\n")
    eventually(lambda: watched.worlds[-1].horizon_s == 7)


def test_a_file_that_is_written_in_place_is_read_anew(watched: Watched) -> None:
    with (watched.folder / "env.yaml").open("a") as file:
        file.write("horizon: 8\n")
    eventually(lambda: watched.worlds[-1].horizon_s == 8)


def test_included_files_count_and_may_come_and_go(watched: Watched) -> None:
    watched.write("more/a.yaml", PART.replace("LABEL", "renamed"))
    watched.await_labels("renamed")
    watched.write("more/b.yaml", PART.replace("LABEL", "b"))
    watched.await_labels("b", "renamed")
    (watched.folder / "more" / "a.yaml").unlink()
    watched.await_labels("b")


def test_a_folder_that_is_included_later_is_watched_too(watched: Watched) -> None:
    (watched.folder / "later").mkdir()
    watched.write("later/c.yaml", PART.replace("LABEL", "c"))
    watched.write("env.yaml", MAIN.replace("[more]", "[more, later]"))
    watched.await_labels("a", "c")
    watched.write("later/c.yaml", PART.replace("LABEL", "changed"))
    watched.await_labels("a", "changed")


def test_the_ontology_counts(watched: Watched) -> None:
    watched.write("o.ttl", ONTOLOGY + ":x a owl:NamedIndividual , :Image .\n")
    eventually(lambda: "x" in watched.worlds[-1].ontology.individuals)


def test_a_broken_file_is_told_with_its_faults_and_so_is_the_mended_one(watched: Watched) -> None:
    watched.write("env.yaml", MAIN.replace("Image", "Nonsense"))
    eventually(lambda: len(watched.faults) == 1)
    (fault,) = watched.faults[0]
    assert (fault.line, "Nonsense" in fault.message) == (4, True)
    worlds = len(watched.worlds)
    watched.write("env.yaml", MAIN)
    eventually(lambda: len(watched.worlds) > worlds)


def test_a_file_that_is_gone_for_a_while_is_found_again(watched: Watched) -> None:
    (watched.folder / "env.yaml").unlink()
    eventually(lambda: len(watched.faults) == 1)
    watched.write("env.yaml", MAIN + "horizon: 9\n")
    eventually(lambda: watched.worlds[-1].horizon_s == 9)


def test_a_change_without_a_notice_is_found_by_looking(watched: Watched) -> None:
    linked = watched.folder / "elsewhere"
    linked.mkdir()
    (linked / "env.yaml").write_text(MAIN)
    (watched.folder / "env.yaml").unlink()
    (watched.folder / "env.yaml").symlink_to(linked / "env.yaml")
    eventually(lambda: len(watched.worlds) > 1)
    (linked / "env.yaml").write_text(MAIN + "horizon: 10\n")  # in a folder that nobody watches
    os.utime(linked / "env.yaml")
    eventually(lambda: watched.worlds[-1].horizon_s == 10)


def test_a_folder_that_vanishes_is_no_end(watched: Watched) -> None:
    (watched.folder / "more" / "a.yaml").unlink()
    (watched.folder / "more").rmdir()
    eventually(lambda: len(watched.faults) > 0)
    watched.write("env.yaml", MAIN.replace("include: [more]\n", "horizon: 11\n"))
    eventually(lambda: watched.worlds[-1].horizon_s == 11)


def test_a_file_that_blocks_whoever_reads_it_is_told_and_keeps_no_run_from_ending(
    watched: Watched, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(file_watch, "SLOW_S", 0.1)
    monkeypatch.setattr(file_watch, "_CLOSE_S", 0.1)
    path = watched.folder / "env.yaml"
    os.mkfifo(watched.folder / "pipe")
    (watched.folder / "pipe").replace(path)
    eventually(lambda: watched.faults and "has not been read for" in watched.faults[-1][0].message)
    watched.watching.close()
    path.write_text(MAIN)  # lets the thread that reads go on, and end
    eventually(lambda: "cfgplan-watching" not in {thread.name for thread in threading.enumerate()})


def test_what_a_listener_raises_ends_no_watch(watched: Watched, monkeypatch: pytest.MonkeyPatch) -> None:
    failed: list[str] = []

    def fail() -> None:
        raise ZeroDivisionError("a fault of the listener")

    give = watched.watching._give
    monkeypatch.setattr(watched.watching, "_give", lambda _, by: (failed.append(by), fail()))
    watched.write("env.yaml", MAIN + "horizon: 7\n")
    eventually(lambda: failed)
    monkeypatch.setattr(watched.watching, "_give", give)
    watched.write("env.yaml", MAIN + "horizon: 8\n")
    eventually(lambda: watched.worlds[-1].horizon_s == 8)
