"""Short names of an ontology's classes, individuals and properties, and the message about a misspelt one."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
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

    A short name that stands for several IRIs means that of the first `preferred` namespace that has one. Without one it
    is ambiguous and must be written with its prefix or as `<IRI>`.
    """

    def __init__(
        self, what: str, iris: Iterable[str], prefixes: Mapping[str, str], preferred: Sequence[str] = ()
    ) -> None:
        self.what = what
        self._preferred = preferred
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

    def __iter__(self) -> Iterator[str]:
        return iter(self._iris)

    def has(self, name: str) -> bool:
        """Whether an IRI has this short name."""
        return bool(self._by_name.get(normal(name)))

    def written(self, iri: str) -> str:
        """The shortest name of this IRI: short, with its prefix, or in full."""
        short = short_name(iri)
        if len(self._by_name.get(short, ())) < 2 or self._meant(short) == iri:
            return short
        prefix = self._prefix(iri)
        return f"<{iri}>" if prefix is None else f"{prefix}:{short}"

    def _prefix(self, iri: str) -> str | None:
        """The first prefix that stands for all of an IRI but its short name."""
        short = short_name(iri)
        return next((prefix for prefix in sorted(self._prefixes) if self._prefixes[prefix] + short == iri), None)

    def _meant(self, short: str) -> str | None:
        """Return the only IRI of a short name, or the one in the first preferred namespace that has it; else None."""
        iris = self._by_name.get(short, ())
        if len(iris) == 1:
            return iris[0]
        return next((space + short for space in self._preferred if space + short in iris), None)

    def find(self, name: str) -> str | None:
        """The IRI that `name`, `prefix:name` or `<IRI>` stands for; None if there is none.

        Raises UnknownNameError if the name is ambiguous or its prefix unknown.
        """
        name = normal(name)
        iris = self._by_name.get(name)
        if iris:
            meant = self._meant(name)
            if meant is None:
                raise UnknownNameError(f"the {self.what} {name!r} is ambiguous", self._choices(iris))
            return meant
        iri = expanded(name, self._prefixes)
        return iri if iri in self._iris else None

    def _choices(self, iris: Sequence[str]) -> str:
        mend = f"write {' or '.join(map(self.written, iris))}"
        prefix = next((prefix for iri in iris if (prefix := self._prefix(iri)) is not None), None)
        if prefix is None:
            return mend
        entry = prefix or '":"'
        return (
            f"{mend}, or {f'add {entry} to `prefer:`' if self._preferred else f'`prefer: {entry}`'} in the environment"
        )


def expanded(name: str, prefixes: Mapping[str, str]) -> str | None:
    """The IRI written as `<IRI>` or `prefix:name`; None for a name without either. Raises UnknownNameError."""
    if name.startswith("<"):
        return name[1:-1]
    prefix, colon, local = name.partition(":")
    if not colon:
        return None
    return namespace_of(prefix, prefixes) + local


def namespace_of(prefix: str, prefixes: Mapping[str, str]) -> str:
    """The namespace of a prefix. Raises UnknownNameError with the prefixes that are known."""
    if prefix not in prefixes:
        known = ", ".join(f"{known}:" for known in sorted(prefixes)) or "no prefix at all"
        raise UnknownNameError(f"the prefix {prefix + ':'!r} is unknown", f"the ontology declares {known}")
    return prefixes[prefix]
