"""From one format of the environment file to another, templates and all."""

from __future__ import annotations

from typing import Any

from cfgplan.errors import InputError
from cfgplan.formats.document import Document
from cfgplan.formats.dump import dump_yaml
from cfgplan.formats.fields import FORMAT
from cfgplan.formats.xml_dump import dump_xml

_LISTS = ("transformations", "units", "targets")


def as_yaml(document: Document) -> str:
    """A document as one YAML file that says the same; what it includes is written into it. Raises InputError."""
    return dump_yaml(plain_document(document))


def as_xml(document: Document) -> str:
    """A document as one XML file that says the same; what it includes is written into it. Raises InputError."""
    return dump_xml(plain_document(document))


def plain_document(document: Document) -> dict[str, Any]:
    """What a document and its includes say, as written: nothing is expanded. Raises InputError."""
    if document.faults:
        raise InputError(document.faults)
    whole: dict[str, Any] = {"format": FORMAT}
    for number, file in enumerate(document.files):
        data = file.source.data
        assert isinstance(data, dict)
        if number == 0:
            whole |= {key: value for key, value in data.items() if key not in (*_LISTS, "include")}
        for key in _LISTS:
            if data.get(key):
                whole.setdefault(key, []).extend(data[key])
    return whole
