"""Reading ontology files in any of OWL's syntaxes, with the ontologies that they import."""

from __future__ import annotations

import io
import json
import os
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final
from urllib.parse import unquote, urlsplit

from cfgplan.arguments import checked, unsuitable
from cfgplan.errors import Fault, InputError, close_file
from cfgplan.file_content import content_of
from cfgplan.matching.catalog import catalogued
from cfgplan.matching.functional import LOGICAL, joined, parse, rule_text
from cfgplan.matching.names import short_name
from cfgplan.matching.ontology import Ontology
from cfgplan.matching.ontology_document import OntologyDocument, keep_document, kept_document, key_of
from cfgplan.matching.rdf import ANONYMOUS, Triple, TripleGraph, ontology_iri, restored

EXTENSIONS: Final = {
    ".ttl": "ttl", ".nt": "ttl", ".n3": "ttl", ".owl": "rdf", ".rdf": "rdf", ".xml": "rdf",
    ".jsonld": "jsonld", ".owx": "owx", ".ofn": "ofn", ".fss": "ofn", ".omn": "omn",
}  # fmt: skip
_SYNTAX_NAMES: Final = {
    "ttl": "Turtle", "rdf": "RDF/XML", "jsonld": "JSON-LD",
    "owx": "OWL/XML", "ofn": "functional syntax", "omn": "Manchester syntax",
}  # fmt: skip
_PREFIX: Final = re.compile(
    r"""(?:@prefix|\bPREFIX|^Prefix:)\s*([\w.-]*):\s*<([^<>]*)>|\bxmlns:([\w.-]+)\s*=\s*["']([^"']*)["']""",
    re.MULTILINE,
)
_MOST_REFUSED: Final = 20
"""An ontology with more axioms that make py-horned-owl refuse it is refused."""
_ANONYMOUS: Final = re.compile(r'"(?:[^"\\]|\\.)*"|<[^>]*>|_:([\w.-]+)')
_PLACE: Final = re.compile(r"^Parser error (?:at|between) [^:]*: ")
_ANONYMOUS_IRI: Final = re.compile(f"<{ANONYMOUS}([^>]*)>")
_LINE_OF_ERROR: Final = re.compile(r"line_col: Pos\(\((\d+), (\d+)\)\)|(?:BytePosition|ByteSpan)\((\d+)")
_REASON: Final = re.compile(
    r'message: "((?:[^"\\]|\\.)*)"|Msg\("((?:[^"\\]|\\.)*)"\)|(?:Validity)?Error\("((?:[^"\\]|\\.)*)"'
)

_TERM: Final = re.compile(r'(?:Iri\()?IRI\(\\*"([^"\\]+)\\*"\)\)?')
_DL_SAFE: Final = ("ofn", "owx")
"""The syntaxes whose rules are by definition about named individuals only; rules of others are about everything."""
_RULE: Final = "DLSafeRule("
_BUILT_INS: Final = "<http://www.w3.org/2003/11/swrlb#"
"""Manchester syntax does not tell built-ins from data properties."""
_NOT_TOLD: Final = "no reasoner gets its built-ins"

_MISSING = "check the path: in an environment file it is relative to that file, and web addresses are not fetched"
_NO_IMPORT = (
    "name its file in the environment file by `imports: {{{0}: file.ttl}}`, or ignore it by `imports: {{{0}: ignore}}`"
)
_NO_TEXT = "name a file in Turtle, RDF/XML, JSON-LD, OWL/XML, functional or Manchester syntax"


