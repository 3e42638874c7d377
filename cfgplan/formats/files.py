"""Files to plain data: every cause that keeps a file from being read is one clear fault."""

from __future__ import annotations

from itertools import islice
from pathlib import Path

from cfgplan.errors import Fault, InputError, close_names
from cfgplan.formats.json_text import read_json
from cfgplan.formats.places import Source
from cfgplan.formats.yaml_text import read_yaml

LARGEST_FILE_BYTES = 128 * 2**20
_MOST_BESIDE = 500
_UNREADABLE: dict[type[Exception], tuple[str, str]] = {
    FileNotFoundError: ("there is no such file", "check the path"),
    IsADirectoryError: ("this is a folder, not a file", "name the file in it"),
    PermissionError: ("the file may not be read", "make it readable for you, such as by `chmod u+r`"),
}
"""The message and the mend for each kind of error."""


def read_source(path: Path) -> Source:
    """The plain data of a YAML, JSON or XML file; raises InputError."""
    if path.suffix == ".xml":
        from cfgplan.formats.xml_text import read_xml

        return read_xml(read_bytes(path), str(path))
    text = read_text(path)
    if path.suffix == ".json":
        return read_json(text, str(path))
    return read_yaml(text, str(path))


def read_text(path: Path) -> str:
    """The text of a UTF-8 file; raises InputError."""
    content = read_bytes(path)
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        message = f"byte {content[error.start]:#04x} is not UTF-8"
        raise InputError([Fault(message, str(path), line, mend="save the file in the encoding UTF-8")]) from None


def read_bytes(path: Path) -> bytes:
    """The content of a file that is not too large; raises InputError."""
    name = str(path)
    try:
        with path.open("rb") as stream:
            content = stream.read(LARGEST_FILE_BYTES + 1)
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or error
        message, mend = _UNREADABLE.get(type(error), (f"the file can't be read: {why}", "check the path"))
        mend = "name /dev/stdin for standard input" if name == "-" else mend
        if isinstance(error, FileNotFoundError):
            close = close_names(path.stem, _stems_beside(path))
            mend = f"did you mean `{path.with_name(close[0] + path.suffix)}`?" if close else mend
        raise InputError.of(message, file=name, mend=mend) from None
    if len(content) > LARGEST_FILE_BYTES:
        raise InputError.of(
            f"the file is larger than {LARGEST_FILE_BYTES // 2**20} MiB", file=name, mend="split it by `include:`"
        )
    return content


def _stems_beside(path: Path) -> list[str]:
    """The names, without their ending, of files beside a path that end as it does; the first few hundred."""
    try:
        return sorted(islice((each.stem for each in path.parent.iterdir() if each.suffix == path.suffix), _MOST_BESIDE))
    except OSError:
        return []


def is_folder(path: Path) -> bool:
    """Whether a path names a folder; a path that can't exist names none."""
    try:
        return path.is_dir()
    except OSError:
        return False
