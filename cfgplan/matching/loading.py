"""Reading ontology files in any of OWL's syntaxes, with the ontologies that they import."""

from __future__ import annotations

import io
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final
from urllib.parse import unquote, urlsplit

from cfgplan.errors import Fault, InputError
from cfgplan.matching.functional import LOGICAL
from cfgplan.matching.ontology import Ontology
from cfgplan.matching.rdf import ANONYMOUS, Graph

EXTENSIONS: Final = {
    ".ttl": "ttl", ".nt": "ttl", ".n3": "ttl", ".owl": "rdf", ".rdf": "rdf", ".xml": "rdf",
    ".owx": "owx", ".ofn": "ofn", ".fss": "ofn", ".omn": "omn",
}  # fmt: skip
_SYNTAX_NAMES: Final = {
    "ttl": "Turtle", "rdf": "RDF/XML", "owx": "OWL/XML", "ofn": "functional syntax", "omn": "Manchester syntax",
}  # fmt: skip
_PREFIX: Final = re.compile(
    r"""(?:@prefix|\bPREFIX|^Prefix:)\s*([\w.-]*):\s*<([^<>]*)>|\bxmlns:([\w.-]+)\s*=\s*["']([^"']*)["']""",
    re.MULTILINE,
)
_ANONYMOUS: Final = re.compile(r'"(?:[^"\\]|\\.)*"|<[^>]*>|_:([\w.-]+)')
_PLACE: Final = re.compile(r"^Parser error (?:at|between) [^:]*: ")
_ANONYMOUS_IRI: Final = re.compile(f"<{ANONYMOUS}([^>]*)>")
_LINE: Final = re.compile(r"line_col: Pos\(\((\d+), (\d+)\)\)|BytePosition\((\d+)\)")
_REASON: Final = re.compile(
    r'message: "((?:[^"\\]|\\.)*)"|Msg\("((?:[^"\\]|\\.)*)"\)|(?:Validity)?Error\("((?:[^"\\]|\\.)*)"'
)

_MISSING = "check the path under `ontology:`; it is relative to the environment file, and web addresses are not fetched"
_NO_TEXT = "name a file in Turtle, RDF/XML, OWL/XML, functional or Manchester syntax"


@dataclass(frozen=True)
class _Document:
    """One parsed file: its own IRI, the IRIs it imports, its axioms and prefixes."""

    iri: str | None
    imports: tuple[str, ...]
    axioms: tuple[str, ...]
    prefixes: dict[str, str]


def load_ontology(paths: Sequence[Path]) -> Ontology:
    """The union of ontology files and of everything they import; the open ontology if there are no files.

    The syntax (Turtle, N-Triples, RDF/XML, OWL/XML, functional, Manchester) is told by the content. An import is a
    relative path, a file beside the importing one that is named like the last part of the IRI or declares it, or
    one of `paths`. Raises InputError with every file that can't be used.
    """
    if not paths:
        return Ontology(is_open=True)
    documents: dict[Path, _Document] = {}
    faults: list[Fault] = []
    waiting = [path.resolve() for path in reversed(paths)]
    shown = {path.resolve(): str(path) for path in paths}
    while waiting:
        path = waiting.pop()
        if path in documents:
            continue
        try:
            document = documents[path] = _read(path, shown[path])
        except InputError as error:
            faults.extend(error.faults)
            documents[path] = _Document(None, (), (), {})
            continue
        for iri in document.imports:
            found = _imported_file(iri, path, documents, [p for p in shown if p not in documents])
            if found is None:
                faults.append(
                    Fault(
                        f"the import <{_relative(iri, path)}> can't be found",
                        file=shown[path],
                        line=_line_with(path, iri),
                        mend=f"put the ontology beside {path.name} or remove the import",
                    )
                )
            elif found not in documents:
                shown.setdefault(found, str(Path(shown[path]).parent / _relative_path(found, path.parent)))
                waiting.append(found)
    if faults:
        raise InputError(faults)
    prefixes: dict[str, str] = {}
    for document in documents.values():
        for prefix, namespace in document.prefixes.items():
            prefixes.setdefault(prefix, namespace)
    axioms = [
        _with_own_anonymous(axiom, number)
        for number, document in enumerate(documents.values())
        for axiom in document.axioms
    ]
    return Ontology(axioms, prefixes, files=documents)