@checked
def load_ontology(
    paths: Sequence[str | os.PathLike[str]],
    imports: Mapping[str, str | os.PathLike[str] | None] | None = None,
    *,
    ignores_rules: bool = False,
    cache: Path | None = None,
) -> Ontology:
    """Return the union of ontology files and of everything they import; the open ontology if `paths` is empty.

    The content determines the syntax (Turtle, N-Triples, RDF/XML, JSON-LD, OWL/XML, functional, Manchester). An import
    is a relative path, a file beside the importing one that is named like the last part of the IRI or declares it, or
    one of `paths`. `imports` comes first: it maps an IRI to its file, or to None to ignore that import; "" mapped to
    None ignores every import that is not found. `ignores_rules` leaves all rules out. `cache` is a folder for files as
    they were read, which are kept between runs. Files in a syntax other than RDF are read completely except for
    annotations; statements in RDF that are no axioms of OWL 2 are in `Ontology.dropped`. Data ranges over several
    properties are refused. Raises InputError with every file that can't be used.
    """
    if not paths:
        return Ontology(is_open=True)
    documents: dict[Path, OntologyDocument] = {}
    own_iris: dict[Path, str | None] = {}
    ignored: set[str] = set()
    faults: list[Fault] = []
    shown = {Path(path).resolve(): os.fspath(path) or "." for path in paths}
    waiting = [Path(path).resolve() for path in reversed(paths)]
    given = {iri.rstrip("#/"): None if path is None else Path(path) for iri, path in (imports or {}).items()}
    while waiting:
        path = waiting.pop()
        if path in documents:
            continue
        try:
            document = documents[path] = _read(path, shown[path], cache)
        except InputError as error:
            faults.extend(error.faults)
            documents[path] = OntologyDocument()
            continue
        for iri in document.imports:
            written = iri.removeprefix(path.parent.as_uri() + "/")
            named = given.get(written.rstrip("#/"))
            if named is not None:
                shown.setdefault(named.resolve(), str(named))
                waiting.append(named.resolve())
                continue
            if written.rstrip("#/") in given:
                ignored.add(written)
                continue
            try:
                found = catalogued(path.parent).get(iri.rstrip("#/"))
            except InputError as error:
                faults.extend(fault for fault in error.faults if fault not in faults)
                continue
            listed = [p for p in shown if p not in documents]
            found = found or _imported_file(iri, path, documents, listed, own_iris)
            if found is None and "" not in given:
                message = f"the import <{written}> can't be found"
                faults.append(
                    Fault(message, file=shown[path], line=_line_with(path, written), mend=_NO_IMPORT.format(written))
                )
            elif found is None:
                ignored.add(written)
            elif found not in documents:
                beside = found.relative_to(path.parent) if found.is_relative_to(path.parent) else found
                shown.setdefault(found, str(Path(shown[path]).parent / beside))
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
    dropped = {text: why for document in documents.values() for text, why in document.dropped.items()}
    lost_rules = [
        (text, _with_own_anonymous(rule, number))
        for number, document in enumerate(documents.values())
        for text, rule in document.lost_rules
    ]
    rules = {axiom for axiom in axioms if axiom.startswith(_RULE)} | {rule for _, rule in lost_rules}
    if ignores_rules and rules:
        axioms = [axiom for axiom in axioms if axiom not in rules]
        dropped = {text: why for text, why in dropped.items() if text not in dict(lost_rules)}
        lost_rules = []
    known = [document.signature for document in documents.values() if document.signature is not None]
    is_known = len(known) == len(documents) and not (ignores_rules and rules)
    return Ontology(
        axioms,
        prefixes,
        files=documents,
        dropped=dropped,
        ignored=ignored,
        ignored_rules=len(rules) if ignores_rules else 0,
        lost_rules=lost_rules,
        signature=joined(known) if is_known else None,
    )


def read_owlready(onto: Any) -> Ontology:
    """Return the axioms that an `owlready2` ontology object, and those that it imports, have now.

    Later changes of the object have no effect. Raises InputError for axioms that can't be used.
    """
    if not any(kind.__module__ == "owlready2.namespace" and kind.__name__ == "Ontology" for kind in type(onto).__mro__):
        raise unsuitable("read_owlready()", "onto", "an owlready2 ontology", onto)
    axioms: list[str] = []
    dropped: dict[str, str] = {}
    lost_rules: list[tuple[str, str]] = []
    for number, part in enumerate(onto.indirectly_imported_ontologies()):
        written = io.BytesIO()
        part.save(written, format="rdfxml")
        shown = f"owlready2 ontology <{part.base_iri}>"
        document = _parse_rdf(written.getvalue().decode(), "rdf", part.base_iri, shown)
        axioms.extend(_with_own_anonymous(axiom, number) for axiom in document.axioms)
        dropped |= document.dropped
        lost_rules += [(text, _with_own_anonymous(rule, number)) for text, rule in document.lost_rules]
    return Ontology(axioms, dropped=dropped, lost_rules=lost_rules)


