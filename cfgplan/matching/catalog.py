"""Catalogs as Protégé keeps them beside ontologies: the file of each imported IRI.

Reference: XML Catalogs (OASIS Standard V1.1, 2005). Only `uri`, `group`, `nextCatalog` and `xml:base` are read.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Final
from urllib.parse import unquote, urljoin, urlsplit

from cfgplan.errors import Fault, InputError
from cfgplan.file_content import content_of

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

CATALOG: Final = "catalog-v001.xml"
_CATALOG_NAMESPACE: Final = "{urn:oasis:names:tc:entity:xmlns:xml:catalog}"
_XML_BASE: Final = "{http://www.w3.org/XML/1998/namespace}base"


def catalogued(folder: Path) -> Mapping[str, Path]:
    """The file of each IRI (without # or / at its end) that a folder's catalog names; files that are not there are
    left out. Raises InputError for a catalog that can't be read.
    """
    path = folder / CATALOG
    try:
        changed = path.stat().st_mtime_ns
    except OSError:
        return MappingProxyType({})
    return _read(path, changed)


@lru_cache(maxsize=64)
def _read(path: Path, _changed: int) -> Mapping[str, Path]:
    from xml.etree.ElementTree import ParseError, fromstring

    found: dict[str, Path] = {}
    read: set[Path] = set()
    waiting = [path]
    while waiting:
        catalog = waiting.pop(0)
        if catalog in read:
            continue
        read.add(catalog)
        try:
            root = fromstring(content_of(catalog))
        except OSError as error:
            raise InputError.of(f"the catalog can't be read: {error.strerror}", file=str(catalog)) from None
        except ParseError as error:
            line, column = error.position
            mend = "save it again in Protégé, or remove it and name the files under `imports:`"
            fault = Fault("the catalog is not XML", file=str(catalog), line=line, column=column + 1, mend=mend)
            raise InputError([fault]) from None
        for kind, name, target in _entries(root, catalog.as_uri()):
            if kind == "uri" and target.is_file():
                found.setdefault(name.rstrip("#/"), target.resolve())
            elif kind == "nextCatalog" and target.is_file():
                waiting.append(target)
    return MappingProxyType(found)


def _entries(element: Element, base: str) -> Iterator[tuple[str, str, Path]]:
    """The entries of a catalog that name files: their kind, the name that they map, and the file."""
    base = urljoin(base, element.get(_XML_BASE) or "")
    for child in element:
        kind = child.tag.removeprefix(_CATALOG_NAMESPACE)
        if kind == "group":
            yield from _entries(child, base)
        target = child.get({"uri": "uri", "nextCatalog": "catalog"}.get(kind, ""))
        if target:
            parts = urlsplit(urljoin(urljoin(base, child.get(_XML_BASE) or ""), target))
            if parts.scheme == "file":
                yield kind, child.get("name") or "", Path(unquote(parts.path))
