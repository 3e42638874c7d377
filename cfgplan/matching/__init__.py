"""Semantic matching: tags, ontologies, reasoners, and the relation ~ between tags (paper, section IV-B).

Names are imported from their modules when they are first used, so that importing the package costs nothing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from cfgplan.errors import MatchingError as MatchingError
from cfgplan.errors import TagError as TagError
from cfgplan.errors import UnknownNameError as UnknownNameError
from cfgplan.exports import exports

if TYPE_CHECKING:
    from cfgplan.matching.answer import Matching as Matching
    from cfgplan.matching.explanation import MatchExplanation as MatchExplanation
    from cfgplan.matching.explanation import Nearest as Nearest
    from cfgplan.matching.explanation import explain_match as explain_match
    from cfgplan.matching.explanation import near_offers as near_offers
    from cfgplan.matching.faults import InconsistentOntologyError as InconsistentOntologyError
    from cfgplan.matching.faults import ReasonerError as ReasonerError
    from cfgplan.matching.faults import ReasonerTimeoutError as ReasonerTimeoutError
    from cfgplan.matching.matrix import Matches as Matches
    from cfgplan.matching.matrix import check_tag as check_tag
    from cfgplan.matching.matrix import instances as instances
    from cfgplan.matching.matrix import match as match
    from cfgplan.matching.ontology import Ontology as Ontology
    from cfgplan.matching.ontology_files import load_ontology as load_ontology
    from cfgplan.matching.ontology_files import read_owlready as read_owlready
    from cfgplan.matching.reference import REASONERS as REASONERS
    from cfgplan.matching.session import Matcher as Matcher
    from cfgplan.matching.suggestions import Suggestion as Suggestion

__all__, __getattr__, __dir__ = exports(
    __name__,
    {
        "answer": "Matching",
        "explanation": "MatchExplanation Nearest explain_match near_offers",
        "faults": "InconsistentOntologyError MatchingError ReasonerError ReasonerTimeoutError TagError "
        "UnknownNameError",
        "ontology_files": "load_ontology read_owlready",
        "matrix": "Matches check_tag instances match",
        "ontology": "Ontology",
        "reference": "REASONERS",
        "session": "Matcher",
        "suggestions": "Suggestion",
    },
)
