"""Semantic matching: tags, ontologies, reasoners, and the relation ~ between tags (paper, section IV-B)."""

from __future__ import annotations

from cfgplan.matching.explaining import MatchExplanation, Nearest, explain_match, nearest_offers
from cfgplan.matching.faults import (
    InconsistentOntologyError,
    MatchingError,
    ReasonerError,
    ReasonerTimeoutError,
    TagError,
    UnknownNameError,
)
from cfgplan.matching.loading import load_ontology
from cfgplan.matching.matrix import match
from cfgplan.matching.ontology import Ontology
from cfgplan.matching.reasoners import REASONERS
from cfgplan.matching.session import Matcher, Matching
from cfgplan.matching.syntax import check_tag

__all__ = [
    "REASONERS",
    "InconsistentOntologyError",
    "MatchExplanation",
    "Matcher",
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
    "load_ontology",
    "match",
    "nearest_offers",
]
