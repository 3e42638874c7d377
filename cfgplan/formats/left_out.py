"""The names of parts that were left out because of faults: references to them are not reported as dangling."""

from __future__ import annotations

import re
from collections import defaultdict

from cfgplan.formats.document import Document
from cfgplan.formats.templates import pattern


class LeftOut:
    """The names that left-out parts may have had, by kind (`transformations`, `units`, `targets`)."""

    def __init__(self, document: Document) -> None:
        self._names: dict[str, set[str]] = defaultdict(set)
        self._patterns: dict[str, list[re.Pattern[str]]] = defaultdict(list)
        self._nameless: set[str] = set()
        for file in document.files:
            for kind, parts in file.broken.items():
                for part in parts:
                    self.add(kind, part.name)

    def add(self, kind: str, name: str | None) -> None:
        """Note a part that is left out. Its name may be a template; None if it is not known."""
        if name is None:
            self._nameless.add(kind)
        elif "$" in name:
            self._patterns[kind].append(pattern(name))
        else:
            self._names[kind].add(name)

    def any_of(self, kind: str) -> bool:
        """Whether a part of this kind was left out."""
        return kind in self._nameless or bool(self._names[kind] or self._patterns[kind])

    def may_have(self, kind: str, name: str) -> bool:
        """Whether a part of this name may have been left out."""
        if kind in self._nameless or name in self._names[kind]:
            return True
        return any(found.fullmatch(name) for found in self._patterns[kind])
