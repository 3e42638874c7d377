"""The tags that are registered: how they are written, what they mean, and how often each was added."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping

from cfgplan.errors import Fault, TagError
from cfgplan.matching.concepts import Concept
from cfgplan.matching.ontology import Ontology
from cfgplan.matching.syntax import parse_tag


class TagRegistry:
    """Texts of tags by what they mean, and how often each was added."""

    def __init__(self) -> None:
        self._counts: Counter[str] = Counter()
        self._concepts: dict[str, Concept] = {}
        self._texts: dict[Concept, dict[str, None]] = {}

    @property
    def concepts(self) -> Mapping[str, Concept]:
        """What each text means."""
        return self._concepts

    @property
    def texts(self) -> Mapping[Concept, Iterable[str]]:
        """The texts that mean each concept, in the order in which they were added."""
        return self._texts

    def spelled(self, concepts: Iterable[Concept]) -> frozenset[str]:
        """All texts that mean one of some registered concepts."""
        return frozenset(text for concept in concepts for text in self._texts[concept])

    def read(self, texts: Iterable[str], ontology: Ontology, faults: list[Fault]) -> list[tuple[str, Concept]]:
        """Texts with their meaning; `faults` gets those that can't be read."""
        read: list[tuple[str, Concept]] = []
        for text in texts:
            try:
                read.append((text, self._concepts.get(text) or parse_tag(text, ontology)))
            except TagError as error:
                faults.append(Fault(f"tag {text!r}, column {error.column}: {error.message}", mend=error.mend))
        return read

    def reread(self, ontology: Ontology, faults: list[Fault]) -> TagRegistry:
        """The same tags as they read in another ontology; `faults` gets those that can't be read in it."""
        again = TagRegistry()
        again.add(again.read(self._counts, ontology, faults))
        again._counts = self._counts.copy()
        return again

    def add(self, read: Iterable[tuple[str, Concept]]) -> None:
        """Register texts."""
        for text, concept in read:
            self._counts[text] += 1
            self._concepts[text] = concept
            self._texts.setdefault(concept, {})[text] = None

    def remove(self, texts: Iterable[str]) -> None:
        """Take texts back. Raises KeyError for a text that is not registered; nothing is taken back then."""
        taken = Counter(texts)
        for text, times in taken.items():
            if self._counts[text] < times:
                raise KeyError(text)
        self._counts -= taken
        for text in taken.keys() - self._counts.keys():
            concept = self._concepts.pop(text)
            del self._texts[concept][text]
            if not self._texts[concept]:
                del self._texts[concept]