def read_owlready(onto: Any) -> Ontology:
    """The axioms of an `owlready2` ontology object and of those that it imports. Raises InputError."""
    axioms: list[str] = []
    for number, part in enumerate(onto.indirectly_imported_ontologies()):
        written = io.BytesIO()
        part.save(written, format="rdfxml")
        shown = f"owlready2 ontology <{part.base_iri}>"
        document = _parse_rdf(written.getvalue().decode(), "rdf", part.base_iri, shown)
        axioms.extend(_with_own_anonymous(axiom, number) for axiom in document.axioms)
    return Ontology(axioms)


def _with_own_anonymous(axiom: str, number: int) -> str:
    """The axiom with anonymous individuals that no other document has, whatever they are called there."""
    if "_:" not in axiom:
        return axiom
    return _ANONYMOUS.sub(lambda found: f"_:d{number}x{found[1]}" if found[1] else found.group(), axiom)


def _read(path: Path, shown: str) -> _Document:
    try:
        text = path.read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError:
        raise InputError.of("is no ontology: the file is not text in UTF-8", file=shown, mend=_NO_TEXT) from None
    except FileNotFoundError:
        raise InputError.of("the ontology file does not exist", file=shown, mend=_MISSING) from None
    except OSError as error:
        mend = "name an ontology file that may be read"
        raise InputError.of(f"the ontology can't be read: {error.strerror}", file=shown, mend=mend) from None
    if not text.strip():
        raise InputError.of("the ontology file is empty", file=shown, mend="write an ontology, or don't name the file")
    syntax = _syntax_of(text, path.suffix.lower())
    document = (
        _parse_rdf(text, syntax, path.as_uri(), shown) if syntax in ("ttl", "rdf") else _parse(text, syntax, shown)
    )
    if not document.axioms and not document.imports and document.iri is None:
        raise InputError.of(
            "is no ontology: it holds no axiom", file=shown, mend="write OWL, such as `:Robot a owl:Class .` in Turtle"
        )
    return document


def _syntax_of(text: str, suffix: str) -> str:
    lines = (line.strip() for line in text.splitlines())
    start = next((line for line in lines if line and not line.startswith("#")), "")
    if re.match(r"<\?xml|<!|<rdf:RDF|<Ontology\b", start):
        return "rdf" if "<rdf:RDF" in text else "owx" if "<Ontology" in text else EXTENSIONS.get(suffix, "rdf")
    if re.match(r"(Prefix|Ontology)\s*\(", start):
        return "ofn"
    if re.match(r"(Prefix|Ontology|Class|ObjectProperty|Individual):(\s|$)", start):
        return "omn"
    return "ttl" if EXTENSIONS.get(suffix) in (None, "rdf", "owx") else EXTENSIONS[suffix]


def _parse_rdf(text: str, syntax: str, base: str, shown: str) -> _Document:
    try:
        graph = Graph(text, syntax, base)
    except SyntaxError as error:
        name, (line, column) = _SYNTAX_NAMES[syntax], (error.lineno, error.offset)
        if line is None and syntax == "rdf":
            line, column = _xml_error_place(text)
        told = _PLACE.sub("", error.msg)
        message, mend = f"the ontology can't be read as {name}: {told}", f"write valid {name}"
        raise InputError([Fault(message, file=shown, line=line, column=column, mend=mend)]) from None
    document = _parse(graph.lossless(), "ttl", shown)
    axioms = [_ANONYMOUS_IRI.sub(r"_:\1", axiom) for axiom in (*document.axioms, *graph.axioms)]
    axioms = [axiom for axiom in axioms if not axiom.startswith("Declaration(NamedIndividual(_:")]
    return _Document(document.iri, document.imports, tuple(axioms), _prefixes_in(text))


