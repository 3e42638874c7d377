"""JSON text to plain data: numbers exact, repeated keys refused, positions on demand."""

from __future__ import annotations

import json
import re
from bisect import bisect_right
from collections import deque
from collections.abc import Iterator
from decimal import Decimal
from typing import Any

from cfgplan.canonical import normal
from cfgplan.errors import Fault, InputError
from cfgplan.formats.places import DEEPEST_NESTING, Path, Source, Spot, has_no_dollar
from cfgplan.formats.scalars import resolve

_JSON_TOKEN = re.compile(r'\s*("(?:[^"\\]|\\.)*"|[^\s"\[\]{},:]+|[\[\]{},:])')

_MENDS = {
    "Expecting property name": "put the key in double quotes, or remove the comma before",
    "Illegal trailing comma": "remove the comma",
    "',' delimiter": "put a comma between two values, or close what is open",
    "':' delimiter": "put a colon between key and value",
    "Expecting value": "write a value, with text in double quotes, or remove the comma before",
    "Extra data": "keep one value in a file",
    "Unterminated string": 'close the text with "',
    "Invalid control character": "write it as an escape, such as \\n, or close the text before it",
    "Invalid \\escape": "write a backslash twice",
}


def read_json(text: str, file: str, made_by: str | None = None) -> Source:
    """Read one JSON document; raises InputError if it can't be read to the end.

    `made_by` is the command that writes such files; the mend names it if the text does not even begin as JSON.
    """
    repeats: list[str] = []

    def mapping(pairs: list[tuple[str, object]]) -> dict[str, object]:
        pairs = [(normal(key), value) for key, value in pairs]
        values = dict(pairs)
        if len(values) != len(pairs):
            repeats.extend(key for key in values if sum(key == other for other, _ in pairs) > 1)
        return values

    if not text.strip():
        raise InputError.of("the file is empty", file=file, mend="write the JSON it should hold")
    try:
        data = json.loads(
            text, object_pairs_hook=mapping, parse_float=Decimal, parse_int=resolve, parse_constant=Decimal
        )
    except json.JSONDecodeError as error:
        mend = next((mend for part, mend in _MENDS.items() if part in error.msg), "mend the syntax here")
        if made_by is not None and not text[: error.pos].strip():
            mend = f"name a file that {made_by} has written"
        fault = Fault(f"this is not JSON: {error.msg}", file, error.lineno, error.colno, mend=mend)
        raise InputError([fault]) from None
    except RecursionError:
        raise _too_deep(file) from None
    _refuse_odd_values(data, file)
    locator = _JsonLocator(text)
    faults = [
        Fault(f"the key `{key}` occurs twice", file, spot.line, spot.column, mend="remove one of the two")
        for key, spot in (locator.repeated_keys() if repeats else ())
    ]
    return Source(file, data, locator, tuple(faults), has_no_dollar(text))


def _too_deep(file: str) -> InputError:
    return InputError.of(f"values are nested more than {DEEPEST_NESTING} deep", file=file, mend="flatten the document")


def _refuse_odd_values(data: object, file: str) -> None:
    layer: list[object] = [data]
    for _ in range(DEEPEST_NESTING + 1):
        texts = [value for value in layer if isinstance(value, str)]
        below: list[object] = []
        for value in layer:
            if isinstance(value, dict):
                texts += value
                below += value.values()
            elif isinstance(value, list):
                below += value
        try:
            "".join(texts).encode()
        except UnicodeEncodeError:
            raise InputError.of("a text has half of a surrogate pair", file=file, mend="mend its \\u escapes") from None
        if not below:
            return
        layer = below
    raise _too_deep(file)


class _Span:
    """A value's place in the text, and its children with the places of their keys."""

    __slots__ = ("children", "end", "start")

    def __init__(self, start: int, end: int) -> None:
        self.start = start
        self.end = end
        self.children: list[tuple[str | int, _Span, _Span]] = []


class _JsonLocator:
    """Finds spots in a JSON text that is known to be well-formed."""

    def __init__(self, text: str) -> None:
        self._text = text
        self._root: _Span | None = None
        self._line_starts = [0]

    def __call__(self, path: Path, at_key: bool) -> Spot:
        node = self._tree()
        for number, step in enumerate(path, start=1):
            if isinstance(step, int):
                found = node.children[step] if step < len(node.children) else None
            else:
                found = next((child for child in reversed(node.children) if child[0] == step), None)
            if found is None:
                break
            node = found[1] if at_key and isinstance(step, str) and number == len(path) else found[2]
        return self._spot(node)

    def repeated_keys(self) -> Iterator[tuple[str, Spot]]:
        """Every repeated key of a mapping, with the place of the repetition."""
        ahead = deque([self._tree()])
        while ahead:
            node = ahead.popleft()
            seen: set[str | int] = set()
            for step, key, value in node.children:
                if step in seen:
                    yield str(step), self._spot(key)
                seen.add(step)
                ahead.append(value)

    def _spot(self, node: _Span) -> Spot:
        line = bisect_right(self._line_starts, node.start)
        column = node.start - self._line_starts[line - 1] + 1
        written = self._text[node.start : node.end]
        if written.startswith('"'):
            value = json.loads(written)
            return Spot(line, column, value, column + 1 if value == written[1:-1] else None)
        return Spot(line, column, written, column) if not node.children else Spot(line, column)

    def _tree(self) -> _Span:
        if self._root is None:
            tokens = ((m.group(1), m.start(1), m.end(1)) for m in _JSON_TOKEN.finditer(self._text))
            self._root = _value(tokens, next(tokens))
            self._line_starts += (found.end() for found in re.finditer("\n", self._text))
        return self._root


def _value(tokens: Iterator[tuple[str, int, int]], token: tuple[str, int, int]) -> _Span:
    text, start, end = token
    node = _Span(start, end)
    if text not in ("[", "{"):
        return node
    token = next(tokens)
    while token[0] not in ("]", "}"):
        step: Any = len(node.children)
        key = _Span(token[1], token[2])
        if text == "{":
            step = normal(json.loads(token[0]))
            next(tokens)
            token = next(tokens)
        node.children.append((step, key, _value(tokens, token)))
        token = next(tokens)
        if token[0] == ",":
            token = next(tokens)
    return node
