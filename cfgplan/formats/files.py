"""Files to plain data: every cause that keeps a file from being read is one clear fault."""

from __future__ import annotations

from pathlib import Path

from cfgplan.errors import Fault, InputError, close_file
from cfgplan.file_content import NoWriterError, content_of
from cfgplan.formats.json_text import read_json
from cfgplan.formats.places import Source
from cfgplan.formats.yaml_text import read_yaml

SUFFIXES = (".yaml", ".yml", ".json", ".xml")
"""The endings of environment files."""
LARGEST_FILE_BYTES = 128 * 2**20
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
        before = content[: error.start].rpartition(b"\n")[2].decode(errors="replace")
        line, column = content.count(b"\n", 0, error.start) + 1, len(before.removeprefix("\ufeff")) + 1
        is_utf_16 = content.startswith((b"\xff\xfe", b"\xfe\xff"))
        told = "the file is in UTF-16" if is_utf_16 else f"byte {content[error.start]:#04x} is not UTF-8"
        raise InputError([Fault(told, str(path), line, column, mend="save the file in the encoding UTF-8")]) from None


def read_bytes(path: Path) -> bytes:
    """The content of a file that is not too large; raises InputError."""
    name = str(path)
    try:
        content = content_of(path, LARGEST_FILE_BYTES + 1)
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or error
        message, mend = _UNREADABLE.get(type(error), (f"the file can't be read: {why}", "check the path"))
        mend = "name /dev/stdin for standard input" if name == "-" else mend
        mend = "start that program too, or name a file" if isinstance(error, NoWriterError) else mend
        if isinstance(error, FileNotFoundError) and (close := close_file(path, SUFFIXES)) is not None:
            mend = f"did you mean `{close}`?"
        elif isinstance(error, FileNotFoundError) and not is_folder(path.parent):
            mend = f"check the path: there is no folder `{path.parent}`"
        raise InputError.of(message, file=name, mend=mend) from None
    if len(content) > LARGEST_FILE_BYTES:
        raise InputError.of(
            f"the file is larger than {LARGEST_FILE_BYTES // 2**20} MiB", file=name, mend="split it by `include:`"
        )
    return content


def is_folder(path: Path) -> bool:
    """Whether a path names a folder; a path that can't exist names none."""
    try:
        return path.is_dir()
    except OSError:
        return False
