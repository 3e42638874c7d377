"""Contexts of JSON-LD, and the IRIs that they give to terms. None is ever fetched; a file may stand for one."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Final

from cfgplan.errors import InputError
from cfgplan.formats.files import read_text
from cfgplan.formats.json_text import read_json

TD_CONTEXTS: Final = (
    "https://www.w3.org/2022/wot/td/v1.1",
    "https://www.w3.org/2019/wot/td/v1",
    "http://www.w3.org/ns/td",
)
"""The contexts of which a Thing Description has one, the present one first."""
_PREFIXES: Final = {
    "td": "https://www.w3.org/2019/wot/td#",
    "jsonschema": "https://www.w3.org/2019/wot/json-schema#",
    "wotsec": "https://www.w3.org/2019/wot/security#",
    "hctl": "https://www.w3.org/2019/wot/hypermedia#",
    "htv": "http://www.w3.org/2011/http#",
    "dct": "http://purl.org/dc/terms/",
    "schema": "http://schema.org/",
    "rdf": "http://www.w3.org/1999/02/22-rdf-syntax-ns#",
    "rdfs": "http://www.w3.org/2000/01/rdf-schema#",
    "xsd": "http://www.w3.org/2001/XMLSchema#",
}
"""The prefixes of the contexts of Thing Descriptions."""
_TERM: Final = "urn:cfgplan:term:"
_WHOLE: Final = re.compile(r"https?://|urn:")
"""Begins a term that is an IRI, and no prefix with a name."""
_ASKED: Final = "urn:cfgplan:asked"


class Contexts:
    """Contexts by their URLs, read from files. `unread` are those that were named and that no file stands for."""

    def __init__(self, files: Mapping[str, Path]) -> None:
        """Raise InputError for a file that is no context."""
        self._read = {url: _context(path) for url, path in files.items()}
        self.unread: set[str] = set()

    def iris(self, context: object, terms: Iterable[str]) -> dict[str, str]:
        """The IRIs that a context gives to terms. Raises ValueError.

        A term without one is left out, and so is one whose prefix no context defines.
        """
        from pyoxigraph import RdfFormat, parse

        asked = sorted(set(terms))
        document = {
            # A term of its own says that values are terms too.
            "@context": [*self._inlined(context, ()), {_ASKED: {"@type": "@vocab"}}],
            "@graph": [{"@id": f"{_TERM}{number}", _ASKED: term} for number, term in enumerate(asked)],
        }
        try:
            quads = [*parse(json.dumps(document, default=str), format=RdfFormat.JSON_LD)]
        except SyntaxError as error:
            raise ValueError(str(error)) from None
        iris = {int(each.subject.value.removeprefix(_TERM)): each.object.value for each in quads}
        found = {asked[number]: iri for number, iri in iris.items()}
        return {term: iri for term, iri in found.items() if iri != term or _WHOLE.match(iri)}

    def _inlined(self, context: object, within: tuple[str, ...]) -> list[object]:
        """Contexts without URLs. One that names itself is taken once."""
        found: list[object] = []
        for each in context if isinstance(context, list) else [context]:
            if not isinstance(each, str):
                found.append(each)
            elif each in self._read and each not in within:
                found += self._inlined(self._read[each], (*within, each))
            elif each in TD_CONTEXTS:
                found.append(_PREFIXES)
            elif each not in within:
                self.unread.add(each)
        return found


def _context(path: Path) -> object:
    """The context that a file holds. Raises InputError."""
    data = read_json(read_text(path), str(path)).data
    if not isinstance(data, dict) or "@context" not in data:
        mend = "a context is a mapping with the key `@context`"
        raise InputError.of("this file has no JSON-LD context", file=str(path), mend=mend)
    return data["@context"]
