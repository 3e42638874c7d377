"""The values of words in C++ source: what is assigned, initialised, declared or passed under a name, by its tokens."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TypeAlias

from cfgplan.ros.code.cpp_tokens import CppFile

LONGEST = 200
"""The most tokens of an argument that is evaluated."""
Spot: TypeAlias = tuple[CppFile, range]


@dataclass(frozen=True, slots=True)
class Found:
    """A value of a word within a block: an expression, a function's parameter, or a declaration alone."""

    file: CppFile
    at: int
    block: int
    value: range | None
    is_member: bool
    parameter: tuple[str, int] | None = None


class CppValues:
    """The values of words in the files of one node."""

    def __init__(self, files: Sequence[CppFile]) -> None:
        self._files = files
        self._memory: dict[str, list[Found]] = {}

    def nearest(self, file: CppFile, at: int, word: str) -> list[Found]:
        """The values of a word nearest to a place: in its blocks, in its file, elsewhere."""
        found = self.of(word)
        blocks = [*file.blocks(at)]
        here = [each for each in found if each.file is file]
        if given := [each for each in here if each.parameter and each.at < at < each.block]:
            return given[-1:]  # in the list of initialisers
        for block in blocks[:-1]:
            inside = [e for e in here if e.at < at and not e.is_member and e.block == block]
            if inside:
                valued = [each for each in inside if each.value is not None]
                return valued or inside[-1:]
        members = [each for each in found if each.is_member or each.block < 0]
        for group in ([each for each in members if each.file is file], members):
            valued = [each for each in group if each.value is not None]
            if valued:
                return valued
        return [each for each in members if each.parameter is None]

    def of(self, word: str) -> list[Found]:
        """All values of a word in all files."""
        if word not in self._memory:
            self._memory[word] = [
                found for file in self._files for at in file.places.get(word, ()) for found in self._found(file, at)
            ]
        return self._memory[word]

    def _found(self, file: CppFile, at: int) -> Iterator[Found]:
        after = file.sign(at + 1)
        before_sign, before_word = file.sign(at - 1), file.word(at - 1)
        in_class, block = self._is_in_class(file, at), next(file.blocks(at))
        is_typed = bool(before_word) and before_word not in ("return", "new", "else", "case", "throw", "delete")
        is_typed = is_typed or (before_sign in ("&", "*", ">") and (bool(file.word(at - 2)) or before_sign == ">"))
        if before_sign in (".", "->", "::") and not (before_sign == "->" and file.word(at - 2) == "this"):
            return
        if is_typed and (parameter := self._parameter(file, at)) is not None:
            function, number, body = parameter
            yield Found(file, at, body, None, False, (function, number))
            return
        if after == "=" and file.sign(at + 2) != "=":
            yield Found(file, at, block, until_end(file, at + 2), in_class or not self._is_local(file, at, is_typed))
        elif after == "[" and file.sign((file.partner(at + 1) or at) + 1) == "=":
            begin = (file.partner(at + 1) or at) + 2
            yield Found(file, at, block, until_end(file, begin), in_class or not self._is_local(file, at, is_typed))
        elif after in ("(", "{"):
            end = file.partner(at + 1)
            if end is None:
                return
            inside = range(at + 2, end)
            if before_sign in (":", ",") and is_initialiser(file, at):
                yield Found(file, at, block, inside, True)
            elif (is_typed or before_sign == ",") and (inside or after == "{") and file.sign(end + 1) in (";", ","):
                yield Found(file, at, block, inside, in_class)
        elif after in (".", "->") and file.word(at + 2) == "reset" and file.sign(at + 3) == "(":
            end = file.partner(at + 3)
            if end is not None and end > at + 4:
                yield Found(file, at, block, range(at + 4, end), True)
        elif after in (";", ",") and is_typed:
            yield Found(file, at, block, None, in_class)

    def _is_local(self, file: CppFile, at: int, is_typed: bool) -> bool:
        """Whether an assigned word is declared within the function, not as a member or in the file."""
        if is_typed:
            return next(file.blocks(at)) >= 0 and not self._is_namespace(file, next(file.blocks(at)))
        blocks = set(file.blocks(at)) - {-1}
        return any(
            other < at
            and file.sign(other + 1) in (";", "=", ",")
            and bool(file.word(other - 1))
            and next(file.blocks(other)) in blocks
            and not self._is_in_class(file, other)
            for other in file.places.get(file.tokens[at].text, ())
        )

    def _is_in_class(self, file: CppFile, at: int) -> bool:
        """Whether a place is directly within a class, a namespace or the file, not in a function."""
        block = next(file.blocks(at))
        return block < 0 or self._is_namespace(file, block)

    @staticmethod
    def _is_namespace(file: CppFile, brace: int) -> bool:
        for at in range(brace - 1, max(brace - 40, -1), -1):
            if file.sign(at) in (";", "}", "{", ")"):
                return False
            if file.word(at) in ("class", "struct", "namespace"):
                return True
        return False

    def _parameter(self, file: CppFile, at: int) -> tuple[str, int, int] | None:
        """Return the function whose parameter a word is, as name, parameter number and start of the body;
        None if none.
        """
        if file.sign(at + 1) not in (",", ")", "="):
            return None
        end = at
        for _ in range(LONGEST):
            end += 1
            if file.sign(end) in ("(", "{", "["):
                end = file.partner(end) or end
            elif file.sign(end) in (")", ";", "}", "") and file.sign(end):
                break
        begin = file.partner(end) if file.sign(end) == ")" else None
        if begin is None or not (name := file.word(begin - 1)) or name in ("if", "while", "for", "switch", "catch"):
            return None
        body = end + 1
        while body < len(file.tokens) and body < end + 400 and file.sign(body) not in ("{", ";"):
            if file.sign(body) == "(":
                body = file.partner(body) or body
            if file.sign(body) in ("}", ")", ",") and file.sign(end + 1) != ":" and file.partner(body) is None:
                return None
            body += 1
        if file.sign(end + 1) == ":":
            while file.sign(body) == "{" and file.word(body - 1):
                body = (file.partner(body) or body) + 1
                while body < len(file.tokens) and file.sign(body) not in ("{", ";"):
                    body += 1
        elif file.sign(end + 1) != "{" and file.word(end + 1) not in ("const", "override", "noexcept", "final"):
            return None
        if file.sign(body) != "{":
            return None
        arguments = file.arguments(begin) or []
        number = next((n for n, each in enumerate(arguments) if at in each), None)
        return None if number is None else (name, number, body)

    def calls(self, function: str, number: int) -> Iterator[Spot]:
        """The arguments for a parameter of a function or constructor, where it is called."""
        for file in self._files:
            for at in file.places.get(function, ()):
                begin = at + 1 + bool(file.word(at + 1))
                if file.sign(at + 1) == ">":
                    begin = at + 2
                if file.sign(begin) != "(" and file.sign(begin) != "{":
                    continue
                arguments = file.arguments(begin) if file.sign(begin) == "(" else None
                if arguments and number < len(arguments) and not is_declaration(file, arguments):
                    yield file, arguments[number]


