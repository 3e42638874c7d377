"""The parsed form of an ontology file, and its copy in the cache folder.

Reading a kept file takes about a tenth of the time, and imports no parser. Its key is a hash of the file's content, its
names, and of the code that reads: the parsers' and the one beside this file.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from importlib.util import find_spec
from itertools import chain
from pathlib import Path
from typing import Final

from cfgplan.cache_folder import CachePart
from cfgplan.canonical import normal
from cfgplan.matching.functional import Signature, parse, signature_of

_DOCUMENTS: Final = CachePart("ontologies", "cfgplan-ontology/1")


@dataclass(frozen=True)
class OntologyDocument:
    """One parsed file: its own IRI, the IRIs it imports, its axioms and prefixes, and its dropped statements with
    reasons.

    `lost_rules` are the texts of the dropped rules, each with its rule. The `signature` is known of a kept file.
    """

    iri: str | None = None
    imports: tuple[str, ...] = ()
    axioms: tuple[str, ...] = ()
    prefixes: Mapping[str, str] = field(default_factory=dict)
    dropped: Mapping[str, str] = field(default_factory=dict)
    lost_rules: tuple[tuple[str, str], ...] = ()
    signature: Signature | None = None


def key_of(content: bytes, path: Path, shown: str) -> str:
    """The name under which a file is kept; `path` is its absolute path, and `shown` the one in messages."""
    about = repr((path.as_uri(), Path(shown).name, _mark_of_readers()))
    return hashlib.sha256(about.encode() + content).hexdigest()


def kept_document(folder: Path, key: str) -> OntologyDocument | None:
    """The file that is kept under a key; None if there is none or it is damaged."""
    known = _DOCUMENTS.find(folder, key)
    if known is None:
        return None
    try:
        iri, imports, axioms = known["iri"], tuple(known["imports"]), tuple(known["axioms"])
        prefixes, dropped = dict(known["prefixes"]), dict(known["dropped"])
        lost_rules = tuple((text, rule) for text, rule in known["lost_rules"])
        signature = Signature(*map(frozenset, known["signature"]))
    except (LookupError, TypeError, ValueError):
        return None
    texts = imports, axioms, prefixes.values(), dropped.values(), *lost_rules, *signature, () if iri is None else (iri,)
    if not all(isinstance(text, str) for some in texts for text in some):
        return None
    return OntologyDocument(iri, imports, axioms, prefixes, dropped, lost_rules, signature)


def keep_document(folder: Path, key: str, document: OntologyDocument) -> OntologyDocument:
    """Keep a file as it was read. Returns it with its signature."""
    signature = signature_of(map(parse, map(normal, document.axioms)))
    content = {
        **vars(document),
        "prefixes": dict(document.prefixes),
        "dropped": dict(document.dropped),
        "signature": [sorted(names) for names in signature],
    }
    _DOCUMENTS.keep(folder, key, content)
    return replace(document, signature=signature)


@cache
def _mark_of_readers() -> tuple[tuple[str, int, int], ...]:
    """Names, sizes and times of the files with the code that reads ontologies: another version may read differently."""
    specs = map(find_spec, ("pyhornedowl", "pyoxigraph"))
    parsers = chain.from_iterable((spec and spec.submodule_search_locations) or () for spec in specs)
    folders = Path(__file__).parent, *map(Path, parsers)
    files = sorted(path for folder in folders for path in folder.iterdir() if path.is_file())
    return tuple((file.name, about.st_size, about.st_mtime_ns) for file in files for about in [file.stat()])
