"""Docstrings and pages are read once: few of their sentences have a form that sends the reader back.

A form is a hint: a clear sentence may have one, so each room may have a few. Name the subject, use a verb that does
something, and the field's noun instead of a paraphrase ("the running configuration", not "what runs").
"""

from __future__ import annotations

import ast
import re
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
TOPS = ("cfgplan", "runtime/cfgplan_runtime", "models", "experiments")
MOST_PERCENT = 2.0
READ_TWICE = {
    "begins with a relative or with Of": r"^(what|whatever|whoever|which|those|that|such|so many|so much|of)\b",
    "names a thing by a what-clause": r"\bwhat (is|was|has|had|can|may|comes|runs|stands|begins|they|it|there)\b"
    r"|\ball that (is|has|runs|there)\b|\b(whoever|who (is|has|gives|wants))\b|\bof which\b",
    "has an empty subject": r"\bthere (is|are) (a|an|no)\b|\b(is|are) (to be|there)\b|\b(nobody|somebody)\b",
    "has an archaic word": r"\b(anew|alike|dearer|dearest|bears?|heir|at rest|told apart|suffices?|begun)\b"
    r"|\b(goes?|gone) (over|on)\b|\bwanted for itself\b|\bstands? in\b",
}


def _room(path: Path) -> str:
    """The folder of a room below its top; pages and modules of a top itself are the room of its name."""
    top = next((top for top in TOPS if path.is_relative_to(ROOT / top)), "")
    if top in ("models", "experiments", ""):
        return top or "pages"
    return "/".join([top, *path.relative_to(ROOT / top).parts[:-1][:1]])


def _texts() -> Iterator[tuple[str, str, str]]:
    """Yield room, place and text of each docstring, and of each line of a page outside of code, tables and headings."""
    for top in TOPS:
        for path in sorted((ROOT / top).rglob("*.py")):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef | ast.Module):
                    place = f"{path.relative_to(ROOT)}:{getattr(node, 'lineno', 1)}"
                    yield _room(path), place, ast.get_docstring(node) or ""
    for path in sorted([*ROOT.glob("*.md"), *(page for top in TOPS for page in (ROOT / top).rglob("*.md"))]):
        is_code = False
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
            is_code ^= line.lstrip().startswith("```")
            if not is_code and not line.startswith(("|", "```", "<!--", "#", " ")):
                yield _room(path), f"{path.relative_to(ROOT)}:{number}", line


def _forms(sentence: str) -> list[str]:
    return [form for form, pattern in READ_TWICE.items() if re.search(pattern, sentence, re.IGNORECASE)]


def _by_room() -> dict[str, tuple[list[str], list[str]]]:
    """All sentences of each room with their places, and those that have a form."""
    found: dict[str, tuple[list[str], list[str]]] = defaultdict(lambda: ([], []))
    for room, place, text in _texts():
        for sentence in filter(None, re.split(r"(?<=[.;:?])\s+", text)):
            whole, twice = found[room]
            whole.append(sentence)
            if forms := _forms(sentence):
                twice.append(f"{place}: {' '.join(sentence.split())} ({', '.join(forms)})")
    return found


ROOMS = _by_room()


@pytest.mark.parametrize("room", sorted(ROOMS))
def test_few_sentences_of_a_room_must_be_read_twice(room: str) -> None:
    whole, twice = ROOMS[room]
    assert 100 * len(twice) / len(whole) <= MOST_PERCENT, "\n".join(twice)


@pytest.mark.parametrize(
    "sentence",
    [
        "What puts at the keys of a tunnel.",
        "Those that can't wait run",
        "Of several reasons the shortest is given.",
        "Put what is due.",
        "Whoever knows that passes it.",
        "None if there is no plan",
        "The pairs that nobody has decided.",
        "Files are written anew.",
    ],
)
def test_a_sentence_that_is_read_twice_is_noticed(sentence: str) -> None:
    assert _forms(sentence)


@pytest.mark.parametrize("sentence", ["Return the interval.", "Send all frames that are due.", "None if unknown."])
def test_a_plain_sentence_is_not(sentence: str) -> None:
    assert not _forms(sentence)


def test_no_comment_begins_with_a_word_that_has_to_be_read_twice() -> None:
    begins = re.compile(r"(?:^|\s)# (?:What|Those|That|Of) ")
    files = (path for top in (*TOPS, "tests") for path in (ROOT / top).rglob("*"))
    sources = (path for path in files if path.suffix in {".py", ".yaml"})
    lines = ((path, line) for path in sources for line in path.read_text(encoding="utf-8").splitlines())
    assert [f"{path.relative_to(ROOT)}: {line.strip()}" for path, line in lines if begins.search(line)] == []
