"""Reading Thing Descriptions: things, their properties and events, and the forms by which these are reached."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Literal
from urllib.parse import urljoin, urlsplit

from cfgplan.errors import Fault, InputError, did_you_mean
from cfgplan.formats.files import read_text
from cfgplan.formats.json_text import read_json
from cfgplan.formats.places import Passage
from cfgplan.wot.contexts import TD_CONTEXTS

Kind = Literal["property", "event"]
_DEFAULT_OPS: Final[Mapping[Kind, tuple[str, ...]]] = {
    "property": ("readproperty", "writeproperty"),
    "event": ("subscribeevent", "unsubscribeevent"),
}
_OPS: Final[Mapping[Kind, tuple[str, ...]]] = {
    "property": (*_DEFAULT_OPS["property"], "observeproperty", "unobserveproperty"),
    "event": _DEFAULT_OPS["event"],
}
_LISTS: Final[Mapping[Kind, str]] = {"property": "properties", "event": "events"}
_JSON: Final = "application/json"


@dataclass(frozen=True)
class Form:
    """A way to reach a property or an event: an absolute URL, its operations, and the form's other keys."""

    href: str
    ops: tuple[str, ...]
    media_type: str
    more: Mapping[str, Any] = field(hash=False)

    @property
    def scheme(self) -> str:
        return urlsplit(self.href).scheme


@dataclass(frozen=True)
class Affordance:
    """A property that can be read, or an event, of a thing; `types` and `unit` are terms as they are written."""

    kind: Kind
    name: str
    types: tuple[str, ...]
    unit: str | None
    value: str | None
    """The type of its values in JSON Schema, such as `number`."""
    forms: tuple[Form, ...]


@dataclass(frozen=True)
class Thing:
    """A thing with its properties and events, its contexts, and its schemes of security."""

    file: str
    title: str
    types: tuple[str, ...]
    context: object = field(hash=False)
    affordances: tuple[Affordance, ...]
    security: tuple[str, ...]


def read_things(paths: Iterable[Path]) -> tuple[Thing, ...]:
    """The things that files describe, each one or a list of some. Raises InputError with all faults of all files."""
    faults: list[Fault] = []
    things: list[Thing] = []
    for path in paths:
        try:
            source = read_json(read_text(path), str(path))
        except InputError as error:
            faults += error.faults
        else:
            faults += source.faults
            whole = Passage(source, (), faults)
            for passage, said in _items(whole, source.data):
                if (thing := _thing(passage, said)) is not None:
                    things.append(thing)
    if faults:
        raise InputError(faults)
    return tuple(things)


def _items(passage: Passage, said: object) -> Iterator[tuple[Passage, object]]:
    if isinstance(said, list):
        yield from ((passage.at(number), each) for number, each in enumerate(said))
    else:
        yield passage, said


def _thing(passage: Passage, said: object) -> Thing | None:
    """A thing; None, with its faults noted, if it can't be read."""
    if not isinstance(said, dict):
        passage.note("a Thing Description is a mapping", "write { ... } here")
        return None
    context = said.get("@context")
    listed = context if isinstance(context, list) else [context]
    if not any(each in TD_CONTEXTS for each in listed if isinstance(each, str)):
        at = passage if context is None else passage.at("@context")
        at.note("this is not a Thing Description: its `@context` names none", f'add "{TD_CONTEXTS[0]}" to it')
        return None
    if not all(isinstance(each, str | dict) for each in listed):
        passage.at("@context").note("a context is a URL or a mapping", "write a list of those")
        return None
    title, base = said.get("title"), said.get("base")
    if not isinstance(title, str) or not title.strip():
        passage.note("the thing has no title", 'add "title": "..."')
        title = ""
    if base is not None and not isinstance(base, str):
        passage.at("base").note("`base` is a URL", "write it in quotes")
        base = None
    affordances = tuple(
        found
        for kind, key in _LISTS.items()
        for name, one in _mapping(passage, said, key)
        if (found := _affordance(passage.at(key, name), kind, name, one, base or "")) is not None
    )
    return Thing(
        passage.source.file, title.strip(), _types(passage, said), context, affordances, tuple(_security(passage, said))
    )


