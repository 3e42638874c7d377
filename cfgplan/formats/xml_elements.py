"""XML as a tree of elements that know their places.

Document types are refused outright, and with them every entity that could expand or reach outside: the remaining XML
can't blow up.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NoReturn
from xml.parsers import expat

from cfgplan.canonical import normal
from cfgplan.errors import Fault, InputError
from cfgplan.formats.places import DEEPEST_NESTING, Spot

XML_BLANK = " \t\r\n"
_XML_MENDS = {
    expat.errors.XML_ERROR_JUNK_AFTER_DOC_ELEMENT: "wrap several elements into one, such as <environment>",
    expat.errors.XML_ERROR_TAG_MISMATCH: "close the elements in the order in which they were opened",
    expat.errors.XML_ERROR_UNDEFINED_ENTITY: "write &amp; for &, and &lt; for <",
    expat.errors.XML_ERROR_UNKNOWN_ENCODING: "save the file in the encoding UTF-8",
    expat.errors.XML_ERROR_NO_ELEMENTS: "write a <transformation> or a <target>",
}


@dataclass(slots=True)
class XmlElement:
    """One element; `text` is without the blanks around it unless it has `xml:space="preserve"`."""

    name: str
    attributes: dict[str, str]
    line: int
    column: int
    children: list[XmlElement] = field(default_factory=list)
    pieces: list[tuple[str, int, int]] = field(default_factory=list)
    text: str = ""

    def __iter__(self) -> Iterator[XmlElement]:
        """Yield this element and all elements inside it, in the order of the text."""
        yield self
        for child in self.children:
            yield from child

    def close(self) -> None:
        """Join the pieces of the text after the last one."""
        whole = "".join([piece for piece, _, _ in self.pieces])
        self.text = whole if self.attributes.get("xml:space") == "preserve" else whole.strip(XML_BLANK)

    @property
    def spot(self) -> Spot:
        """Where the element begins."""
        return Spot(self.line, self.column)

    @property
    def text_spot(self) -> Spot:
        """Where the text begins, or the element if it has none."""
        written = [
            (p.lstrip(XML_BLANK), line, column + len(p) - len(p.lstrip(XML_BLANK))) for p, line, column in self.pieces
        ]
        written = [piece for piece in written if piece[0]]
        if not written:
            return Spot(self.line, self.column, "")
        first, line, column = written[0]
        return Spot(line, column, self.text, column if first.rstrip(XML_BLANK) == self.text else None)


def parse_xml(content: bytes, file: str) -> XmlElement:
    """The root element of an XML text; raises InputError."""
    if not content.strip():
        raise InputError.of("the file is empty", file=file, mend="write the XML it should hold")
    opened: list[XmlElement] = []
    roots: list[XmlElement] = []
    parser = expat.ParserCreate()

    def place() -> tuple[int, int]:
        return parser.CurrentLineNumber, parser.CurrentColumnNumber + 1

    def stop(message: str, mend: str) -> NoReturn:
        raise InputError([Fault(message, file, *place(), mend=mend)])

    def start(name: str, attributes: dict[str, str]) -> None:
        if len(opened) >= DEEPEST_NESTING:
            stop(f"elements are nested more than {DEEPEST_NESTING} deep", "flatten the document")
        element = XmlElement(name, {key: normal(value) for key, value in attributes.items()}, *place())
        (opened[-1].children if opened else roots).append(element)
        opened.append(element)

    def refuse_doctype(*_: object) -> None:
        stop("a document type is declared", "remove the line <!DOCTYPE ...>: entities are not supported")

    parser.StartDoctypeDeclHandler = refuse_doctype
    parser.StartElementHandler = start
    parser.EndElementHandler = lambda _: opened.pop().close()
    parser.CharacterDataHandler = lambda piece: opened[-1].pieces.append((piece, *place()))
    try:
        parser.Parse(content, True)
    except expat.ExpatError as error:
        message = expat.ErrorString(error.code)
        mend = _XML_MENDS.get(message, "mend the markup here")
        fault = Fault(f"this is not XML: {message}", file, error.lineno, error.offset + 1, mend=mend)
        raise InputError([fault]) from None
    except (LookupError, ValueError) as error:
        # An encoding that Python does not know, or one with several bytes a character.
        raise InputError.of(f"this is not XML: {error}", file=file, mend="save it as UTF-8") from None
    return roots[0]
