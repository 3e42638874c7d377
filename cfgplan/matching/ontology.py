"""An ontology as a set of axioms with the names that tags can use."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable, Mapping, Sequence
from copy import copy
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

from cfgplan.canonical import normal
from cfgplan.errors import UnknownNameError, did_you_mean
from cfgplan.matching.concepts import NOTHING_IRI, THING_IRI, Concept, in_description_logic, in_words
from cfgplan.matching.functional import Signature, Tree, parse, signature_of
from cfgplan.matching.literals import accepted_by_reasoners
from cfgplan.matching.names import NameTable, expanded, namespace_of, short_name
from cfgplan.selectors import quoted

BRACKETED: Final = re.compile(r"<([^<>\s]+)>")


class Ontology:
    """Axioms in OWL functional syntax with full IRIs, and the prefixes their file declares.

    An *open* ontology declares no names: tags may use any name, and a name matches only itself. Ontologies are values:
    those with the same axioms and prefixes are equal. `files` are those that it was read from. `dropped` maps each
    statement of the files that reasoners do not get to the reason: matches hold in spite of it, but pairs that don't
    match might match by it. `lost_rules` are the texts of the rules among it, each with the axiom that stands for it.
    `ignored` are the IRIs of imports left out on request, `ignored_rules` counts the rules left out on request; neither
    belongs to the ontology, so no pair is open for them. `trees` may have axioms that are parsed already, `signature`
    the names in all axioms. `preferred` are namespaces: a short name means the IRI in the first of them that has it.
    """

    def __init__(
        self,
        axioms: Iterable[str] = (),
        prefixes: Mapping[str, str] | None = None,
        *,
        is_open: bool = False,
        files: Iterable[Path] = (),
        dropped: Mapping[str, str] | None = None,
        lost_rules: Iterable[tuple[str, str]] = (),
        ignored: Iterable[str] = (),
        ignored_rules: int = 0,
        trees: Mapping[str, Tree] | None = None,
        signature: Signature | None = None,
    ) -> None:
        self.axioms: frozenset[str] = frozenset(map(normal, axioms))
        written = prefixes or {}
        self.prefixes: Mapping[str, str] = MappingProxyType({normal(p): normal(iri) for p, iri in written.items()})
        self.is_open = is_open
        self.files = tuple(files)
        self._dropped = dict(dropped or {})
        self.lost_rules = tuple(sorted({(text, normal(rule)) for text, rule in lost_rules}))
        self.ignored = tuple(sorted(set(ignored)))
        self.ignored_rules = ignored_rules
        self._parsed = trees or {}
        self._known_signature = signature
        self.preferred: tuple[str, ...] = ()

    def __getstate__(self) -> dict[str, object]:
        derived = {name for name, kind in vars(type(self)).items() if isinstance(kind, cached_property)}
        kept = {name: value for name, value in vars(self).items() if name not in derived}
        return {**kept, "prefixes": dict(self.prefixes)}

    def __setstate__(self, state: Mapping[str, Any]) -> None:
        vars(self).update({**state, "prefixes": MappingProxyType(state["prefixes"])})

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Ontology):
            return NotImplemented
        return self._content == other._content

    def __hash__(self) -> int:
        return hash((self.axioms, self.is_open))

    @property
    def _content(self) -> tuple[object, ...]:
        named = self.axioms, self.prefixes, self.preferred, self.is_open
        return *named, self.dropped, self.ignored, self.ignored_rules

    def __repr__(self) -> str:
        return f"<Ontology of {len(self.axioms)} axioms{', open' if self.is_open else ''}>"

    def with_axioms(self, axioms: Iterable[str]) -> Ontology:
        """This ontology with other axioms."""
        other = copy(self)
        other.axioms = frozenset(map(normal, axioms))
        other._known_signature = None
        return other

    def preferring(self, spaces: Iterable[str]) -> Ontology:
        """Return this ontology with preferred namespaces: a short name means the IRI in the first of them
        that has it.
        """
        other = copy(self)
        other.preferred = tuple(spaces)
        return other

    def namespace(self, written: str) -> str:
        """The namespace that a prefix such as `brick` or `brick:`, or an IRI with or without brackets, stands for.

        Raises UnknownNameError for a prefix that the ontology does not declare, and if no name is in the namespace.
        """
        written = normal(written)
        if ":" not in written.removesuffix(":"):
            return namespace_of(written.removesuffix(":"), self.prefixes)
        space = written.removeprefix("<").removesuffix(">")
        if any(space + short_name(iri) == iri for names in self._vocabularies for iri in names):
            return space
        spaces = sorted({iri.removesuffix(short_name(iri)) for names in self._vocabularies for iri in names})
        mend = did_you_mean(space, spaces, f"the ontology has names in {_few(spaces)}")
        raise UnknownNameError(f"no name of the ontology is in the namespace <{space}>", mend)

    @cached_property
    def trees(self) -> Mapping[str, Tree]:
        """The tree of each axiom, in the order of the axioms' texts."""
        return MappingProxyType({axiom: self._parsed.get(axiom) or parse(axiom) for axiom in sorted(self.axioms)})

    @cached_property
    def digest(self) -> str:
        """A hash of the axioms: equal for ontologies that say the same in the same words and leave out the same."""
        lines = "\n".join(sorted(self.axioms)) + ("\nopen" if self.is_open else "")
        lines += "".join(f"\ndropped {text}" for text in self.dropped)
        lines += "".join(f"\nignored {iri}" for iri in self.ignored)
        lines += f"\nignored {self.ignored_rules} rules" if self.ignored_rules else ""
        return hashlib.sha256(lines.encode()).hexdigest()

    @cached_property
    def _told(self) -> tuple[frozenset[str], Mapping[str, str]]:
        return accepted_by_reasoners(self.axioms)

    @property
    def told(self) -> frozenset[str]:
        """The axioms as reasoners accept them: only with literals of datatypes that they know."""
        return self._told[0]

    @cached_property
    def dropped(self) -> Mapping[str, str]:
        """Statements of the files that reasoners do not get, with the reason of each."""
        return MappingProxyType(dict(sorted({**self._dropped, **self._told[1]}.items())))

    @cached_property
    def warnings(self) -> tuple[str, ...]:
        """A sentence on each kind of dropped statement, on each ignored import, and on ignored rules."""
        by_reason: dict[str, list[str]] = {}
        for text, why in self.dropped.items():
            by_reason.setdefault(self.shortened(why), []).append(self.shortened(text))
        return (
            *(
                f"the ontology says more than cfgplan reads: {texts[0]}{_and_more(len(texts) - 1)}: {why}"
                for why, texts in by_reason.items()
            ),
            *(
                f"the import <{iri}> is ignored: tags that match only by its axioms do not match"
                for iri in self.ignored
            ),
            *([self._about_ignored_rules()] if self.ignored_rules else []),
        )

    def _about_ignored_rules(self) -> str:
        rules = "1 rule is" if self.ignored_rules == 1 else f"{self.ignored_rules:,} rules are"
        return f"{rules} ignored: tags that match only by them do not match"

    @cached_property
    def _signature(self) -> Signature:
        return self._known_signature or signature_of(self.trees.values())

    @cached_property
    def class_names(self) -> NameTable:
        """The vocabulary of classes."""
        return NameTable("class", self._signature.classes, self.prefixes, self.preferred)

    @cached_property
    def individual_names(self) -> NameTable:
        """The vocabulary of individuals."""
        return NameTable("individual", self._signature.individuals, self.prefixes, self.preferred)

    @cached_property
    def property_names(self) -> NameTable:
        """The vocabulary of object properties."""
        return NameTable("property", self._signature.roles, self.prefixes, self.preferred)

    @property
    def _vocabularies(self) -> tuple[NameTable, ...]:
        return self.class_names, self.individual_names, self.property_names

    @property
    def classes(self) -> Mapping[str, str]:
        """IRIs of the named classes by short name (`prefix:name` where the short name is ambiguous)."""
        return self.class_names.by_short_name

    @property
    def individuals(self) -> Mapping[str, str]:
        """IRIs of the individuals by short name (`prefix:name` where the short name is ambiguous)."""
        return self.individual_names.by_short_name

    def find(self, name: str, vocabularies: Sequence[NameTable]) -> tuple[NameTable, str] | None:
        """The first vocabulary that has a name, and its IRI; None in an open ontology. Raises UnknownNameError."""
        for vocabulary in vocabularies:
            iri = vocabulary.find(name)
            if iri is not None:
                return vocabulary, iri
        if self.is_open:
            return None
        raise self._unknown(name, vocabularies)

    def free_iri(self, name: str) -> str:
        """The IRI of a name that an open ontology doesn't know."""
        name = normal(name)
        return expanded(name, self.prefixes) or name

    def written(self, iri: str) -> str:
        """The shortest name of an IRI."""
        for vocabulary in self._vocabularies:
            if iri in vocabulary:
                return vocabulary.written(iri)
        return {THING_IRI: "⊤", NOTHING_IRI: "⊥"}.get(iri) or short_name(iri)

    def shortened(self, text: str) -> str:
        """A text, such as an axiom, with short names for the IRIs in brackets."""
        return BRACKETED.sub(lambda found: self.written(found[1]), text)

    def render(self, concept: Concept, *, words: bool = False) -> str:
        """A concept as a tag in DL syntax, or in `words` (`and`, `some`, `value`), with short names; names that would
        be read otherwise are in quotes.
        """
        return (in_words if words else in_description_logic)(concept, self.in_tag)

    def in_tag(self, iri: str) -> str:
        """An IRI as the name that stands for it in a tag."""
        known = [names.written(iri) for names in self._vocabularies if iri in names]
        name = max(known, key=len) if known else iri if self.is_open else short_name(iri)
        if name.startswith("<"):
            return name
        return (None if self.is_open and ":" in name else quoted(name)) or f"<{iri}>"

    def _unknown(self, name: str, vocabularies: Sequence[NameTable]) -> UnknownNameError:
        wanted = " or ".join(vocabulary.what for vocabulary in vocabularies)
        known = sorted(short for vocabulary in vocabularies for short in vocabulary.by_short_name)
        for other in self._vocabularies:
            if other not in vocabularies and other.find(name) is not None:
                message = f"{name!r} is {_article(other.what)}, but {_article(wanted)} is expected here"
                return UnknownNameError(message, f"write one, such as {', '.join(known[:3])}" if known else None)
        mend = did_you_mean(name, known, "declare it in the ontology")
        return UnknownNameError(f"the ontology has no {wanted} {name!r}", mend)


def _and_more(number: int) -> str:
    return f" and {number:,} more" if number else ""


def _few(namespaces: Sequence[str]) -> str:
    return (", ".join(f"<{each}>" for each in namespaces[:3]) or "no namespace") + _and_more(len(namespaces[3:]))


def _article(noun: str) -> str:
    return f"an {noun}" if noun[0] in "aeiou" else f"a {noun}"