def _prefixes_in(text: str) -> dict[str, str]:
    prefixes: dict[str, str] = {}
    for found in _PREFIX.finditer(text):
        prefix, namespace = (found[1], found[2]) if found[2] is not None else (found[3], found[4])
        prefixes.setdefault(prefix, namespace)
    return prefixes


def _parse(text: str, syntax: str, shown: str) -> _Document:
    import pyhornedowl

    try:
        parsed = pyhornedowl.open_ontology_from_string(text, syntax)  # type: ignore[arg-type]
    except (KeyboardInterrupt, SystemExit, MemoryError):
        raise
    except BaseException as error:  # a panic of the parser's native code is no Exception
        raise InputError([_fault_of(str(error), text, syntax, shown)]) from None
    axioms: list[str] = []
    imports: list[str] = []
    for component in parsed.get_axioms():
        axiom = str(component.component)
        keyword = axiom[: axiom.find("(")]
        if keyword in LOGICAL:
            axioms.append(axiom)
        elif keyword == "Import":
            imports.append(axiom[len("Import(") : -1].strip("<>"))
    prefixes = {prefix: namespace for prefix, namespace in parsed.prefix_mapping if prefix not in ("_", "xml")}
    iri = parsed.get_iri()
    return _Document(None if iri is None else str(iri), tuple(sorted(imports)), tuple(axioms), prefixes)


def _fault_of(error: str, text: str, syntax: str, shown: str) -> Fault:
    line = column = None
    found = _LINE.search(error)
    if found and found[1]:
        line, column = int(found[1]), int(found[2])
    elif found and int(found[3]):
        line = text.encode()[: int(found[3])].count(b"\n") + 1
    elif syntax == "owx":
        line, column = _xml_error_place(text)
    reason = _REASON.search(error)
    message = next(filter(None, reason.groups()), "") if reason else ""
    told = f": {message}" if message else ""
    name = _SYNTAX_NAMES[syntax]
    return Fault(
        f"the ontology can't be read as {name}{told}", file=shown, line=line, column=column, mend=f"write valid {name}"
    )


def _xml_error_place(text: str) -> tuple[int | None, int | None]:
    from xml.parsers import expat

    parser = expat.ParserCreate()
    try:
        parser.Parse(text.encode(), True)
    except expat.ExpatError as error:
        return error.lineno, error.offset + 1
    return None, None


def _imported_file(iri: str, importer: Path, read: dict[Path, _Document], listed: Iterable[Path]) -> Path | None:
    parts = urlsplit(iri)
    if parts.scheme in ("", "file"):
        path = importer.parent / unquote(parts.path)
        if path.is_file():
            return path.resolve()
    for path, document in read.items():
        if document.iri is not None and document.iri.rstrip("#/") == iri.rstrip("#/"):
            return path
    last = unquote(re.split(r"[#/:]", iri.rstrip("#/"))[-1])
    for name in (last, *(last + extension for extension in EXTENSIONS)):
        path = importer.parent / name
        if last and path.is_file() and path.resolve() != importer:
            return path.resolve()
    siblings = [path for path in sorted(importer.parent.iterdir()) if path.suffix.lower() in EXTENSIONS]
    for path in [*listed, *siblings]:
        if path.resolve() not in read and _declares(path, iri):
            return path.resolve()
    return None


def _declares(path: Path, iri: str) -> bool:
    try:
        return iri in path.read_text("utf-8-sig") and _read(path, str(path)).iri == iri
    except (OSError, UnicodeDecodeError, InputError):
        return False


def _relative(iri: str, importer: Path) -> str:
    return iri.removeprefix(importer.parent.as_uri() + "/")


def _relative_path(path: Path, folder: Path) -> Path:
    return path.relative_to(folder) if path.is_relative_to(folder) else path


def _line_with(path: Path, iri: str) -> int | None:
    wanted = _relative(iri, path)
    for number, line in enumerate(path.read_text("utf-8-sig").splitlines(), start=1):
        if wanted in line and "mport" in line:
            return number
    return None
