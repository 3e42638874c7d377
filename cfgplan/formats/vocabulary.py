"""What reading an environment needs to know of an ontology: the seam to the matching room."""

from __future__ import annotations

from typing import Protocol

from cfgplan.errors import CfgplanError


class BadClassError(CfgplanError):
    """A class that a template can't range over: it is unknown or has no individuals."""

    def __init__(self, message: str, mend: str | None = None) -> None:
        super().__init__(message)
        self.message = message
        self.mend = mend


class BadTagError(CfgplanError):
    """A tag that does not parse or has an unknown name; `column` counts from 1 inside the tag."""

    def __init__(self, message: str, column: int = 1, mend: str | None = None) -> None:
        super().__init__(message)
        self.message = message
        self.column = column
        self.mend = mend


class Vocabulary(Protocol):
    """An ontology as the formats see it."""

    def instances(self, class_name: str) -> tuple[str, ...]:
        """The names of the individuals of a class, asserted or inferred; raises BadClassError."""

    def check_tag(self, text: str) -> None:
        """Return if `text` is a tag over known names; raises BadTagError."""