def _with_own_anonymous(axiom: str, number: int) -> str:
    """The axiom with its anonymous individuals renamed, so that no other document has the same ones."""
    if "_:" not in axiom:
        return axiom
    return _ANONYMOUS.sub(lambda found: f"_:d{number}x{found[1]}" if found[1] else found.group(), axiom)


def _read(path: Path, shown: str, cache: Path | None = None) -> OntologyDocument:
    """Read one file, or take its parsed form from the cache. Raises InputError."""
    try:
        content = content_of(path)
    except FileNotFoundError:
        close = close_file(path)
        mend = _MISSING if close is None else f"did you mean `{Path(shown).with_name(close.name)}`?"
        raise InputError.of("the ontology file does not exist", file=shown, mend=mend) from None
    except OSError as error:
        mend = "name an ontology file that may be read"
        raise InputError.of(f"the ontology can't be read: {error.strerror}", file=shown, mend=mend) from None
    if cache is None:
        return _document_of(content, path, shown)
    key = key_of(content, path, shown)
    document = kept_document(cache, key)
    return document or keep_document(cache, key, _document_of(content, path, shown))


def _document_of(content: bytes, path: Path, shown: str) -> OntologyDocument:
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise InputError.of("is not an ontology: the file is not text in UTF-8", file=shown, mend=_NO_TEXT) from None
    if not text.strip():
        raise InputError.of("the ontology file is empty", file=shown, mend="write an ontology, or don't name the file")
    syntax = _syntax_of(text, path.suffix.lower())
    document = (
        _parse_rdf(text, syntax, path.as_uri(), shown)
        if syntax in ("ttl", "rdf", "jsonld")
        else _parse(text, syntax, shown)
    )
    if not document.axioms and not document.imports and document.iri is None:
        raise InputError.of(
            "is not an ontology: it has no axioms",
            file=shown,
            mend="write OWL, such as `:Robot a owl:Class .` in Turtle",
        )
    return document


_USUAL_NAMESPACES = {
    "owl": "<http://www.w3.org/2002/07/owl#>",
    "rdf": "<http://www.w3.org/1999/02/22-rdf-syntax-ns#>",
    "rdfs": "<http://www.w3.org/2000/01/rdf-schema#>",
    "xsd": "<http://www.w3.org/2001/XMLSchema#>",
}


def _usual_namespace(prefix: str) -> str:
    """The namespace that a prefix usually stands for, or one to be replaced."""
    return _USUAL_NAMESPACES.get(prefix, f"<http://example.org/{prefix}#>")


def _syntax_of(text: str, suffix: str) -> str:
    lines = (line.strip() for line in text.splitlines())
    start = next((line for line in lines if line and not line.startswith("#")), "")
    if re.match(r"<\?xml|<!|<rdf:RDF|<Ontology\b", start):
        return "rdf" if "<rdf:RDF" in text else "owx" if "<Ontology" in text else EXTENSIONS.get(suffix, "rdf")
    if re.match(r"\s*(\[\s*)?\{", text):
        return "jsonld"
    if re.match(r"(Prefix|Ontology)\s*\(", start):
        return "ofn"
    if re.match(r"(Prefix|Ontology|Class|ObjectProperty|Individual):(\s|$)", start):
        return "omn"
    return "ttl" if EXTENSIONS.get(suffix) in (None, "rdf", "owx", "jsonld") else EXTENSIONS[suffix]


