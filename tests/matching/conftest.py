"""Random worlds come from the experiments, so that the small and the large cross-check draw from the same."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

from cfgplan.matching import Ontology, hermit, ontology_files
from cfgplan.matching.ontology_document import OntologyDocument, keep_document, kept_document

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


_Question = tuple[str, tuple[str, ...]]


@pytest.fixture(scope="session")
def known_answers() -> dict[_Question, dict[str, bool]]:
    """The complete answers to questions without a time limit, by document and classes."""
    return {}


@pytest.fixture(autouse=True)
def asked_once(known_answers: dict[_Question, dict[str, bool]], monkeypatch: pytest.MonkeyPatch) -> None:
    """HermiT is asked the same question once for all tests of the room, since each question starts a Java."""
    ask = hermit.satisfiable

    def satisfiable(
        document: str, classes: Sequence[str], *, time_limit_s: float | None = None, patience_s: float | None = None
    ) -> dict[str, bool]:
        question = document, tuple(classes)
        if time_limit_s is None and question in known_answers:
            return known_answers[question]
        told = ask(document, classes, time_limit_s=time_limit_s, patience_s=patience_s)
        if time_limit_s is None and len(told) == len(classes):
            known_answers[question] = told
        return told

    monkeypatch.setattr(hermit, "satisfiable", satisfiable)


@pytest.fixture(autouse=True)
def kept_once(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each ontology file that a test of the room reads is kept and taken from there, and must be the same."""
    read, folder = ontology_files._document_of, tmp_path_factory.mktemp("kept")

    def document_of(content: bytes, path: Path, shown: str) -> OntologyDocument:
        document = keep_document(folder, "key", read(content, path, shown))
        again = kept_document(folder, "key")
        assert again == document
        return document

    monkeypatch.setattr(ontology_files, "_document_of", document_of)
