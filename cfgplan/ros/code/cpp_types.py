"""The message types that C++ source spells: in full, by an alias, by what a file includes, or by a callback."""

from __future__ import annotations

import re
from collections.abc import Sequence

from cfgplan.ros.code.code_ports import type_of
from cfgplan.ros.code.cpp_tokens import CppFile
from cfgplan.ros.code.cpp_values import until_end
from cfgplan.ros.types import MessageType, TypeKind

_POINTER = re.compile(r"(?:::)?(?:Const)?(?:Ptr|SharedPtr|UniquePtr|ConstSharedPtr|ConstPtr)$")


class CppTypes:
    """The types in the files of one node."""

    def __init__(self, files: Sequence[CppFile]) -> None:
        self._files = files

    def of_template(self, file: CppFile, places: range | None, kind: TypeKind) -> MessageType | None:
        if places is None or not len(places):
            return None
        comma = next((at for at in places if file.sign(at) == ","), places.stop)
        return self._type(file, file.text(range(places.start, comma)), kind, 0)

    def _type(self, file: CppFile, text: str, kind: TypeKind, steps: int) -> MessageType | None:
        """The message type that a name of C++ spells: in full, by an alias, or by what the file includes."""
        name = re.sub(r"^(const|typename)(?=[\W]|[a-z]+_msgs)", "", text).removeprefix("::")
        wrapped = re.fullmatch(
            r"(?:\w+::)*(?:shared_ptr|MessageEvent|unique_ptr|SharedPtr)<(?:const)?(.*?)(?:const)?>", name
        )
        name = wrapped[1] if wrapped else name
        if name.startswith("pcl::PointCloud<"):
            return MessageType("sensor_msgs", "PointCloud2")
        if "<" in name or not name:
            return None
        name = _POINTER.sub("", name)
        if kind == "srv":
            name = re.sub(r"(::)?(Request|Response)$", "", name)
        parts = name.split("::")
        if len(parts) == 3 and parts[1] in ("msg", "srv", "action"):
            return type_of(name, kind)
        if len(parts) == 2 and self._is_message(parts[0], parts[1]):
            return type_of(name, kind)
        if steps < 3 and (alias := self._alias(parts[-1])):
            return self._type(file, alias, kind, steps + 1)
        if len(parts) == 1:
            headers = {
                h for each in self._files for h in each.includes if h.endswith(f"/{name}.h") and h.count("/") == 1
            }
            packages = {header.partition("/")[0] for header in headers}
            if len(packages) == 1:
                return type_of(f"{packages.pop()}::{name}", kind)
        return None

    def _is_message(self, package: str, name: str) -> bool:
        """Whether `package::Name` is a message: its package says so, or a header of it is included."""
        stem = re.sub(r"(Action)?(Goal|Result|Feedback)?$", "", name)
        return package.endswith(("_msgs", "_srvs")) or any(
            header in (f"{package}/{name}.h", f"{package}/{stem}Action.h") for f in self._files for header in f.includes
        )

    def _alias(self, word: str) -> str | None:
        """The type that `using` or `typedef` declares a name to be."""
        found = set[str]()
        for file in self._files:
            for at in file.places.get(word, ()):
                if file.word(at - 1) == "using" and file.sign(at + 1) == "=":
                    found.add(file.text(until_end(file, at + 2)))
                elif file.sign(at + 1) == ";":
                    begin = (
                        next((b for b in range(at, max(at - 40, -1), -1) if file.sign(b) in (";", "{", "}")), -1) + 1
                    )
                    if file.word(begin) == "typedef":
                        found.add(file.text(range(begin + 1, at)))
                    elif file.word(begin) == "using" and file.sign(at - 1) == "::":
                        found.add(file.text(range(begin + 1, at + 1)))
        return found.pop() if len(found) == 1 else None

    def of_callback(self, file: CppFile, arguments: Sequence[range], kind: TypeKind) -> MessageType | None:
        """The type of the first parameter of a callback: a method, a function, or a lambda among the arguments."""
        for each in arguments:
            for at in each:
                if file.sign(at) == "[" and (end := file.partner(at)) is not None and file.sign(end + 1) == "(":
                    return self._first_parameter(file, end + 1, kind)
                if file.word(at) and file.sign(at + 1) != "::" and file.sign(at + 1) not in ("(", "<"):
                    types = self._types_of_function(file.word(at), kind)
                    if types:
                        return types.pop() if len(types) == 1 else None
        return None

    def _types_of_function(self, name: str, kind: TypeKind) -> set[MessageType]:
        found = set[MessageType]()
        for file in self._files:
            for at in file.places.get(name, ()):
                is_declared = file.sign(at - 1) == "::" or (file.word(at - 1) not in ("", "return", "new"))
                if file.sign(at + 1) == "(" and is_declared:
                    kind_of = self._first_parameter(file, at + 1, kind)
                    if kind_of is not None:
                        found.add(kind_of)
        return found

    def _first_parameter(self, file: CppFile, begin: int, kind: TypeKind) -> MessageType | None:
        arguments = file.arguments(begin)
        if not arguments:
            return None
        words = [at for at in arguments[0] if file.word(at) not in ("const", "typename")]
        words = [at for at in words if file.sign(at) not in ("&", "*")]
        if len(words) > 1 and file.word(words[-1]) and file.sign(words[-1] - 1) != "::":
            words = words[:-1]
        return self._type(file, "".join(file.tokens[at].text for at in words), kind, 0)
