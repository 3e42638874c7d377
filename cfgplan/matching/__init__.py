"""Semantic matching: tags, ontologies, reasoners, and the relation ~ between tags (paper, section IV-B).

Names are imported from their modules when they are first used, so that importing the package costs nothing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from cfgplan.errors import MatchingError, TagError, UnknownNameError

if TYPE_CHECKING:
    from cfgplan.matching.explanation import MatchExplanation, Nearest, explain_match, nearest_offers
    from cfgplan.matching.faults import InconsistentOntologyError, ReasonerError, ReasonerTimeoutError
    from cfgplan.matching.matrix import Matches, check_tag, instances, match
    from cfgplan.matching.ontology import Ontology
    from cfgplan.matching.ontology_files import load_ontology, read_owlready
    from cfgplan.matching.reference import REASONERS
    from cfgplan.matching.session import Matcher, Matching

__all__ = [
    "REASONERS",
    "InconsistentOntologyError",
    "MatchExplanation",
    "Matcher",
    "Matches",
    "Matching",
    "MatchingError",
    "Nearest",
    "Ontology",
    "ReasonerError",
    "ReasonerTimeoutError",
    "TagError",
    "UnknownNameError",
    "check_tag",
    "explain_match",
    "instances",
    "load_ontology",
    "match",
    "nearest_offers",
    "read_owlready",
]

_MODULES = {
    "explanation": ("MatchExplanation", "Nearest", "explain_match", "nearest_offers"),
    "faults": ("InconsistentOntologyError", "ReasonerError", "ReasonerTimeoutError"),
    "ontology_files": ("load_ontology", "read_owlready"),
    "matrix": ("Matches", "check_tag", "instances", "match"),
    "ontology": ("Ontology",),
    "reference": ("REASONERS",),
    "session": ("Matcher", "Matching"),
}
_MODULE_OF = {name: module for module, names in _MODULES.items() for name in names}


def __getattr__(name: str) -> object:
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    value = globals()[name] = getattr(import_module(f"{__name__}.{_MODULE_OF[name]}"), name)
    return value
