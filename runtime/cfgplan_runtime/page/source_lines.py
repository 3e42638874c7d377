"""The source lines of faults in environment files and of errors in unit code, as the terminal draws them."""

from __future__ import annotations

import re
from pathlib import Path

from cfgplan.errors import Fault
from cfgplan.excerpts import drawn, excerpt
from cfgplan_runtime.operating.protocol import Record

_FRAME = re.compile(r'^  File "([^"]+\.py)", line (\d+)', re.MULTILINE)
"""Only Python code is shown: the text is the unit's, which may name any file."""
_PACKAGE = str(Path(__file__).parents[1])
_MOST_CHARACTERS = 500


def fault_record(fault: Record) -> Record:
    """A fault of the environment file as `message`, `place`, `mend` and `lines`, those that show the source."""
    known = Fault(fault["message"], fault["file"], fault["line"], fault["column"])
    return {"message": fault["message"], "place": known.place, "mend": fault["mend"], "lines": _lines(known)}


def error_record(text: str) -> Record:
    """The last error of a unit as `message`, and `place` and `lines` of the last line of unit code that it names."""
    message = text.rstrip().rpartition("\n")[2][:_MOST_CHARACTERS]
    frames = [(file, int(line)) for file, line in _FRAME.findall(text) if not file.startswith((_PACKAGE, "<"))]
    if not frames:
        return {"message": message, "place": "", "mend": None, "lines": []}
    known = Fault(message, *frames[-1])
    return {"message": message, "place": known.place, "mend": None, "lines": _lines(known)}


def _lines(fault: Fault) -> list[str]:
    found = excerpt(fault, ())
    if found is None:
        return []
    line, space, carets = drawn(found)
    return [line, space + carets]
