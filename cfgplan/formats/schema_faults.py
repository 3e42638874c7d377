"""The schema's complaints as faults: a place in the file, plain words, and a mend."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from decimal import Decimal
from typing import Any, get_args, get_origin

from pydantic import BaseModel

from cfgplan.errors import Fault, did_you_mean
from cfgplan.formats.fields import FORMAT, EnvironmentPart, IncludedPart
from cfgplan.formats.places import Path, Source
from cfgplan.formats.scalars import resolve
from cfgplan.formats.schema_values import FULL_FORM, PORT, SHORT_FORM

_KINDS_OF_VALUE = {
    "string_type": "text",
    "int_type": "a whole number",
    "bool_type": "true or false",
    "list_type": "a list",
    "dict_type": "a mapping of keys to values",
    "model_type": "a mapping of keys to values",
    "model_attributes_type": "a mapping of keys to values",
    "cost_type": "a number of CPU seconds",
    "number_type": "a number",
}


def schema_faults(source: Source, root: Path, errors: Sequence[Any], part: type[BaseModel]) -> Iterator[Fault]:
    """The faults of pydantic's errors for the value at `root` of a source."""
    nominals = {error["loc"][:-1] for error in errors if _is_nominal(error)}
    for error in errors:
        if error["loc"][:-1] in nominals and error["type"] == "extra_forbidden":
            continue
        path = root + tuple(step for step in error["loc"] if step not in (SHORT_FORM, FULL_FORM, "[key]"))
        at_key = error["loc"][-1:] == ("[key]",)
        yield _fault(source, path, at_key, error, part)


def _is_nominal(error: Any) -> bool:
    """Whether a port's tag is missing because the tag {a} was read as a mapping from a to nothing."""
    value = error["input"]
    return (
        error["type"] == "missing"
        and FULL_FORM in error["loc"]
        and bool(value)
        and all(inner is None for inner in value.values())
    )


def _fault(source: Source, path: Path, at_key: bool, error: Any, part: type[BaseModel]) -> Fault:
    kind, value = error["type"], error["input"]
    if kind == "extra_forbidden":
        return _unknown_key(source, path, part)
    if kind == "missing":
        if _is_nominal(error):
            mend = "write it in quotes: a text that begins with { is read as a mapping"
            return source.fault(path[:-1], "this must be a tag or a mapping with the key `tag`", mend)
        mend = f"add `format: {FORMAT}` here" if path == ("format",) else f"add `{path[-1]}:` here"
        return source.fault(path[:-1], f"the key `{path[-1]}` is missing", mend)
    if kind == "literal_error":
        wanted = str(error["ctx"]["expected"]).replace("'", "")
        if str(path[-1]).startswith("format"):
            return source.fault(path, f"`{path[-1]}` is {_shown(value)}", f"this cfgplan reads `{path[-1]}: {wanted}`")
        wanted += " or a mapping" if error["loc"][-1] == SHORT_FORM else ""
        return source.fault(path, f"this must be {wanted}, but is {_described(value)}", "write one of these")
    if kind == "model_type" and error["loc"][-1:] == (FULL_FORM,):
        short = "a tag" if path[-2] in ("inputs", "outputs") else "a number"
        message = f"this must be {short} or a mapping, but is {_described(value)}"
        return source.fault(path, message, f"write {short} here")
    if kind in _KINDS_OF_VALUE:
        return source.fault(path, *_wrong_kind(source, path, _KINDS_OF_VALUE[kind], value), at_key=at_key)
    if kind == "string_pattern_mismatch":
        barred = "slashes, line breaks or control characters" if error["ctx"]["pattern"] == PORT else "line breaks"
        message = f"{_shown(value)} is no name" if value else "the name is empty"
        return source.fault(path, message, f"a name has no {barred} and no spaces around it", at_key=at_key)
    if kind == "string_too_short":
        return source.fault(path, "the tag is empty", "write a concept, such as `Image`")
    if kind in ("too_short", "too_long"):
        bound = "at least {min_length}" if kind == "too_short" else "at most {max_length}"
        wanted = f"this must be a list of {bound} entries, but has {{actual_length}}"
        return source.fault(path, wanted.format_map(error["ctx"]))
    if kind in ("greater_than_equal", "less_than_equal"):
        limit = error["ctx"].get("ge", error["ctx"].get("le"))
        side = "at least" if kind == "greater_than_equal" else "at most"
        return source.fault(path, f"{_shown(value)} is out of range", f"write a whole number that is {side} {limit}")
    context = error.get("ctx", {})
    return source.fault(path, context.get("text", error["msg"]), context.get("mend"), at_key=at_key)


def _unknown_key(source: Source, path: Path, part: type[BaseModel]) -> Fault:
    known = sorted((_part_at(part, path[:-1]) or part).model_fields)
    name = str(path[-1])
    if part is IncludedPart and len(path) == 1 and name in EnvironmentPart.model_fields:
        mend: str | None = "an included file has only transformations and targets: move this key to the main file"
    else:
        mend = did_you_mean(name, known, f"the keys here are {', '.join(known)}")
    return source.fault(path, f"unknown key `{name}`", mend, at_key=True)


def _part_at(part: type[BaseModel], path: Path) -> type[BaseModel] | None:
    """The definition of the mapping at a path inside of `part`."""
    steps = iter(path)
    for step in steps:
        field = part.model_fields.get(str(step))
        inner = None if field is None else _part_in(field.annotation)
        if field is None or inner is None:
            return None
        part = inner
        if _holds_several(field.annotation):
            next(steps, None)
    return part


def _part_in(annotation: Any) -> type[BaseModel] | None:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return next((part for part in map(_part_in, get_args(annotation)) if part), None)


def _holds_several(annotation: Any) -> bool:
    return get_origin(annotation) in (list, dict) or any(map(_holds_several, get_args(annotation)))


def _wrong_kind(source: Source, path: Path, wanted: str, value: object) -> tuple[str, str]:
    message = f"this must be {wanted}, but is {_described(value)}"
    written = source.locate(path, False).text
    if wanted == "text" and written is not None and not isinstance(value, str):
        return message, f'write it in quotes: "{written}"' if written else "write a text, or remove the key"
    if wanted == "text" and isinstance(value, dict):
        return message, "write it in quotes: a text that begins with { is read as a mapping"
    if wanted == "text" and isinstance(value, list):
        return message, "write it in quotes: a text that begins with [ is read as a list"
    if isinstance(value, str) and wanted.startswith(("a number", "a whole")):
        example = "0.3" if wanted.startswith("a number") else "600"
        return message, f"write a plain number, such as {example}" + _if_quoted(value)
    if isinstance(value, str) and wanted == "true or false":
        return message, "write true or false" + _if_quoted(value)
    if wanted == "a list":
        return message, "begin each entry with `- `"
    if path[-1:] in (("inputs",), ("outputs",)) and isinstance(value, list):
        return message, "write each port as `name: tag`, such as {image: Image, pose: Pose}"
    return message, f"write {wanted} here"


def _if_quoted(value: str) -> str:
    return "" if isinstance(resolve(value), str) else ", without quotes"


def _described(value: object) -> str:
    if value is None:
        return "empty"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int | Decimal):
        return f"the number {_short(str(value))}"
    if isinstance(value, str):
        return f"the text {_shown(value)}"
    return "a mapping" if isinstance(value, dict) else "a list"


def _shown(value: object) -> str:
    return _short(repr(value)) if isinstance(value, str) else _described(value)


def _short(text: str) -> str:
    return text if len(text) <= 80 else f"{text[:77]}..."
