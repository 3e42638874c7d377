"""The file that keeps estimates between runs. Estimates do not fade between runs."""

from __future__ import annotations

import hashlib
import os
from contextlib import suppress
from pathlib import Path

import msgspec

from cfgplan.user_folders import user_folder
from cfgplan_runtime.errors import RuntimeFaultError
from cfgplan_runtime.estimating.estimator import LearningEstimator
from cfgplan_runtime.estimating.evidence import Evidence

_KIND = "cfgplan-estimates/"
ESTIMATES_FORMAT = f"{_KIND}1"


class EstimatesError(RuntimeFaultError):
    """Estimates could not be read or written; the run continues without them."""


class _Kept(msgspec.Struct):
    """The file's content. Times are in seconds relative to its writing, so at most 0."""

    format: str
    evidence: dict[str, Evidence]
    on_hosts: dict[str, dict[str, Evidence]] = {}


def default_file(environment_file: Path) -> Path:
    """The file for the estimates of an environment file, in `$XDG_STATE_HOME/cfgplan/estimates`.

    Without `$XDG_STATE_HOME` it is in `~/.local/state`. The name is that of the environment file with a hash of its
    full path.
    """
    folder = user_folder("XDG_STATE_HOME") or Path.home() / ".local" / "state"
    path = environment_file.resolve()
    digest = hashlib.sha256(os.fsencode(path)).hexdigest()[:12]
    return folder / "cfgplan" / "estimates" / f"{path.stem}-{digest}.json"


def has_other_content(path: Path) -> bool:
    """Return whether a file is JSON of another kind, such as one that the user has named by mistake.

    A damaged file is not: it may have been one of estimates.
    """
    try:
        content = msgspec.json.decode(path.read_bytes())
    except (OSError, msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        return False
    return not (isinstance(content, dict) and str(content.get("format")).startswith(_KIND))


def save(estimator: LearningEstimator, path: Path, now_s: float) -> None:
    """Write the estimates and flush them to the disk. The file is replaced as a whole or not at all. Raises
    EstimatesError.
    """
    on_hosts = {host: _moved(there, -now_s) for host, there in sorted(estimator.on_hosts.items())}
    kept = _Kept(ESTIMATES_FORMAT, _moved(estimator, -now_s), on_hosts)
    data = msgspec.json.format(msgspec.json.encode(kept), indent=1)
    _refuse_what_is_no_file(path)
    new = path.with_name(f".{path.name}.{os.getpid()}.new")
    try:
        path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        with new.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        new.replace(path)
        _sync_folder(path.parent)
    except OSError as error:
        with suppress(OSError):
            new.unlink(missing_ok=True)
        raise EstimatesError(f"{path}: the estimates can't be kept: {error.strerror}") from None


def load(estimator: LearningEstimator, path: Path, now_s: float) -> None:
    """Continue with the estimates of a file, if it exists.

    Raises EstimatesError if it can't be used. A damaged file is first renamed to `….damaged`, so that a new one can be
    saved.
    """
    _refuse_what_is_no_file(path)
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        return
    except OSError as error:
        raise EstimatesError(f"{path}: the estimates can't be read: {error.strerror}") from None
    try:
        kept = msgspec.json.decode(data, type=_Kept)
        if kept.format != ESTIMATES_FORMAT:
            raise msgspec.ValidationError(f"its format is {kept.format!r}, not {ESTIMATES_FORMAT!r}")
        parts = [kept.evidence, *kept.on_hosts.values()]
        wrong = [label for part in parts for label, evidence in part.items() if not evidence.is_in_order]
        if wrong:
            raise msgspec.ValidationError(f"the samples of {wrong[0]!r} are out of order")
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        aside = path.with_name(f"{path.name}.damaged")
        with suppress(OSError):
            path.replace(aside)
        raise EstimatesError(
            f"{path}: damaged ({error}); it was renamed to {aside.name}, and learning starts again"
        ) from None
    fresh = estimator.settings
    for part in parts:
        for evidence in part.values():
            evidence.labor.take_limits(fresh.labor())
            evidence.upkeep.take_limits(fresh.upkeep())
            evidence.failures.forget_s = fresh.forget_s
    estimator.take_over({label: evidence.moved(now_s) for label, evidence in kept.evidence.items()})
    for host, part in kept.on_hosts.items():
        estimator.at(host).take_over({label: evidence.moved(now_s) for label, evidence in part.items()})


def _moved(estimator: LearningEstimator, by: float) -> dict[str, Evidence]:
    """The evidence of all transformations, on a clock that is ahead by `by` seconds."""
    return {label: one.moved(by) for label, one in sorted(estimator.evidence.items()) if not one.is_empty}


def _refuse_what_is_no_file(path: Path) -> None:
    """Raise EstimatesError for a device, a pipe or a folder: reading could block, writing would replace it."""
    try:
        is_other = path.exists() and not path.is_file()
    except OSError:
        return  # reading or writing says what is wrong
    if is_other:
        raise EstimatesError(f"{path}: the estimates can't be kept here, since this is not a file")


def _sync_folder(folder: Path) -> None:
    """Flush the folder, so that the renaming survives a crash. Systems that can't flush a folder are ignored."""
    with suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
