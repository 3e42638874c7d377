"""The schema's complaints as faults: a place in the file, plain words, and a mend."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from decimal import Decimal
from math import ceil
from typing import Any, Final, Literal, get_args, get_origin

from pydantic import BaseModel

from cfgplan.costs import guessed_s
from cfgplan.errors import Fault, close_names
from cfgplan.formats.fields import FORMAT, EnvironmentPart, IncludedPart, Part
from cfgplan.formats.measures import MEASURES
from cfgplan.formats.models import model_of
from cfgplan.formats.places import Path, Source
from cfgplan.formats.scalars import resolve
from cfgplan.formats.schema_values import FULL_FORM, PORT, SHORT_FORM
from cfgplan.rows import LARGEST_AMOUNT

_SYNONYMS: Mapping[str, tuple[str, ...]] = {
    **dict.fromkeys(("cost", "costs", "price"), ("upkeep", "labor", "max_cost")),
    **dict.fromkeys(("cpu", "load", "cpu_seconds"), ("upkeep",)),
    **dict.fromkeys(("startup", "start_cost", "setup"), ("labor",)),
    "name": ("label", "id"),
    "id": ("label", "name"),
    "label": ("id", "name", "labels"),
    "version": ("format",),
    **dict.fromkeys(("code", "class", "command", "file", "exec", "executable", "program", "script"), ("source",)),
    **dict.fromkeys(("parameters", "args", "arguments", "config"), ("params",)),
    **dict.fromkeys(("components", "nodes", "services", "library"), ("transformations",)),
    **dict.fromkeys(("goals", "wanted", "queries"), ("targets",)),
    **dict.fromkeys(("subscribes", "subscribe", "in", "takes"), ("inputs",)),
    **dict.fromkeys(("publishes", "publish", "out", "gives"), ("outputs",)),
    **dict.fromkeys(("owl", "ttl", "vocabulary"), ("ontology",)),
    **dict.fromkeys(("concept", "class", "wants"), ("tag",)),
    **dict.fromkeys(("machines", "computers", "robots"), ("hosts",)),
    **dict.fromkeys(("value", "default"), ("declared",)),
}
"""Words that people write instead of keys, and the keys that they may mean."""
_EACH_MEANS = {
    "upkeep": "CPU seconds of each second that it runs",
    "labor": "CPU seconds of one start",
    "max_cost": "the most that an update may cost",
}
_NAMED_BY_USERS = (("quality",), ("needs",), ("offers",), ("at_most",))
"""The mappings whose keys are names that the user chooses."""
_KINDS_OF_VALUE = {
    "string_type": "text",
    "int_type": "a whole number",
    "bool_type": "true or false",
    "list_type": "a list",
    "dict_type": "a mapping of keys to values",
    "model_type": "a mapping of keys to values",
    "model_attributes_type": "a mapping of keys to values",
    "cost_type": "a number of CPU seconds",
    "time_type": "a number of seconds",
    "number_type": "a number",
}


def schema_faults(
    source: Source, root: Path, errors: Sequence[Any], part: type[Part] | type[BaseModel]
) -> Iterator[Fault]:
    """The faults of pydantic's errors for the value at `root` of a source, which is no `part`."""
    part = model_of(part) if issubclass(part, Part) else part
    nominals = {error["loc"][:-1] for error in errors if _is_nominal(error)}
    meant = {(*error["loc"][:-1], key) for error in errors for key in _meant_keys(error, root, part)}
    for error in errors:
        if error["loc"][:-1] in nominals and error["type"] == "extra_forbidden":
            continue
        if error["type"] == "missing" and error["loc"] in meant:
            continue
        path = root + tuple(step for step in error["loc"] if step not in (SHORT_FORM, FULL_FORM, "[key]"))
        at_key = error["loc"][-1:] == ("[key]",)
        yield _fault(source, path, at_key, error, part)


