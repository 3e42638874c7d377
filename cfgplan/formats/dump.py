"""Environments and documents written as YAML or XML that says the same."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from decimal import Decimal
from typing import Any

import yaml

from cfgplan.domain import Environment
from cfgplan.errors import InputError
from cfgplan.formats.document import Document
from cfgplan.formats.fields import FORMAT
from cfgplan.formats.plain import plain_environment
from cfgplan.formats.scalars import resolve
from cfgplan.formats.xml_dump import dump_xml
from cfgplan.planning import Failures

_LISTS = ("transformations", "units", "targets")
_DUMPER: Any = getattr(yaml, "CSafeDumper", yaml.SafeDumper)


def dump_environment(
    environment: Environment,
    *,
    horizon_s: int,
    max_cost_us: int | None = None,
    ontology: Iterable[str] = (),
    survive: Failures | None = None,
    imports: Mapping[str, str | None] | None = None,
) -> str:
    """The YAML text of an environment; `ontology` and `imports` say how it names files, see `plain_environment`."""
    return dump_yaml(
        plain_environment(
            environment,
            horizon_s=horizon_s,
            max_cost_us=max_cost_us,
            ontology=ontology,
            survive=survive,
            imports=imports,
        )
    )


def dump_yaml(data: object) -> str:
    """Plain data as YAML text; Decimal is written exactly, and a text never looks like something else."""
    text: str = yaml.dump(data, Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=2**20)
    return text


def as_yaml(document: Document) -> str:
    """A document as one YAML file that says the same; what it includes is written into it. Raises InputError."""
    return dump_yaml(plain_document(document))


def as_xml(document: Document) -> str:
    """A document as one XML file that says the same; what it includes is written into it. Raises InputError."""
    return dump_xml(plain_document(document))


def plain_document(document: Document) -> dict[str, Any]:
    """A document and its includes as one mapping, as written: nothing is expanded. Raises InputError."""
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


class _Dumper(_DUMPER):  # type: ignore[misc]
    """PyYAML's dumper, with the reader's own idea of which plain scalars are text."""

    def ignore_aliases(self, data: object) -> bool:  # noqa: ARG002
        return True


def _text(dumper: Any, text: str) -> yaml.ScalarNode:
    is_safe = isinstance(resolve(text), str) and text != "<<"
    node: yaml.ScalarNode = dumper.represent_scalar("tag:yaml.org,2002:str", text, style=None if is_safe else '"')
    return node


def _number(dumper: Any, number: Decimal) -> yaml.ScalarNode:
    text = format(number, "f")
    written = text if "." in text else f"{text}.0"
    node: yaml.ScalarNode = dumper.represent_scalar("tag:yaml.org,2002:float", written)
    return node


_Dumper.add_representer(str, _text)
_Dumper.add_representer(Decimal, _number)
