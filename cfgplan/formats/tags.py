"""Tags checked against a vocabulary, each distinct one once; the vocabulary is the seam to the matching room."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

from cfgplan.errors import TagError
from cfgplan.formats.places import Passage, Path
from cfgplan.formats.templates import Variable, original_column


class TagVocabulary(Protocol):
    """An ontology as the formats see it."""

    def instances(self, class_name: str) -> tuple[str, ...]:
        """The names of the individuals of a class, asserted or inferred; raises TagError and UnknownNameError."""

    def check_tag(self, text: str) -> None:
        """Return if `text` is a tag over known names; raises TagError."""


class TagChecker:
    """Checks the tags of one document, each distinct one once."""

    def __init__(self, vocabulary: TagVocabulary) -> None:
        self._vocabulary = vocabulary
        self._good: set[str] = set()
        self._reported: set[tuple[str, Path]] = set()

    def check(
        self, tag: str, entry: Passage, template: str | None = None, values: Mapping[Variable, str] | None = None
    ) -> None:
        """Note the fault of a tag, which may be a template's expansion, once for each place."""
        place = (entry.source.file, entry.path)
        if tag in self._good or place in self._reported:
            return
        try:
            self._vocabulary.check_tag(tag)
        except TagError as error:
            self._reported.add(place)
            column = original_column(template, values, error.column) if template and values else error.column
            message = f"{error.message}, in the expansion {tag!r}" if values else error.message
            entry.note(message, error.mend, text_column=column)
        else:
            self._good.add(tag)
