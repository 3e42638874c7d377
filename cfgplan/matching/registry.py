"""The tags that are registered: how they are written, what they mean, and how often each was added."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping

from cfgplan.errors import Fault
from cfgplan.matching.concepts import Concept
from cfgplan.matching.faults import TagError
from cfgplan.matching.ontology import Ontology
from cfgplan.matching.syntax import parse_tag


class TagRegistry:
    """Texts of tags by meaning. Of the texts that mean the same, one is the *name* of that meaning."""

    def __init__(self) -> None:
        self._counts: Counter[str] = Counter()
        self._names: dict[str, Concept] = {}
        self._name_of: dict[Concept, str] = {}
        self._texts: dict[str, list[str]] = {}
        self._concepts: dict[str, Concept] = {}

    def __contains__(self, concept: object) -> bool:
        return concept in self._name_of

    @property
    def names(self) -> Mapping[str, Concept]:
        """The distinct meanings by name."""
        return self._names

    def concept(self, text: str) -> Concept:
        """The meaning of a registered text. Raises KeyError for any other."""
        return self._concepts[text]

    def name_of(self, concept: Concept) -> str:
        """The name of a meaning."""
        return self._name_of[concept]

    def texts(self, name: str) -> list[str]:
        """All texts that mean the same as a name, itself among them."""
        return self._texts.get(name) or [name]

    def spelled(self, names: frozenset[str]) -> frozenset[str]:
        """All texts that mean the same as one of some names."""
        written_twice = self._texts.keys() & names if self._texts else ()
        if not written_twice:
            return names
        return names.union(*(self._texts[name] for name in written_twice))

    def read(self, texts: Iterable[str], ontology: Ontology, faults: list[Fault]) -> list[tuple[str, Concept]]:
        """Texts with their meaning; `faults` gets those that can't be read."""
        read: list[tuple[str, Concept]] = []
        for text in texts:
            try:
                read.append((text, self._concepts.get(text) or parse_tag(text, ontology)))
            except TagError as error:
                faults.append(_fault(text, error))
        return read

    def reread(self, ontology: Ontology, faults: list[Fault]) -> TagRegistry:
        """The same tags as they read in another ontology; `faults` gets those that can't be read in it."""
        again = TagRegistry()
        again._counts = Counter(self._counts)
        for text in self._counts:
            try:
                again._enter(text, parse_tag(text, ontology))
            except TagError as error:
                faults.append(_fault(text, error))
        return again

    def add(self, read: Iterable[tuple[str, Concept]]) -> dict[str, Concept]:
        """Register texts. Returns the new meanings by name."""
        fresh: dict[str, Concept] = {}
        for text, concept in read:
            self._counts[text] += 1
            if text in self._concepts:
                continue
            if self._enter(text, concept):
                fresh[text] = concept
        return fresh

    def _enter(self, text: str, concept: Concept) -> bool:
        """Note what a text means. Returns whether the meaning is new."""
        self._concepts[text] = concept
        name = self._name_of.get(concept)
        if name is not None:
            self._texts.setdefault(name, [name]).append(text)
            return False
        self._name_of[concept] = text
        self._names[text] = concept
        return True

    def remove(self, texts: Iterable[str]) -> tuple[dict[str, Concept], dict[str, Concept]]:
        """Take texts back. Returns the names that are gone, and those that replace some of them, with their meanings.

        Raises KeyError for a text that is not registered; nothing is taken back then.
        """
        taken = Counter(texts)
        for text, times in taken.items():
            if self._counts[text] < times:
                raise KeyError(text)
        before = self._names.keys() & taken.keys()
        gone: dict[str, Concept] = {}
        for text, times in taken.items():
            self._counts[text] -= times
            if not self._counts[text]:
                del self._counts[text]
                self._drop(text, gone)
        stand_ins = {self._name_of[c]: c for c in gone.values() if c in self._name_of}
        return {name: concept for name, concept in gone.items() if name in before}, stand_ins

    def _drop(self, text: str, gone: dict[str, Concept]) -> None:
        concept = self._concepts.pop(text)
        name = self._name_of[concept]
        others = [other for other in self.texts(name) if other != text]
        if text == name:
            del self._names[name], self._name_of[concept]
            self._texts.pop(name, None)
            gone[name] = concept
            if others:
                self._name_of[concept] = others[0]
                self._names[others[0]] = concept
        if others:
            self._texts[others[0]] = others
            if len(others) == 1:
                del self._texts[others[0]]


def _fault(text: str, error: TagError) -> Fault:
    return Fault(f"tag {text!r}, column {error.column}: {error.message}", mend=error.mend)