def _parse_rdf(text: str, syntax: str, base: str, shown: str) -> OntologyDocument:
    try:
        graph = TripleGraph(text, syntax, base)
    except SyntaxError as error:
        name, (line, column) = _SYNTAX_NAMES[syntax], (error.lineno, error.offset)
        if line is None and syntax == "rdf":
            line, column = _xml_error_place(text)
        told = _PLACE.sub("", error.msg)
        message, mend = f"the ontology can't be read as {name}: {told}", f"write valid {name}"
        if undeclared := re.search(r"[Pp]refix (\S*): has not been declared", told):
            mend = f"declare it above: `@prefix {undeclared[1]}: {_usual_namespace(undeclared[1])} .`"
        if Path(shown).suffix in (".yaml", ".yml"):
            mend = "name an ontology: this file is not in Turtle, RDF/XML, JSON-LD or another syntax of OWL"
        if "LoadDocument" in told:
            message = f"the ontology can't be read as {name}: its `@context` is another document"
            mend = "write the `@context` into the file: web addresses are not fetched"
        raise InputError([Fault(message, file=shown, line=line, column=column, mend=mend)]) from None
    parsed = _parsed_graph(graph, text, syntax, shown)
    components = [str(component.component) for component in parsed.get_components()]
    document = _document(parsed, components, syntax, shown)
    unread = {f"{said} in {Path(shown).name}": "that is not an axiom of OWL 2" for said in graph.unread(components)}
    said = filter(None, map(restored, (*document.axioms, *graph.axioms)))
    axioms = [_ANONYMOUS_IRI.sub(r"_:\1", axiom) for axiom in said]
    axioms = [axiom for axiom in axioms if not axiom.startswith("Declaration(NamedIndividual(_:")]
    dropped = {**document.dropped, **unread}
    return replace(document, axioms=tuple(axioms), prefixes=_prefixes_in(text, syntax), dropped=dropped)


