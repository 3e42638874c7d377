"""Short names of an ontology's classes, individuals and properties, and what to say about a misspelt one."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterable, Mapping
from types import MappingProxyType

from cfgplan.canonical import normal
from cfgplan.errors import UnknownNameError

_LAST_PART = re.compile(r"[#/:]([^#/:]+)[#/]?$")


def short_name(iri: str) -> str:
    """The fragment of an IRI or else its last path part."""
    found = _LAST_PART.search(iri)
    return found.group(1) if found else iri


class NameTable:
    """The names of one kind (`what`, such as "class") by their short and prefixed forms.

    A short name that stands for several IRIs is ambiguous and must be written with its prefix or as `<IRI>`.
    """

    def __init__(self, what: str, iris: Iterable[str], prefixes: Mapping[str, str]) -> None:
        self.what = what
        self._iris = frozenset(iris)
        self._prefixes = prefixes
        by_name: defaultdict[str, list[str]] = defaultdict(list)
        for iri in sorted(self._iris):
            by_name[short_name(iri)].append(iri)
        self._by_name = by_name
        self.by_short_name: Mapping[str, str] = MappingProxyType(
            {self.written(iri): iri for iris_of_name in by_name.values() for iri in iris_of_name}
        )

    def __contains__(self, iri: object) -> bool:
        return iri in self._iris

    def has(self, name: str) -> bool:
        """Whether an IRI has this short name."""
        return bool(self._by_name.get(normal(name)))

    def written(self, iri: str) -> str:
        """The shortest name of this IRI: short, with its prefix, or in full."""
        short = short_name(iri)
        if len(self._by_name.get(short, ())) < 2:
            return short
        for prefix, namespace in sorted(self._prefixes.items()):
            if namespace + short == iri:
                return f"{prefix}:{short}"
        return f"<{iri}>"

    def find(self, name: str) -> str | None:
        """The IRI that `name`, `prefix:name` or `<IRI>` stands for; None if there is none.

        Raises UnknownNameError if the name is ambiguous or its prefix unknown.
        """
        name = normal(name)
        iris = self._by_name.get(name)
        if iris:
            if len(iris) > 1:
                choices = " or ".join(self.written(iri) for iri in iris)
                raise UnknownNameError(f"the {self.what} {name!r} is ambiguous", f"write {choices}")
            return iris[0]
        iri = expanded(name, self._prefixes)
        return iri if iri in self._iris else None


def expanded(name: str, prefixes: Mapping[str, str]) -> str | None:
    """The IRI written as `<IRI>` or `prefix:name`; None for a name without either. Raises UnknownNameError."""
    if name.startswith("<"):
        return name[1:-1]
    prefix, colon, local = name.partition(":")
    if not colon:
        return None
    if prefix not in prefixes:
        known = ", ".join(f"{known}:" for known in sorted(prefixes)) or "no prefix at all"
        raise UnknownNameError(f"the prefix {prefix + ':'!r} is unknown", f"the ontology declares {known}")
    return prefixes[prefix] + local
