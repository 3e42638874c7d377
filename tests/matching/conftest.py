"""Random worlds come from the experiments, so that the small and the large cross-check draw from the same."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from cfgplan.matching import Ontology

sys.path.insert(0, str(Path(__file__).parents[2] / "experiments" / "matching"))


@pytest.fixture
def streams() -> Ontology:
    """Images with sources, and two cameras."""
    return Ontology(
        [
            "SubClassOf(<w#Undistorted> <w#Image>)",
            "SubClassOf(<w#RawRGB> <w#Image>)",
            "DisjointClasses(<w#Image> <w#Device>)",
            "SubClassOf(<w#Camera> <w#Device>)",
            "ClassAssertion(<w#Camera> <w#cam1>)",
            "ClassAssertion(<w#Device> <w#laser1>)",
            "Declaration(ObjectProperty(<w#hasSource>))",
        ],
        {"": "w#", "w": "w#"},
    )