def _parsed_graph(graph: TripleGraph, text: str, syntax: str, shown: str) -> Any:
    """py-horned-owl's reading of a graph, without the axioms for which it would refuse the whole, which are told."""
    try:
        return _parsed(graph.lossless(), "ttl", text, syntax, shown)
    except InputError as error:
        refusal = error
    kept: list[list[Triple]] = []
    lost: list[list[Triple]] = []
    waiting = [graph.parts()]
    while waiting:
        parts = waiting.pop()
        try:
            _parsed(graph.text_of([*kept, *parts]), "ttl", text, syntax, shown)
        except InputError:
            if len(parts) == 1:
                lost += parts
            else:
                waiting += [parts[len(parts) // 2 :], parts[: len(parts) // 2]]
            if len(lost) > _MOST_REFUSED:
                raise refusal from None
        else:
            kept += parts
    graph.leave_out(lost, kept)
    return _parsed(graph.text_of(kept), "ttl", text, syntax, shown)


def _prefixes_in(text: str, syntax: str) -> dict[str, str]:
    if syntax == "jsonld":
        return dict(_prefixes_of_context(json.loads(text)))
    prefixes: dict[str, str] = {}
    for found in _PREFIX.finditer(text):
        prefix, namespace = (found[1], found[2]) if found[2] is not None else (found[3], found[4])
        prefixes.setdefault(prefix, namespace)
    return prefixes


def _prefixes_of_context(data: object) -> Iterator[tuple[str, str]]:
    context = data.get("@context") if isinstance(data, dict) else None
    for part in context if isinstance(context, list) else [context]:
        for name, value in part.items() if isinstance(part, dict) else ():
            if isinstance(value, str) and value.endswith(("#", "/", ":")):
                yield "" if name == "@vocab" else name, value


def _parse(text: str, syntax: str, shown: str) -> OntologyDocument:
    parsed = _parsed(text, syntax, text, syntax, shown)
    prefixes = {prefix: namespace for prefix, namespace in parsed.prefix_mapping if prefix not in ("_", "xml")}
    components = [str(component.component) for component in parsed.get_components()]
    return replace(_document(parsed, components, syntax, shown), prefixes=prefixes)


def _parsed(rewritten: str, form: str, text: str, syntax: str, shown: str) -> Any:
    """py-horned-owl's reading of a document as it was rewritten. Raises InputError with a place in the text itself."""
    import pyhornedowl

    try:
        return pyhornedowl.open_ontology_from_string(rewritten, form)  # type: ignore[arg-type]
    except (KeyboardInterrupt, SystemExit, MemoryError):
        raise
    except BaseException as error:  # a panic of the parser's native code is no Exception
        raise InputError([_fault_of(str(error), text, syntax, shown)]) from None


def _document(parsed: Any, components: Iterable[str], syntax: str, shown: str) -> OntologyDocument:
    axioms: list[str] = []
    imports: list[str] = []
    dropped: dict[str, str] = {}
    lost_rules: list[tuple[str, str]] = []
    for component in components:
        keyword = component[: component.find("(")]
        if keyword == "DLSafeRule":
            why = _loss_of_rule(component, syntax)
            if why:
                text = f"the rule {rule_text(parse(component))} in {Path(shown).name}"
                dropped[text] = why
                lost_rules.append((text, component))
            if why != _NOT_TOLD:
                axioms.append(component)
        elif keyword in LOGICAL:
            axioms.append(component)
        elif keyword == "Import":
            imports.append(component[len("Import(") : -1].strip("<>"))
    iri = parsed.get_iri()
    return OntologyDocument(
        None if iri is None else str(iri),
        tuple(sorted(imports)),
        tuple(axioms),
        dropped=MappingProxyType(dropped),
        lost_rules=tuple(lost_rules),
    )


def _loss_of_rule(rule: str, syntax: str) -> str | None:
    """Return the part of a rule that reasoners do not get, in words; None if they get all of it."""
    if "BuiltInAtom(" in rule or "DataRangeAtom(" in rule or _BUILT_INS in rule:
        return _NOT_TOLD
    return None if syntax in _DL_SAFE else "it is applied to named individuals only"


def _fault_of(error: str, text: str, syntax: str, shown: str) -> Fault:
    line = column = None
    found = _LINE_OF_ERROR.search(error)
    if found and found[1]:
        line, column = int(found[1]), int(found[2])
    elif found and int(found[3]):
        line = text.encode()[: int(found[3])].count(b"\n") + 1
    elif syntax == "owx":
        line, column = _xml_error_place(text)
    else:
        line = _first_line_with(text, _TERM.findall(error))
    reason = _REASON.search(error)
    message = next(filter(None, reason.groups()), "") if reason else ""
    told = ": " + _TERM.sub(r"<\1>", message) if message else ""
    name = _SYNTAX_NAMES[syntax]
    return Fault(
        f"the ontology can't be read as {name}{told}", file=shown, line=line, column=column, mend=f"write valid {name}"
    )


def _first_line_with(text: str, iris: Iterable[str]) -> int | None:
    """The line of the first of some IRIs that the text mentions, in full or by its short name; None if none is."""
    lines = text.splitlines()
    for name in (name for iri in iris for name in (f"<{iri}>", f'"{iri}"', short_name(iri))):
        found = next((number for number, line in enumerate(lines, start=1) if name in line), None)
        if found is not None:
            return found
    return None


def _xml_error_place(text: str) -> tuple[int | None, int | None]:
    from xml.parsers import expat

    parser = expat.ParserCreate()
    try:
        parser.Parse(text.encode(), True)
    except expat.ExpatError as error:
        return error.lineno, error.offset + 1
    except LookupError:  # Python does not know the encoding that the first line names
        return 1, None
    return None, None


def _imported_file(
    iri: str,
    importer: Path,
    read: dict[Path, OntologyDocument],
    listed: Iterable[Path],
    own_iris: dict[Path, str | None],
) -> Path | None:
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
        if path.resolve() not in read and _declares(path.resolve(), iri, own_iris):
            return path.resolve()
    return None


def _declares(path: Path, iri: str, own_iris: dict[Path, str | None]) -> bool:
    """Whether a file is the ontology of an IRI. `own_iris` keeps what files call themselves."""
    if path not in own_iris:
        try:
            text = content_of(path).decode("utf-8-sig")
            if iri not in text:
                return False
            syntax = _syntax_of(text, path.suffix.lower())
            is_rdf = syntax in ("ttl", "rdf", "jsonld")
            own_iris[path] = ontology_iri(text, syntax, path.as_uri()) if is_rdf else _read(path, str(path)).iri
        except (OSError, UnicodeDecodeError, SyntaxError, InputError):
            own_iris[path] = None
    return own_iris[path] == iri


def _line_with(path: Path, wanted: str) -> int | None:
    """The line of an import: the first that mentions it, preferably as an import; None if none does."""
    lines = [*enumerate(path.read_text("utf-8-sig").splitlines(), start=1)]
    found = [(number, line) for number, line in lines if wanted in line]
    return next((number for number, line in found if "mport" in line), found[0][0] if found else None)
