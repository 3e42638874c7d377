"""A small ontology that an import writes beside an environment file: concepts below a few roots, and their names."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from typing import Final
from unicodedata import normalize

from cfgplan.selectors import KEYWORDS
from cfgplan.turtle import class_line, heading

_NO_CONCEPTS: Final = KEYWORDS | {"thing", "nothing"}
_NAME: Final = re.compile(r"[A-Za-z][\w-]*", re.ASCII)


class SmallOntology:
    """An ontology of concepts below given roots, with roles between them; a concept is made at its first use.

    `names` is the IRI, ending in #, that begins those of the concepts without one of their own. `known` are the IRIs of
    the others, whose names in tags are their last parts, unless another concept has that name.
    """

    def __init__(self, names: str, roots: Mapping[str, str], roles: Iterable[str], known: Iterable[str] = ()) -> None:
        self._names, self._roots, self._roles = names, roots, tuple(roles)
        self._endings = Counter(map(_ending, set(known)))
        self._words: dict[tuple[str, ...], str] = {}
        self._own = {*roots, *self._roles}
        self._taken = {*self._own, *self._endings}
        self._lines: dict[str, list[tuple[str, str]]] = {root: [] for root in roots}
        """By root: the name of each concept, and its line."""

    def concept(self, key: tuple[str, ...], word: str, above: str, label: str) -> str:
        """Return the name of the concept of `key`, whose first item is its root.

        A new concept is named `word`, changed if that is taken or no concept's name; it is a subclass of `above`.
        """
        if key in self._words:
            return self._words[key]
        if word.casefold() in _NO_CONCEPTS or not word[:1].isalpha():
            word = f"{key[0].casefold()}-{word or '_'}"
        while word in self._taken:
            word += "_"
        self._taken.add(word)
        self._words[key] = word
        self._lines[key[0]].append((word, class_line(word, above, label)))
        return word

    def known_concept(self, root: str, iri: str, label: str) -> str:
        """Return the name by which tags refer to a known concept, and declare the concept below this root."""
        if (root, iri) not in self._words:
            self._words[root, iri] = word = _ending(iri)
            self._lines[root].append((word, class_line(word, root, label, iri)))
        ending = self._words[root, iri]
        is_clear = self._endings[ending] == 1 and ending not in self._own and _is_name(ending)
        return ending if is_clear else f"<{iri}>"

    @property
    def text(self) -> str:
        """The ontology in Turtle."""
        return "\n".join([*self._turtle(), ""])

    def _turtle(self) -> Iterator[str]:
        yield from heading(self._names)
        yield from (f":{role} a owl:ObjectProperty ." for role in self._roles)
        for root, about in self._roots.items():
            yield ""
            yield f"# {about}"
            yield f":{root} a owl:Class ."
            yield from (line for _, line in sorted(self._lines[root]))


def _ending(iri: str) -> str:
    return re.split("[#/]", iri)[-1]


def _is_name(text: str) -> bool:
    """Whether a concept can have a text as its name."""
    return _NAME.fullmatch(text) is not None and text.casefold() not in _NO_CONCEPTS


def plain_word(text: str) -> str:
    """A text in letters, digits and underscores without accents."""
    return re.sub(r"[^A-Za-z0-9_]", "_", "".join(c for c in normalize("NFKD", text) if not "̀" <= c <= "ͯ"))
