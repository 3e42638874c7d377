"""Tags checked against the vocabulary, each distinct one once."""

from __future__ import annotations

from collections.abc import Mapping

from cfgplan.errors import Fault
from cfgplan.formats.places import Path, Source
from cfgplan.formats.templates import Variable, original_column
from cfgplan.formats.vocabulary import BadTagError, Vocabulary


class TagChecker:
    """Checks the tags of one document; what is wrong goes into `faults`."""

    def __init__(self, vocabulary: Vocabulary, faults: list[Fault]) -> None:
        self._vocabulary = vocabulary
        self._faults = faults
        self._good: set[str] = set()
        self._reported: set[tuple[str, Path]] = set()

    def check(
        self,
        tag: str,
        source: Source,
        path: Path,
        template: str | None = None,
        values: Mapping[Variable, str] | None = None,
    ) -> None:
        """Note what is wrong with a tag, which may be a template's expansion; once for each place."""
        if tag in self._good or (source.file, path) in self._reported:
            return
        try:
            self._vocabulary.check_tag(tag)
        except BadTagError as error:
            self._reported.add((source.file, path))
            column = original_column(template, values, error.column) if template and values else error.column
            message = f"{error.message}, in the expansion {tag!r}" if values else error.message
            self._faults.append(source.fault(path, message, error.mend, text_column=column))
        else:
            self._good.add(tag)
