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


def _files() -> Iterator[Path]:
    """Yield the modules and pages of all rooms."""
    yield from ROOT.glob("*.md")
    for top in TOPS:
        for suffix in ("py", "md"):
            yield from (ROOT / top).rglob(f"*.{suffix}")


def _texts(path: Path) -> Iterator[tuple[str, str]]:
    """Yield place and text of each docstring, or of each line of a page outside of code, tables and headings."""
    place, whole = path.relative_to(ROOT), path.read_text(encoding="utf-8")
    if path.suffix == ".py":
        for node in ast.walk(ast.parse(whole)):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef | ast.Module):
                yield f"{place}:{getattr(node, 'lineno', 1)}", ast.get_docstring(node) or ""
        return
    is_code = False
    for number, line in enumerate(whole.splitlines(), 1):
        is_code ^= line.lstrip().startswith("```")
        if not is_code and not line.startswith(("|", "```", "<!--", "#", " ")):
            yield f"{place}:{number}", line


def _forms(sentence: str) -> list[str]:
    return [form for form, pattern in READ_TWICE.items() if re.search(pattern, sentence, re.IGNORECASE)]


FILES = defaultdict[str, list[Path]](list)
for file in sorted(_files()):
    FILES[_room(file)].append(file)


@pytest.mark.parametrize("room", sorted(FILES))
def test_few_sentences_of_a_room_must_be_read_twice(room: str) -> None:
    number, twice = 0, []
    for path in FILES[room]:
        for place, text in _texts(path):
            for sentence in filter(None, re.split(r"(?<=[.;:?])\s+", text)):
                number += 1
                if forms := _forms(sentence):
                    twice.append(f"{place}: {' '.join(sentence.split())} ({', '.join(forms)})")
    assert 100 * len(twice) <= MOST_PERCENT * number, "\n".join(twice)


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
