"""The errors of reasoners."""

from __future__ import annotations

from cfgplan.errors import MatchingError as MatchingError
from cfgplan.errors import TagError as TagError
from cfgplan.errors import UnknownNameError as UnknownNameError


class ReasonerError(MatchingError):
    """A reasoner that could not be run, or that refused the ontology."""


class InconsistentOntologyError(ReasonerError):
    """The ontology contradicts itself, so that everything would follow from it."""


class ReasonerTimeoutError(ReasonerError):
    """A reasoner that did not answer in the time it was given."""
