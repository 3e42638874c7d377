"""An archive of the classes that HermiT's Java reads, in the cache folder: a question takes about half the CPU time.

Each question starts a Java, which reads some 3,900 classes. Reading them from an archive (Java's class data sharing)
takes 0.27 s of CPU in place of 0.53. Java checks an archive and starts without it if it is damaged, or was made for
another Java or jar. Without a cache folder, or with a Java older than 13, questions are asked without an archive.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from cfgplan.cache_folder import cache_folder

PAYS_AFTER: Final = 8
"""The number of questions after which the archive is made: making it takes as much CPU time as it saves in these."""
MOST_ARCHIVES: Final = 3
"""The number of archives that are kept, each of 20 MB; the one that was not used for longest is dropped first."""
NO_HURRY_S: Final = 30.0
"""The least time limit of a question after which an archive may be made."""
_MAKING_S: Final = 60.0
"""The most seconds for Java to make one part of the archive."""
_ABANDONED_S: Final = 600.0
"""Seconds after which an unfinished archive counts as abandoned by the process that made it."""
_ARCHIVE_VERSION: Final = "1"
_JAVA_ARCHIVE: Final = "java.jsa"
_OWN: Final = "hermit.jsa"
_QUESTION: Final = """Ontology(<t:o> Declaration(Class(<t:A>)) Declaration(Class(<t:B>)) Declaration(Class(<t:C>))
Declaration(ObjectProperty(<t:r>)) Declaration(NamedIndividual(<t:i>)) ClassAssertion(<t:A> <t:i>)
SubClassOf(<t:A> ObjectSomeValuesFrom(<t:r> <t:B>)) SubClassOf(<t:B> ObjectUnionOf(<t:C> ObjectComplementOf(<t:A>))))
"""


@dataclass(frozen=True)
class ClassArchive:
    """The class archive of one Java with its options and a jar; `folder` exists as soon as it is being made."""

    folder: Path
    java: str
    options: tuple[str, ...]
    jar: Path
    main: str

    @property
    def _exists(self) -> bool:
        return (self.folder / _OWN).exists()

    def use(self) -> Sequence[str]:
        """Note a use of the archive. Returns the options that let Java use it; empty while it does not exist."""
        if not self._exists:
            return ()
        base, own = self.folder / _JAVA_ARCHIVE, self.folder / _OWN
        with suppress(OSError):
            os.utime(self.folder)
        return (
            # Java says nothing of an archive that it can't use.
            *("-Xlog:disable", "-Xlog:all=off", "-XX:+IgnoreUnrecognizedVMOptions", "-XX:+VerifySharedSpaces"),
            f"-XX:SharedArchiveFile={base}{os.pathsep}{own}",
        )

    def count(self, time_limit_s: float | None) -> None:
        """Count a question that was asked without an archive, and make the archive once it pays.

        If it can't be made, it is tried again after twice as many questions. Questions in a hurry don't count.
        """
        if time_limit_s is not None and time_limit_s < NO_HURRY_S:
            return
        with suppress(OSError):
            self.folder.parent.mkdir(parents=True, exist_ok=True)
            asked = _appended(self.folder.with_suffix(".asked"))
            if asked >= PAYS_AFTER and asked & (asked - 1) == 0:
                self.make()

    def make(self) -> None:
        """Make the archive, whole or not at all, unless another process does. Raises OSError."""
        from subprocess import TimeoutExpired

        with suppress(FileNotFoundError):
            if time.time() - self.folder.stat().st_mtime > _ABANDONED_S and not self._exists:
                shutil.rmtree(self.folder)
        self.folder.mkdir()
        base, own, question = (self.folder / name for name in (_JAVA_ARCHIVE, f"{_OWN}.part", "question.ofn"))
        try:
            question.write_text(_QUESTION, encoding="ascii")
            asked = (self.main, "--consistency=t:A", question.as_uri())
            self._run("-Xshare:dump", f"-XX:SharedArchiveFile={base}")
            # The second part knows the place of the first, which stays.
            self._run(f"-XX:SharedArchiveFile={base}", f"-XX:ArchiveClassesAtExit={own}", "-cp", self.jar, *asked)
            own.rename(self.folder / _OWN)
        except TimeoutExpired:
            pass
        finally:
            if not self._exists:
                shutil.rmtree(self.folder, ignore_errors=True)
        for folder in sorted(self.folder.parent.glob("*/"), key=lambda path: path.stat().st_mtime)[:-MOST_ARCHIVES]:
            folder.with_suffix(".asked").unlink(missing_ok=True)
            shutil.rmtree(folder, ignore_errors=True)

    def _run(self, *arguments: str | Path) -> None:
        import subprocess

        silent = {"stdin": subprocess.DEVNULL, "stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        command = [self.java, *self.options, *map(str, arguments)]
        subprocess.run(command, **silent, timeout=_MAKING_S, check=False)  # type: ignore[call-overload]


def archive_for(java: str, options: tuple[str, ...], jar: Path, main: str) -> ClassArchive | None:
    """The archive of a Java and a jar, made or not; None without a cache folder or if the Java is not found."""
    found, cache = shutil.which(java), cache_folder()
    if found is None or cache is None:
        return None
    try:
        command = Path(found).resolve()
        marks = [f"{path} {path.stat().st_size} {path.stat().st_mtime_ns}" for path in (command, jar)]
    except OSError:
        return None
    text = "\n".join((_ARCHIVE_VERSION, *marks, *options))
    return ClassArchive(cache / "hermit" / hashlib.sha256(text.encode()).hexdigest()[:16], java, options, jar, main)


def _appended(path: Path) -> int:
    """Append a byte to a file. Returns its size then, a different one in each process that does so."""
    descriptor = os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o644)
    try:
        os.write(descriptor, b".")
        return os.lseek(descriptor, 0, os.SEEK_CUR)
    finally:
        os.close(descriptor)
