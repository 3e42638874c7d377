"""Evaluate expressions of C++ source from their tokens: strings that name ports, and node handles with a namespace."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence

from cfgplan.ros.code.code_ports import MOST_STEPS, CodeName, Parameter
from cfgplan.ros.code.cpp_tokens import CppFile
from cfgplan.ros.code.cpp_values import (
    LONGEST,
    CppValues,
    Found,
    arguments_at_end,
    bare,
    call_at,
    receiver_before,
    split,
)

_HANDLES = {
    "getNodeHandle": "",
    "getMTNodeHandle": "",
    "getPrivateNodeHandle": "~",
    "getMTPrivateNodeHandle": "~",
    "shared_from_this": "",
    "get_node_handle": "",
    "this": "",
}
_CLASSES = ("NodeHandle", "NodeHandlePtr", "Node", "LifecycleNode")
"""Classes of handles and nodes."""
_PRIVATE = re.compile(r"priv|pnh|^pn_?$|local_n|^n_?p(riv)?_?$|_p$", re.IGNORECASE)
"""Names of parameters of functions that are private handles."""
_READ = ("param", "getParam", "get_parameter", "get_parameter_or", "declare_parameter", "get", "getParamCached")


class CppExpressions:
    """The expressions in the files of one node."""

    def __init__(self, files: Sequence[CppFile], values: CppValues) -> None:
        self._files, self._values = files, values

    # Handles

    def is_handle(self, file: CppFile, places: range) -> bool:
        """Whether an expression is a handle or an image transport."""
        return self.namespace(file, places, 0) is not None or self.transport(file, places) is not None

    def transport(self, file: CppFile, places: range) -> tuple[str | None] | None:
        """The namespace of an image transport, as a tuple of one (None if computed); None if it is no transport."""
        places = bare(file, places)
        words = [file.word(at) for at in places]
        if "ImageTransport" in words:
            arguments = arguments_at_end(file, places)
            return (self.namespace(file, arguments[0], 0),) if arguments else None
        if len(places) != 1 or not words[0]:
            return None
        found = set[str | None]()
        for other in self._files:
            for at in other.places.get("ImageTransport", ()):
                if other.sign(at + 1) in ("*", "&", ">"):
                    named, after = other.word(at + 2), at + 2
                else:
                    named, after = other.word(at + 1), at + 1
                if named != words[0]:
                    continue
                made = [] if other.sign(after + 1) not in ("(", "{") else [(other, other.arguments(after + 1) or [])]
                if not made:
                    made = [(each.file, [each.value]) for each in self._values.of(words[0]) if each.value is not None]
                for each, arguments in made:
                    if not arguments:
                        continue
                    inner = self._transport_argument(each, arguments[0])
                    found.add(self.namespace(each, inner, 0))
                if not made:
                    found.add("")
        return (found.pop() if len(found) == 1 else None,) if found else None

    def _transport_argument(self, file: CppFile, places: range) -> range:
        words = [file.word(at) for at in places]
        if "ImageTransport" in words:
            return (arguments_at_end(file, bare(file, places)) or [places])[0]
        return places

    def namespace(self, file: CppFile, places: range, steps: int) -> str | None:
        """The namespace of the handle that an expression is; None if it is none, or computed."""
        places = bare(file, places)
        if not len(places) or steps > MOST_STEPS or len(places) > LONGEST:
            return None
        last = file.word(places.stop - 1)
        if len(places) == 1 or file.sign(places.stop - 2) in (".", "->", "::"):
            if last in _HANDLES or last == "NodeHandle":
                return _HANDLES.get(last, "")
            return self._followed(file, places.stop - 1, last, steps, self._namespace_of_found)
        arguments = arguments_at_end(file, places)
        if arguments is None:
            return None
        begin = file.partner(places.stop - 1) or 0
        word = file.word(begin - 1)
        if word in _HANDLES:
            return _HANDLES[word]
        if word == "NodeHandle" or any(file.word(at) == "NodeHandle" for at in range(places.start, begin)):
            return self._handle_of(file, arguments, steps)
        return None

    def _handle_of(self, file: CppFile, arguments: Sequence[range], steps: int) -> str | None:
        """The namespace of a handle that is made of these arguments."""
        match arguments:
            case []:
                return ""
            case [only]:
                name = self.name(file, only, steps + 1)
                return self.namespace(file, only, steps + 1) if name is None else _plain(name)
            case [parent, child, *_]:
                above, name = self.namespace(file, parent, steps + 1), self.name(file, child, steps + 1)
                below = None if name is None else _plain(name)
                if above is None or below is None:
                    return _plain(self.name(file, parent, steps + 1) or ("\0",)) if below is None else None
                return f"{above}/{below}".strip("/") if below else above
        return None

    def _is_declared_handle(self, word: str) -> bool:
        """Whether a variable, member or parameter of this name is declared to be a handle or a node anywhere."""
        return any(_is_handle_at(file, at) for file in self._files for at in file.places.get(word, ()))

    def _namespace_of_found(self, found: Found, steps: int) -> str | None:
        word = found.file.tokens[found.at].text
        if not self._is_declared_handle(word):
            return None
        if found.parameter is not None:
            calls = self._values.calls(*found.parameter)
            told = {self.namespace(file, places, steps + 1) for file, places in calls}
            if len(told) == 1 and None not in told:
                return told.pop()
            if len(told - {None}) > 1:
                return None
            return "~" if _PRIVATE.search(word) else ""
        if not found.value:
            return ""
        arguments = (
            found.file.arguments(found.value.start - 1) if found.file.sign(found.value.start - 1) == "(" else None
        )
        return self._handle_of(found.file, arguments if arguments is not None else [found.value], steps + 1)

    def _followed(
        self, file: CppFile, at: int, word: str, steps: int, meaning: Callable[[Found, int], str | None]
    ) -> str | None:
        """The one meaning of all values of a word at a place; None if they differ."""
        if not word or steps > MOST_STEPS:
            return None
        near = self._values.nearest(file, at, word)
        told = {meaning(each, steps + 1) for each in near}
        if len(told) == 1:
            return told.pop()
        return None

    # Names

    def name(self, file: CppFile, places: range, steps: int) -> CodeName | None:
        """The parts of a text that an expression makes; None if it is computed."""
        places = bare(file, places)
        if not len(places) or steps > MOST_STEPS or len(places) > LONGEST:
            return None
        pieces = split(file, places, "+")
        if len(pieces) > 1:
            parts = [self.name(file, piece, steps + 1) for piece in pieces]
            return None if None in parts else tuple(one for part in parts for one in part or ())
        if all(file.tokens[at].kind == "text" for at in places):
            return ("".join(file.tokens[at].text for at in places),)
        last = file.word(places.stop - 1)
        if last and all(file.word(at) or file.sign(at) in ("::", "->", ".") for at in places):
            if file.sign(places.stop - 2) in (".", "->") and file.word(places.stop - 3) != "this":
                return self._of_member(last, steps)
            return self._variable(file, places.stop - 1, last, steps)
        arguments = arguments_at_end(file, places)
        begin = file.partner(places.stop - 1) if arguments is not None else None
        if arguments is None or begin is None:
            return None
        word = file.word(begin - 1)
        if word in ("string", "c_str", "str", "String"):
            if word == "string" and len(arguments) == 1:
                return self.name(file, arguments[0], steps + 1)
            if word == "c_str" and file.sign(begin - 2) == ".":
                return self.name(file, range(places.start, begin - 2), steps + 1)
            return None
        if word in ("as_string", "get_value", "get") or file.sign(begin - 1) == ">":
            inner = self._behind(file, begin)
            if inner is not None and file.sign(inner) in (".", "->") and inner > places.start:
                return self.name(file, range(places.start, inner), steps + 1)
        return self._read_parameter(file, begin, arguments, steps)

    @staticmethod
    def _behind(file: CppFile, begin: int) -> int | None:
        """The place of the `.` in `x.get_value<T>(`, whose bracket is at a place."""
        at = begin - 1
        if file.sign(at) == ">":
            while at > 0 and file.sign(at) != "<":
                at -= 1
            at -= 1
        return at - 1 if file.word(at) in ("as_string", "get_value", "get") else None

    def _of_member(self, word: str, steps: int) -> CodeName | None:
        """The text of a member of another object: the only one that any object's member of that name has."""
        texts = {self._value_name(each, steps + 1) for each in self._values.of(word) if each.value is not None}
        return texts.pop() if len(texts) == 1 else None

    def _variable(self, file: CppFile, at: int, word: str, steps: int) -> CodeName | None:
        macros = {each.macros[word] for each in self._files if word in each.macros}
        if macros:
            return (macros.pop(),) if len(macros) == 1 else None
        near = self._values.nearest(file, at, word)
        if any(each.parameter is not None for each in near):
            return self._given(near, steps)
        read = self._filled(file, at, word, steps)
        if read is not None:
            values = [each for each in near if each.value is not None]
            is_changed = any(each.file.word(place) == word for each in values for place in each.value or ())
            return None if is_changed or len(values) > 1 else read
        texts = {self._value_name(each, steps + 1) for each in near}
        return texts.pop() if len(texts) == 1 else None

    def _given(self, near: Sequence[Found], steps: int) -> CodeName | None:
        """The text that every call gives for a function's parameter."""
        spots = [spot for each in near if each.parameter for spot in self._values.calls(*each.parameter)]
        texts = {self.name(*spot, steps + 1) for spot in spots}
        return texts.pop() if len(texts) == 1 else None

    def _value_name(self, found: Found, steps: int) -> CodeName | None:
        return None if found.value is None else self.name(found.file, found.value, steps + 1)

    def _filled(self, file: CppFile, at: int, word: str, steps: int) -> CodeName | None:
        """The parameter that a call reads into a variable: `nh.param("name", variable, default)`."""
        found = set[CodeName]()
        local = any(each.file is file and not each.is_member for each in self._values.nearest(file, at, word))
        for other in [file] if local else self._files:
            for use in other.places.get(word, ()):
                call = self._enclosing_call(other, use)
                if call is None:
                    continue
                begin, arguments = call
                if len(arguments) > 1 and use == arguments[1].stop - 1 and len(arguments[1]) <= 3:
                    read = self._read_parameter(other, begin, arguments, steps, word)
                    if read is not None:
                        found.add(read)
        return found.pop() if len(found) == 1 else None

    @staticmethod
    def _enclosing_call(file: CppFile, at: int) -> tuple[int, list[range]] | None:
        for begin in range(at - 1, max(at - 40, -1), -1):
            if file.sign(begin) in (";", "{", "}"):
                return None
            if file.sign(begin) == "(" and (file.partner(begin) or 0) > at:
                arguments = file.arguments(begin)
                return None if arguments is None else (begin, arguments)
        return None

    def _read_parameter(
        self, file: CppFile, begin: int, arguments: Sequence[range], steps: int, into: str = ""
    ) -> CodeName | None:
        """The parameter that a call reads, whose bracket is at a place."""
        at = begin - 1
        if file.sign(at) == ">":
            while at > 0 and file.sign(at) != "<":
                at -= 1
            at -= 1
        method = file.word(at)
        if method not in _READ or not arguments or (method == "get" and file.word(at - 2) != "param"):
            return None
        name = self.name(file, arguments[0], steps + 1)
        if name is None or not isinstance(name[0], str) or len(name) != 1:
            return None
        is_ros2 = method in ("get_parameter", "get_parameter_or", "declare_parameter")
        rest = arguments[2:] if into else arguments[1:]
        default = self.name(file, rest[0], steps + 1) if rest and method not in ("getParam", "get") else None
        text = default[0] if default and len(default) == 1 and isinstance(default[0], str) else None
        if rest and text is None and not is_ros2 and method == "param":
            return None
        if is_ros2:
            return (Parameter(f"~{name[0]}", text if text is not None else self._declared(name[0], steps)),)
        if into and text is None:
            text = self._initial(into, steps)
        if file.sign(at - 1) == "::":
            return (Parameter(name[0], text),)
        namespace = self.namespace(file, receiver_before(file, at - 2), steps + 1)
        if namespace is None:
            return None
        inside = name[0] if name[0].startswith(("/", "~")) or not namespace else f"{namespace}/{name[0]}"
        return (Parameter(inside, text),)

    def _initial(self, word: str, steps: int) -> str | None:
        """The only text that a variable has before a parameter is read into it."""
        texts = {self._value_name(each, steps + 1) for each in self._values.of(word) if each.value is not None}
        name = texts.pop() if len(texts) == 1 else None
        return name[0] if name and len(name) == 1 and isinstance(name[0], str) else None

    def _declared(self, name: str, steps: int) -> str | None:
        """The default of a declared parameter."""
        texts = set[str | None]()
        for file in self._files:
            for at in file.places.get("declare_parameter", ()):
                call = call_at(file, at)
                if call is not None and len(call[1]) > 1 and self.name(file, call[1][0], steps + 1) == (name,):
                    text = self.name(file, call[1][1], steps + 1)
                    texts.add(text[0] if text and len(text) == 1 and isinstance(text[0], str) else None)
        return texts.pop() if len(texts) == 1 else None


def _plain(name: CodeName) -> str | None:
    return name[0] if len(name) == 1 and isinstance(name[0], str) and name[0] != "\0" else None


def _is_handle_at(file: CppFile, at: int) -> bool:
    """Whether a word is declared as a handle at a place: behind its class, or behind another one of that."""
    before = at - 1
    while file.sign(before) in ("&", "*", ">") or file.word(before) == "const":
        before -= 1
    if file.word(before) in ("Ptr", "SharedPtr") and file.sign(before - 1) == "::":
        before -= 2
    if file.word(before) in _CLASSES:
        return True
    return file.sign(at - 1) == "," and bool(file.word(at - 2)) and file.word(at - 3) in _CLASSES
