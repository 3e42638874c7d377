"""Environments written in the paper's XML, with the attributes and elements that `xml_text` adds to it."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from decimal import Decimal
from typing import Any
from xml.sax.saxutils import escape, quoteattr

from cfgplan.errors import InvalidValueError
from cfgplan.formats import fields
from cfgplan.formats.xml_elements import XML_BLANK

_NO_XML = re.compile("[\0-\x08\x0b\x0c\x0e-\x1f\ud800-\udfff\ufffe\uffff]")


def dump_xml(data: Mapping[str, Any]) -> str:
    """The XML text of plain data in the environment file's form, such as `plain_environment` gives.

    Raises InvalidValueError for a name or tag with a character that XML can't contain, and for data that the XML can't
    express: hosts, quality, and every other list or mapping that the paper's XML does not have.
    """
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + "\n".join(_environment(data)) + "\n"


def _environment(data: Mapping[str, Any]) -> Iterator[str]:
    yield _opened("environment", _attributes(fields.EnvironmentPart, {**data, "format": None}))
    for key in ("ontology", "prefer", "include"):
        said = data.get(key) or []
        for text in [said] if isinstance(said, str) else said:
            yield f"  {_element(key, text)}"
    if data.get("defaults"):
        yield f"  {_opened('defaults', _attributes(fields.DefaultsPart, data['defaults']))[:-1]}/>"
    for part in data.get("transformations") or ():
        yield from _transformation(part)
    for part in data.get("units") or ():
        yield from _unit(part)
    for part in data.get("targets") or ():
        yield f"  {_opened('target', _attributes(fields.TargetPart, part))}"
        for name in ("label", "topic", "tag"):
            if part.get(name) is not None:
                yield f"    {_element(name, part[name])}"
        yield "  </target>"
    yield "</environment>"


def _transformation(part: Mapping[str, Any]) -> Iterator[str]:
    yield f"  {_opened('transformation', _attributes(fields.TransformationPart, part))}"
    for name in ("label", "source"):
        if part.get(name) is not None:
            yield f"    {_element(name, part[name])}"
    if part.get("run"):
        yield f"    {_opened('run', _attributes(fields.RunPart, part['run']))[:-1]}/>"
    if part.get("params"):
        yield "    <params>"
        for name, value in part["params"].items():
            kind, text = _param(value)
            yield f"      {_element('param', text, name=name, type=kind)}"
        yield "    </params>"
    ports = [("in", fields.InputPart, *entry) for entry in (part.get("inputs") or {}).items()]
    ports += [("out", fields.OutputPart, *entry) for entry in (part.get("outputs") or {}).items()]
    if ports:
        yield "    <ports>"
        for direction, kind, name, port in ports:
            more = {} if isinstance(port, str) else _attributes(kind, port)
            yield f"      {_element('port', name, type=direction, **more)}"
        yield "    </ports>"
        yield "    <tags>"
        for *_, name, port in ports:
            yield f"      {_element('tag', port if isinstance(port, str) else port['tag'], port=name)}"
        yield "    </tags>"
    yield "  </transformation>"


def _unit(part: Mapping[str, Any]) -> Iterator[str]:
    yield f"  {_opened('unit', _attributes(fields.UnitPart, part))}"
    for port, said in (part.get("inputs") or {}).items():
        for stream in said if isinstance(said, list) else [said]:
            yield f"    {_opened('input', {'port': port, 'stream': stream})[:-1]}/>"
    for port, topics in (part.get("topics") or {}).items():
        for topic in topics:
            yield f"    {_element('topic', topic, port=port)}"
    yield "  </unit>"


def _attributes(part: type[fields.Part], data: Mapping[str, Any]) -> dict[str, object]:
    """Return the attributes of a part. Raises InvalidValueError for a value that XML can't express."""
    for key, row in part.rows().items():
        is_attribute = row.xml not in (None, fields.ELEMENT, fields.UNSAID)
        if data.get(key) and (row.xml is None or (is_attribute and isinstance(data[key], list | dict))):
            what = f"list for `{key}`" if row.xml else f"`{key}`"
            raise InvalidValueError(f"the XML format has no {what}: keep this environment in YAML")
    return {name: data.get(key) for name, key in part.attributes().items()}


def _param(value: object) -> tuple[str, str]:
    """A parameter's value as a type and a text."""
    if value is None:
        return "null", ""
    if isinstance(value, bool):
        return "bool", str(value).lower()
    if isinstance(value, int):
        return "int", str(value)
    if isinstance(value, float | Decimal):
        return "double", str(value)
    if isinstance(value, str) and not _NO_XML.search(value):
        return "string", value
    return "json", json.dumps(value, default=float)


def _element(name: str, text: str, /, **attributes: object) -> str:
    opened = _opened(name, attributes)
    if text.strip(XML_BLANK) != text:
        opened = f'{opened[:-1]} xml:space="preserve">'
    return f"{opened}{escape(_sayable(text), {chr(13): '&#13;'})}</{name}>"


def _opened(name: str, attributes: Mapping[str, object]) -> str:
    said = ((key, _attribute(value)) for key, value in attributes.items() if value is not None and value is not False)
    return f"<{name}{''.join(f' {key}={quoteattr(_sayable(text))}' for key, text in said)}>"


def _attribute(value: object) -> str:
    if isinstance(value, Decimal):
        return format(value, "f")
    return "true" if value is True else str(value)


def _sayable(text: str) -> str:
    if _NO_XML.search(text):
        raise InvalidValueError(f"XML can't say {text!r}: it has a control character")
    return text