def is_initialiser(file: CppFile, at: int) -> bool:
    """Whether a word is in the list of initialisers of a constructor: `) : a(1), b(2) {`."""
    for _ in range(200):
        sign = file.sign(at - 1)
        if sign == ":" and file.sign(at - 2) == ")":
            return True
        if sign != "," or file.sign(at - 2) not in (")", "}"):
            return False
        begin = file.partner(at - 2)
        if begin is None:
            return False
        at = begin - 1
        while file.sign(at) == ">" or file.sign(at - 1) == "::":
            at -= 1 if file.sign(at) == ">" else 2
    return False


def call_at(file: CppFile, at: int) -> tuple[range | None, list[range]] | None:
    """The template's arguments and the arguments of a call of the word at a place; None if it is no call."""
    template = None
    begin = at + 1
    if file.sign(begin) == "<":
        after = file.after_angles(begin)
        if after is None:
            return None
        template, begin = range(begin + 1, after - 1), after
    arguments = file.arguments(begin) if file.sign(begin) in ("(", "{") else None
    return None if arguments is None else (template, arguments)


def receiver_before(file: CppFile, at: int) -> range:
    """The places of the expression that ends at a place: `nh`, `getNodeHandle()`, `ros::NodeHandle("~")`."""
    end = at + 1
    while True:
        if file.sign(at) in (")", "]"):
            begin = file.partner(at)
            if begin is None:
                return range(at, end)
            at = begin - 1
            if file.sign(at) == ">":
                return range(at + 1, end)
        if not file.word(at):
            return range(at + 1, end)
        if file.sign(at - 1) != "::":
            return range(at, end)
        at -= 2


def arguments_at_end(file: CppFile, places: range) -> list[range] | None:
    if not len(places) or file.sign(places.stop - 1) not in (")", "}"):
        return None
    begin = file.partner(places.stop - 1)
    return None if begin is None or begin < places.start else file.arguments(begin)


def bare(file: CppFile, places: range) -> range:
    """An expression without `new`, `*`, `&` before it and brackets around it."""
    while len(places):
        first = places.start
        if file.word(first) == "new" or file.sign(first) in ("*", "&", "::"):
            places = range(first + 1, places.stop)
        elif file.sign(first) in ("(", "{") and file.partner(first) == places.stop - 1:
            places = range(first + 1, places.stop - 1)
        elif file.word(first) == "std" and file.word(first + 2) == "move" and file.sign(first + 3) == "(":
            places = range(first + 3, places.stop)
        else:
            return places
    return places


def split(file: CppFile, places: range, sign: str) -> list[range]:
    pieces, begin, at = [], places.start, places.start
    while at < places.stop:
        if file.sign(at) in ("(", "{", "["):
            at = file.partner(at) or at
        elif file.sign(at) == sign:
            pieces.append(range(begin, at))
            begin = at + 1
        at += 1
    return [*pieces, range(begin, places.stop)]


def until_end(file: CppFile, begin: int) -> range:
    """The places up to the end of a statement, or of a parameter's default."""
    at = begin
    while at < len(file.tokens) and at < begin + LONGEST and file.sign(at) not in (";", ",", ")", "}"):
        if file.sign(at) in ("(", "{", "["):
            at = file.partner(at) or at
        at += 1
    return range(begin, min(at, len(file.tokens)))


def is_declaration(file: CppFile, arguments: Sequence[range]) -> bool:
    """Whether brackets hold parameters with types, not values: it is a declaration, no call."""
    return any(
        file.word(at) and (file.word(at + 1) or (file.sign(at + 1) in ("&", "*") and file.word(at + 2)))
        for each in arguments
        for at in each
        if at + 1 in each and file.word(at) not in ("new", "return")
    )
