"""Konclude, a faster reference reasoner, where its program is installed.

Its answer is OWL/XML; question and answer are files in a temporary folder that is always removed.
"""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path
from typing import Final

from cfgplan.matching.faults import InconsistentOntologyError, ReasonerError, ReasonerTimeoutError
from cfgplan.matching.taxonomy import Taxonomy, read_taxonomy_xml

_PROGRAMS: Final = ("Konclude", "konclude")
_ERROR: Final = re.compile(r"\{error\}[^>]*>>\s*(.*)")


_TRIAL: Final = """Ontology(<t:trial>
Declaration(Class(<t:0>)) Declaration(Class(<t:1>)) Declaration(Class(<t:2>)) Declaration(ObjectProperty(<t:r>))
SubClassOf(<t:0> ObjectSomeValuesFrom(<t:r> <t:1>))
EquivalentClasses(<t:2> ObjectSomeValuesFrom(<t:r> <t:1>)))
"""
TRIAL_S: Final = 2.0
"""How long Konclude may take over a trial of two axioms, seconds; it takes 0.05 where it works."""


@cache
def is_usable() -> bool:
    """Whether Konclude is on PATH and answers a trial rightly: on some machines its program starts and then hangs."""
    if _program() is None:
        return False
    try:
        answer = classify(_TRIAL, time_limit_s=TRIAL_S)
    except ReasonerError:
        return False
    return answer.subsumes("t:2", "t:0") and not answer.subsumes("t:0", "t:2")


def classify(document: str, *, time_limit_s: float | None = None) -> Taxonomy:
    """The classes of an ontology in functional syntax (ASCII), by what they are subclasses of.

    Raises InconsistentOntologyError, ReasonerTimeoutError, or ReasonerError when Konclude is missing or fails.
    """
    import subprocess
    import tempfile
    from xml.etree import ElementTree

    program = _program()
    if program is None:
        raise ReasonerError("Konclude is not installed", "install it and put it on PATH, or choose another reasoner")
    with tempfile.TemporaryDirectory(prefix="cfgplan-konclude-") as folder:
        question, answer = Path(folder, "ontology.ofn"), Path(folder, "taxonomy.xml")
        question.write_text(document, encoding="ascii")
        command = [program, "classification", "-w", "AUTO", "-i", str(question), "-o", str(answer)]
        try:
            done = subprocess.run(
                command, capture_output=True, timeout=time_limit_s, stdin=subprocess.DEVNULL, check=False
            )
        except subprocess.TimeoutExpired:
            raise ReasonerTimeoutError(
                f"Konclude did not answer in {time_limit_s:g} s", "give it more time or simplify the ontology"
            ) from None
        except OSError as error:
            raise ReasonerError(f"Konclude can't be started: {error.strerror}") from None
        said = (done.stdout + done.stderr).decode(errors="replace")
        if "inconsistent" in said:
            raise InconsistentOntologyError(
                "the ontology contradicts itself, so that everything would match",
                "remove one of the axioms that clash",
            )
        if answer.is_file():
            try:
                return read_taxonomy_xml(answer.read_text())
            except ElementTree.ParseError:
                raise ReasonerError("Konclude's answer can't be read") from None
    found = _ERROR.search(said)
    raise ReasonerError(f"Konclude refused the ontology: {found[1] if found else f'exit code {done.returncode}'}")


def _program() -> str | None:
    from shutil import which

    return next(filter(None, map(which, _PROGRAMS)), None)