def _meant_keys(error: Any, root: Path, part: type[BaseModel]) -> tuple[str, ...]:
    """The keys that an unknown key may stand for, the likeliest first; none for any other error."""
    if error["type"] != "extra_forbidden":
        return ()
    path = root + tuple(step for step in error["loc"] if step not in (SHORT_FORM, FULL_FORM))
    return _keys_like(str(path[-1]), [*_keys_at(part, path[:-1])])


def _keys_like(name: str, known: Collection[str]) -> tuple[str, ...]:
    """Return the known keys that an unknown one may stand for: its synonyms, or else those of similar spelling."""
    said = tuple(key for key in _SYNONYMS.get(name.casefold(), ()) if key in known)
    return said or tuple(close_names(name, known))


def _keys_at(part: type[BaseModel], path: Path) -> Mapping[str, Any]:
    return (_part_at(part, path) or part).model_fields


def _is_nominal(error: Any) -> bool:
    """Whether a port's tag is missing because the tag {a} was read as a mapping from a to nothing."""
    value = error["input"]
    return (
        error["type"] == "missing"
        and FULL_FORM in error["loc"]
        and bool(value)
        and all(inner is None for inner in value.values())
    )


_EMPTY_TAG: Final = ("the tag is empty", "write a concept, such as `Image`")
_EMPTY_SELECTOR: Final = ("the selector is empty", "write a label of hosts, or labels joined by `and`, `or` and `not`")
_EMPTY: Final = {
    "on": _EMPTY_SELECTOR,
    "between": _EMPTY_SELECTOR,
    "at_most": _EMPTY_SELECTOR,
    "requires": ("the requirement is empty", "write a fact, such as `night` or `visibility >= 2.25`, or remove it"),
}
"""Message and mend for an empty expression, by its key."""


def _fault(source: Source, path: Path, at_key: bool, error: Any, part: type[BaseModel]) -> Fault:
    kind, value = error["type"], error["input"]
    if kind == "extra_forbidden":
        return _unknown_key(source, path, value, part)
    if kind == "missing":
        if _is_nominal(error):
            mend = "write it in quotes: a text that begins with { is read as a mapping"
            return source.fault(path[:-1], "this must be a tag or a mapping with the key `tag`", mend)
        mend = f"add `format: {FORMAT}` here" if path == ("format",) else _added(path, part)
        return source.fault(path[:-1], f"the key `{path[-1]}` is missing", mend)
    if kind == "literal_error":
        wanted = str(error["ctx"]["expected"]).replace("'", "")
        if str(path[-1]).startswith("format"):
            return source.fault(path, f"`{path[-1]}` is {_shown(value)}", f"this cfgplan reads `{path[-1]}: {wanted}`")
        wanted += " or a mapping" if error["loc"][-1] == SHORT_FORM else ""
        return source.fault(path, f"this must be {wanted}, but is {_described(value)}", f"write {wanted}")
    if kind == "model_type" and error["loc"][-1:] == (FULL_FORM,):
        is_port = path[-2] in ("inputs", "outputs")
        short = "a tag" if is_port else "a number"
        message = f"this must be {short} or a mapping, but is {_described(value)}"
        return source.fault(path, message, f"write {short} here{', such as `Image`' if is_port else ', such as 0.3'}")
    if kind in _KINDS_OF_VALUE:
        return source.fault(path, *_wrong_kind(source, path, _KINDS_OF_VALUE[kind], value, part), at_key=at_key)
    if kind == "string_pattern_mismatch":
        barred = "slashes, line breaks or control characters" if error["ctx"]["pattern"] == PORT else "line breaks"
        message = f"{_shown(value)} is no name" if value else "the name is empty"
        return source.fault(path, message, f"a name has no {barred} and no spaces around it", at_key=at_key)
    if kind == "string_too_short":
        key = next((step for step in reversed(path[:-1] if at_key else path) if isinstance(step, str)), "")
        is_port = path[-2:-1] in (("inputs",), ("outputs",))
        return source.fault(path, *(_EMPTY_TAG if is_port else _EMPTY.get(key, _EMPTY_TAG)), at_key=at_key)
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


