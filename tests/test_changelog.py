"""The changelog has the form of Keep a Changelog, and says each thing once."""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path

TEXT = (Path(__file__).parent.parent / "CHANGELOG.md").read_text(encoding="utf-8")
KINDS = ("Added", "Changed", "Deprecated", "Removed", "Fixed", "Security")
"""The kinds of changes, in the order that https://keepachangelog.com/en/1.1.0/ has."""


def headings(level: int, text: str) -> list[tuple[str, str]]:
    """The headings of a level, each with the text below it."""
    _, *parts = re.split(rf"^{'#' * level} (.+)$", text, flags=re.MULTILINE)
    return list(zip(parts[::2], parts[1::2], strict=True))


def test_each_version_groups_its_changes_by_kind_and_subject() -> None:
    versions = headings(2, TEXT)
    assert versions
    for version, text in versions:
        kinds = [kind for kind, _ in headings(3, text)]
        assert kinds == sorted(set(kinds), key=KINDS.index), version
        orders = [[subject for subject, _ in headings(4, below)] for _, below in headings(3, text)]
        known = list(dict.fromkeys(subject for subjects in orders for subject in subjects))
        for kind, subjects in zip(kinds, orders, strict=True):
            assert subjects, f"{kind} has no subject"
            assert len(subjects) == len(set(subjects)), kind
        assert len(known) <= 12, "a subject has two names"


def test_each_change_is_one_line_below_a_subject_and_stands_there_once() -> None:
    changes = [line for line in TEXT.splitlines() if line.startswith("* ")]
    assert len(changes) > 200
    assert [change for change, times in Counter(changes).items() if times > 1] == []
    for _, text in headings(2, TEXT):
        for kind, below in headings(3, text):
            for subject, lines in headings(4, below):
                listed = [line for line in lines.splitlines() if line]
                assert listed, f"{kind}, {subject}: nothing"
                wrong = [line for line in listed if not re.match(r"\* .*[.)]$", line)]
                assert not wrong, f"{kind}, {subject}: {wrong}"