def _affordance(passage: Passage, kind: Kind, name: str, said: object, base: str) -> Affordance | None:
    """A property or event; None for one that gives nothing, or, with its faults noted, can't be read."""
    if not isinstance(said, dict):
        passage.note(f"{'an event' if kind == 'event' else 'a property'} is a mapping", "write { ... } here")
        return None
    forms, listed = list[Form](), said.get("forms")
    if not isinstance(listed, list) or not listed:
        at = passage if listed is None else passage.at("forms")
        at.note(f"`{name}` has no `forms`", 'add "forms": [{"href": "..."}]')
        listed = []
    for number, one in enumerate(listed):
        if (form := _form(passage.at("forms", number), kind, one, base)) is not None:
            forms.append(form)
    value = said if kind == "property" else said.get("data", {})
    if not isinstance(value, dict):
        passage.at("data").note("`data` is a schema", "write { ... } here")
        value = {}
    unit, schema = value.get("unit"), value.get("type")
    if unit is not None and not isinstance(unit, str):
        passage.at(*(() if kind == "property" else ("data",)), "unit").note("`unit` is a term", "write it in quotes")
        unit = None
    types = _types(passage, said) + (_types(passage.at("data"), value) if kind == "event" else ())
    if kind == "property" and said.get("writeOnly") is True:
        return None
    return Affordance(kind, name, types, unit, schema if isinstance(schema, str) else None, tuple(forms))


def _form(passage: Passage, kind: Kind, said: object, base: str) -> Form | None:
    href = said.get("href") if isinstance(said, dict) else None
    if not isinstance(said, dict) or not isinstance(href, str):
        passage.note("a form has an `href`", 'write {"href": "..."}')
        return None
    ops = said.get("op", list(_DEFAULT_OPS[kind]))
    ops = [ops] if isinstance(ops, str) else ops
    for op in ops if isinstance(ops, list) else [ops]:
        if op not in _OPS[kind]:
            passage.at("op").note(
                f"`{op}` is not an operation of {'an event' if kind == 'event' else 'a property'}",
                did_you_mean(str(op), _OPS[kind], f"there are {', '.join(_OPS[kind])}"),
            )
            return None
    whole = _joined(base, href)
    if not urlsplit(whole).scheme:
        passage.at("href").note(f"`{href}` is not a complete URL", 'write one, or add "base": "..." to the thing')
        return None
    media_type = said.get("contentType", _JSON)
    return Form(whole, tuple(ops), str(media_type).partition(";")[0].strip().lower(), said)


def _joined(base: str, href: str) -> str:
    """A URL relative to a base of any scheme."""
    scheme, has_scheme, rest = base.partition("://")
    if urlsplit(href).scheme or not has_scheme:
        return href
    return urljoin(f"http://{rest}", href).replace("http", scheme, 1)


def _types(passage: Passage, said: Mapping[str, object]) -> tuple[str, ...]:
    types = said.get("@type", [])
    types = [types] if isinstance(types, str) else types
    if not isinstance(types, list) or not all(isinstance(each, str) and each for each in types):
        passage.at("@type").note("`@type` is a term or a list of terms", "write them in quotes")
        return ()
    return tuple(types)


def _security(passage: Passage, said: Mapping[str, object]) -> Iterator[str]:
    """The schemes of security that hold for the whole thing, but for `nosec`."""
    definitions, asked = said.get("securityDefinitions", {}), said.get("security", [])
    for name in [asked] if isinstance(asked, str) else asked if isinstance(asked, list) else []:
        found = definitions.get(name) if isinstance(definitions, dict) else None
        if not isinstance(found, dict):
            passage.at("security").note(f"`{name}` is not in `securityDefinitions`", "define it there")
        elif (scheme := found.get("scheme")) != "nosec":
            yield str(scheme)


def _mapping(passage: Passage, said: Mapping[str, Any], key: str) -> Iterator[tuple[str, object]]:
    found = said.get(key, {})
    if isinstance(found, dict):
        yield from found.items()
    else:
        passage.at(key).note(f"`{key}` is a mapping", "write { ... } here")