def _unknown_key(source: Source, path: Path, value: object, part: type[BaseModel]) -> Fault:
    fields = _keys_at(part, path[:-1])
    known, name = sorted(fields), str(path[-1])
    inner = next((key for key in known if name in _keys_within(fields[key])), None)
    first, _, rest = name.partition(":")
    meant = _keys_like(name, known)
    if part is model_of(IncludedPart) and len(path) == 1 and name in EnvironmentPart.all_keys():
        mend = "an included file has only transformations and targets: move this key to the main file"
    elif first in known and rest:
        mend = f"put a space after the colon: `{first}: {rest}`"
    elif name == "rate" and _has_inputs(source, path):
        mend = "remove it: only a source has a rate (`run: {rate: ...}`); elements of its inputs start its steps"
    elif name.casefold() not in _SYNONYMS and inner is not None:
        mend = f"it belongs under `{inner}`: write `{inner}: {{{name}: ...}}`"
    elif len(meant) > 1 and any(key in _EACH_MEANS for key in meant):
        mend = f"write {' or '.join(f'`{key}` ({_EACH_MEANS[key]})' for key in meant)}"
    elif name == "type" and "kind" in known:
        mend = "a message type belongs to a port: `image: {tag: Image, type: sensor_msgs/Image}`; `kind` is free text"
    elif value is None and not meant and "tag" in known and name[:1].isupper():
        mend = "in braces a comma ends the tag: join concepts by `and`, or put quotes around the tag"
    elif not meant and (holders := [key for key in known if name in _keys_of_each(fields[key])]):
        mend = f"it is a key of each entry of `{'` or `'.join(holders[:3])}`: write it there"
    else:
        mend = f"did you mean `{meant[0]}`?" if meant else f"the keys here are {', '.join(known)}"
    return source.fault(path, f"unknown key `{name}`", mend, at_key=True)


def _added(path: Path, part: type[BaseModel]) -> str:
    """The mend of a missing key: to add it, with the values that it may have if they are few words."""
    field = _keys_at(part, path[:-1]).get(str(path[-1]))
    values = get_args(field.annotation) if field is not None and get_origin(field.annotation) is Literal else ()
    forms = [f"`{path[-1]}: {value}`" for value in values] or [f"`{path[-1]}:`"]
    return f"add {' or '.join(forms)} here"


def _has_inputs(source: Source, path: Path) -> bool:
    """Whether the mapping with the key at `path` has inputs."""
    data: Any = source.data
    for step in path[:-1]:
        data = data[step]
    return bool(data.get("inputs"))


def _keys_within(field: Any) -> Collection[str]:
    """The keys of the one mapping that a field may hold."""
    inner = None if _holds_several(field.annotation) else _part_in(field.annotation)
    return () if inner is None else inner.model_fields


def _keys_of_each(field: Any) -> Collection[str]:
    """The keys of each of the mappings that a field may hold several of."""
    inner = _part_in(field.annotation) if _holds_several(field.annotation) else None
    return () if inner is None else inner.model_fields


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


def _wrong_kind(source: Source, path: Path, wanted: str, value: object, part: type[BaseModel]) -> tuple[str, str]:
    message = f"this must be {wanted}, but is {_described(value)}"
    written = source.locate(path, False).text
    if wanted == "text":
        return message, _as_text(path, written, value)
    if wanted.startswith(("a number", "a whole")):
        return message, _as_number(path, wanted, value)
    if isinstance(value, str) and wanted == "true or false":
        return message, "write true or false" + _if_quoted(value)
    if wanted == "a list":
        if isinstance(value, dict) and len(value) == 1 and isinstance(one := next(iter(value.values())), str):
            return message, f"write `{one}` without a key, or begin each entry with `- `"
        is_one = isinstance(value, str | int | Decimal)
        return message, f"write [{value}], or begin each entry with `- `" if is_one else "begin each entry with `- `"
    if wanted.startswith("a mapping"):
        return message, _as_mapping(path, value, part)
    return message, f"write {wanted} here"


