"""The search of the manual: its sections, ranked by how well they match some words."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import log
from pathlib import Path

_HEADING = re.compile(r"(#{1,4}) (.+)")
_FENCE = "```"
_END_OF_SENTENCE = re.compile(r"(?<=[.;:?]) (?=[A-Z`*])")
_LETTERS = re.compile(r"[^\W_]+")
_SUFFIXES = ("ing", "ed", "es", "s", "e")
_SHORTEST_STEM = 3
_FRAME = frozenset({
    "a", "an", "and", "are", "can", "do", "does", "for", "how", "i", "if", "in", "is", "it", "my", "of", "on", "or",
    "the", "to", "what", "when", "why", "with",
})  # fmt: skip
"""Words of a question that say nothing of its subject."""
_IN_A_HEADING = 5
"""A word in a section's heading counts as often as this."""
_SATURATION, _LENGTH = 1.2, 0.75
"""The constants of BM25 (Robertson and Zaragoza, The Probabilistic Relevance Framework, 2009)."""


@dataclass(frozen=True)
class Section:
    """A heading of a page and the lines below it, up to the next heading; `under` are the headings above it."""

    page: str
    heading: str
    under: tuple[str, ...]
    lines: tuple[str, ...]

    @cached_property
    def counts(self) -> Counter[str]:
        """How often each stem occurs."""
        found = Counter(stems("\n".join(self.lines)))
        for stem in stems(self.heading):
            found[stem] += _IN_A_HEADING
        return found

    @cached_property
    def sentences(self) -> tuple[str, ...]:
        """The sentences of its text, rows of its tables and lines of its code."""
        texts = (line.strip() for line in self.lines if not line.startswith((_FENCE, "<!--", "|--")))
        return tuple(sentence for text in texts if text for sentence in _END_OF_SENTENCE.split(text))

    def best_sentence(self, words: Collection[str]) -> str:
        """Return the sentence that has most of the stems; the first one of several, empty if there is none."""
        return max(self.sentences, key=lambda sentence: _share(words, sentence), default="")


def _share(words: Collection[str], text: str) -> float:
    """Return the share of some stems that a text has."""
    return len(set(words).intersection(stems(text))) / len(words)


def stems(text: str) -> list[str]:
    """The words of a text in lower case, without the endings of plurals and verbs."""
    return [_stem(word) for word in _LETTERS.findall(text.lower())]


def _stem(word: str) -> str:
    for ending in _SUFFIXES:
        if word.endswith(ending) and len(word) - len(ending) >= _SHORTEST_STEM:
            return word.removesuffix(ending)
    return word


def sections(pages: Mapping[str, Path]) -> Iterator[Section]:
    """Yield the sections of the manual's pages, by name."""
    for name, path in pages.items():
        yield from _sections_of(name, path.read_text(encoding="utf-8"))


def _sections_of(page: str, text: str) -> Iterator[Section]:
    headings: list[str] = []
    lines: list[str] = []
    in_code = False
    for line in text.splitlines():
        in_code ^= line.startswith(_FENCE)
        heading = None if in_code else _HEADING.fullmatch(line)
        if heading is None:
            lines.append(line)
            continue
        if headings:
            yield Section(page, headings[-1], tuple(headings[:-1]), tuple(lines))
        headings = [*headings[: len(heading[1]) - 1], heading[2]]
        lines = []
    if headings:
        yield Section(page, headings[-1], tuple(headings[:-1]), tuple(lines))


def asked_stems(words: Sequence[str]) -> list[str]:
    """Return the stems of words, each once, without those of a question's frame, such as `what is`."""
    return list(dict.fromkeys(stem for stem in stems(" ".join(words)) if stem not in _FRAME))


def found(all_sections: Sequence[Section], asked: Sequence[str]) -> list[Section]:
    """Return the sections that have all stems, the best one first.

    The measure is BM25, four times as much where one sentence has all of them.
    """
    having = [section for section in all_sections if asked and all(section.counts[stem] for stem in asked)]
    number = len(all_sections)
    mean = sum(section.counts.total() for section in all_sections) / max(1, number)
    rarity = {stem: log(1 + number / (1 + sum(stem in each.counts for each in all_sections))) for stem in asked}

    def score(section: Section) -> float:
        length = 1 - _LENGTH + _LENGTH * section.counts.total() / mean
        times = {stem: section.counts[stem] for stem in asked}
        weights = (rarity[stem] * n * (_SATURATION + 1) / (n + _SATURATION * length) for stem, n in times.items())
        return sum(weights) * (1 + _share(asked, section.best_sentence(asked))) ** 2

    return sorted(having, key=score, reverse=True)


def unknown_words(all_sections: Sequence[Section], words: Sequence[str]) -> list[str]:
    """Return the words that no section has."""
    known = set().union(*(section.counts for section in all_sections))
    return [word for word in words if not known.issuperset(stems(word))]
