"""The errors of semantic matching that are not about a file."""

from __future__ import annotations

from cfgplan.errors import CfgplanError


class MatchingError(CfgplanError):
    """Something that can't be matched or looked up: what is wrong, and what to do about it."""

    def __init__(self, message: str, mend: str | None = None) -> None:
        self.message = message
        self.mend = mend
        super().__init__(f"{message} ({mend})" if mend else message)


class TagError(MatchingError):
    """A tag that can't be read; `column` counts its characters from 1."""

    def __init__(self, message: str, column: int, mend: str | None = None) -> None:
        super().__init__(message, mend)
        self.column = column


class UnknownNameError(MatchingError):
    """A name that the ontology doesn't know, or knows as something else."""


class ReasonerError(MatchingError):
    """A reasoner that could not be run, or that refused the ontology."""


class InconsistentOntologyError(ReasonerError):
    """The ontology contradicts itself, so that everything would follow from it."""


class ReasonerTimeoutError(ReasonerError):
    """A reasoner that did not answer in the time it was given."""