def _as_text(path: Path, written: str | None, value: object) -> str:
    """The mend of a value that is no text, and has to be one."""
    if path[-2:-1] in (("inputs",), ("outputs",)) and value is None and not written:
        mend = "write `name: tag`; in braces a comma begins the next port: join concepts by `and`, or quote the tag"
        return mend if " " in str(path[-1]) else f"write a tag: `{path[-1]}: Image`"
    if value is None and isinstance(path[-1], int):
        return "remove this entry, or write a text"
    if written is not None and not isinstance(value, str):
        return f'write it in quotes: "{written}"' if written else "write a text, or remove the key"
    if isinstance(value, list) and len(value) == 1 and isinstance(value[0], str):
        return f"write it without brackets, `{value[0]}`, or in quotes: a text that begins with [ is read as a list"
    return f"write it in quotes: a text that begins with {'{' if isinstance(value, dict) else '['} is read as a " + (
        "mapping" if isinstance(value, dict) else "list"
    )


def _as_number(path: Path, wanted: str, value: object) -> str:
    """Return the mend of a value that is not a number, or no whole one; a value with a unit is converted."""
    is_whole = wanted.startswith("a whole")
    if isinstance(value, Decimal) and value.is_finite() and abs(value) < LARGEST_AMOUNT:
        return f"write a whole number, such as {ceil(value)}"
    if not isinstance(value, str):
        return f"write {wanted} here"
    if path[-2:-1] not in _NAMED_BY_USERS and (measure := MEASURES.get(str(path[-1]))) is not None:
        number = measure.number(value)
        if number is not None and is_whole:
            number = number // 1 or None
        said = f", such as {measure.usual}{_if_quoted(value)}" if number is None else f": {_plain(number)}"
        return f"write {measure.unit}, a plain number{said}"
    meant = guessed_s(value)
    if path[-1] == "horizon":
        seconds = 600 if meant is None else ceil(meant)
        return f"write a whole number of seconds, such as {seconds}, or a span such as 10m or 1h" + _if_quoted(value)
    is_time = not is_whole and "seconds" in wanted
    if is_time and meant is not None and isinstance(resolve(value), str):
        return f"write a plain number of seconds: {_plain(meant)}"
    return f"write a plain number, such as {'1' if is_whole else '0.3'}" + _if_quoted(value)


def _as_mapping(path: Path, value: object, part: type[BaseModel]) -> str:
    """The mend of a value that is no mapping, by the keys that belong there."""
    if path[-1:] in (("inputs",), ("outputs",)):
        return "write each port as `name: tag`, such as {image: Image, pose: Pose}"
    if path[-1:] == ("params",):
        return "write each as `name: value`, such as {gain: 3}"
    inner = _part_at(part, path)
    keys = [] if inner is None else [*inner.model_fields]
    needed = [] if inner is None else [key for key in keys if inner.model_fields[key].is_required()]
    if needed and not isinstance(value, dict | list):
        first = "..." if value is None else value
        rest = "".join(f", {key}: ..." for key in needed[1:])
        return f"write {{{needed[0]}: {str(first).lower() if isinstance(value, bool) else first}{rest}}}"
    if not keys:
        return "write a mapping of keys to values here"
    return f"write a mapping here, such as {{{keys[0]}: ...}}; its keys are {', '.join(keys[:6])}"


def _plain(number: Decimal) -> str:
    """A number without exponent and trailing zeros."""
    text = f"{number:f}"
    return text.rstrip("0").rstrip(".") if "." in text else text


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
