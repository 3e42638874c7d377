"""The ports that C++ source makes, by its tokens: roscpp, rclcpp, image_transport, message_filters, actionlib.

Nothing is compiled: a handle, a name or a type is followed through declarations, initialisers, assignments and calls of
the node's own files. A name that leads to several texts, or to none, counts as computed.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TypeAlias

from cfgplan.ros.code.code_ports import (
    BROADCASTERS,
    MOST_STEPS,
    CodeName,
    CodePort,
    CodeReading,
    Parameter,
    Place,
    action_ports,
    type_of,
)
from cfgplan.ros.code.cpp_tokens import CppFile
from cfgplan.ros.graph import Role
from cfgplan.ros.types import MessageType, TypeKind

_METHODS = {
    "advertise": Role.PUBLISHES,
    "subscribe": Role.SUBSCRIBES,
    "advertiseService": Role.SERVES,
    "serviceClient": Role.CALLS,
    "advertiseCamera": Role.PUBLISHES,
    "subscribeCamera": Role.SUBSCRIBES,
}
_CREATED = {
    "create_publisher": Role.PUBLISHES,
    "create_subscription": Role.SUBSCRIBES,
    "create_service": Role.SERVES,
    "create_client": Role.CALLS,
}
_ENDS = {
    "Subscriber": Role.SUBSCRIBES,
    "SubscriberFilter": Role.SUBSCRIBES,
    "RealtimePublisher": Role.PUBLISHES,
    "SimpleActionServer": Role.SERVES,
    "ActionServer": Role.SERVES,
    "SimpleActionClient": Role.CALLS,
    "ActionClient": Role.CALLS,
}
"""Classes whose objects are ports; actions are the roles of services."""
_TRANSFORMS = MessageType("tf2_msgs", "TFMessage")
_IMAGE, _INFO = MessageType("sensor_msgs", "Image"), MessageType("sensor_msgs", "CameraInfo")
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
_POINTER = re.compile(r"(?:::)?(?:Const)?(?:Ptr|SharedPtr|UniquePtr|ConstSharedPtr|ConstPtr)$")
_READ = ("param", "getParam", "get_parameter", "get_parameter_or", "declare_parameter", "get", "getParamCached")
_LONGEST = 200
"""The most tokens of an argument that is evaluated."""
_Spot: TypeAlias = tuple[CppFile, range]


@dataclass(frozen=True, slots=True)
class _Found:
    """A value of a word within a block: an expression, a function's parameter, or a declaration alone."""

    file: CppFile
    at: int
    block: int
    value: range | None
    is_member: bool
    parameter: tuple[str, int] | None = None


def cpp_ports(files: Sequence[CppFile]) -> CodeReading:
    """The ports that calls in the C++ files of one node make."""
    source = _Sources(files)
    ports = list(source.ports())
    return CodeReading(tuple(ports), tuple(source.unclear))


class _Sources:
    """The files of one node."""

    def __init__(self, files: Sequence[CppFile]) -> None:
        self._files = files
        self.unclear: list[str] = []
        self._memory: dict[str, list[_Found]] = {}

    def ports(self) -> Iterator[CodePort]:
        for file in self._files:
            for word, role in _METHODS.items():
                for at in file.places.get(word, ()):
                    yield from self._of_method(file, at, word, role)
            for word, role in _CREATED.items():
                for at in file.places.get(word, ()):
                    yield from self._created(file, at, role)
            for word, role in _ENDS.items():
                for at in file.places.get(word, ()):
                    yield from self._end(file, at, word, role)
            for word in ("create_server", "create_client"):
                for at in file.places.get(word, ()):
                    if file.word(at - 2) == "rclcpp_action":
                        yield from self._action2(file, at, is_server=word == "create_server")
            for word, topic in BROADCASTERS.items():
                for at in file.places.get(word, ()):
                    if file.word(at - 2) in ("tf", "tf2_ros") and file.sign(at + 1) != ";":
                        yield CodePort(Role.PUBLISHES, (topic,), _TRANSFORMS, self._place(file, at))

    @staticmethod
    def _place(file: CppFile, at: int) -> Place:
        return Place(file.file, file.tokens[at].line)

    def _port(
        self, spot: _Spot, at: int, role: Role, kind: MessageType | None, namespace: str | None
    ) -> Iterator[CodePort]:
        """The port whose name is an expression; none, and a note, if that or the handle is computed."""
        file, places = spot
        name = self._name(file, places, 0)
        place = self._place(file, at)
        if name is None or namespace is None:
            said = " ".join(file.tokens[each].text for each in places)[:60]
            self.unclear.append(f"{role.value} `{said}` at {place}")
        else:
            yield CodePort(role, name, kind, place, namespace)

    # The calls

    @staticmethod
    def _call(file: CppFile, at: int) -> tuple[range | None, list[range]] | None:
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

    def _of_method(self, file: CppFile, at: int, word: str, role: Role) -> Iterator[CodePort]:
        before = at - 1 - (file.word(at - 1) == "template")
        if file.sign(before) not in (".", "->") or (call := self._call(file, at)) is None:
            return
        template, arguments = call
        if not arguments:
            return
        receiver = self._receiver(file, before - 1)
        if word == "subscribe" and self._is_handle(file, arguments[0]):
            yield from self._late_filter(file, at, receiver, arguments)
            return
        transport = self._transport(file, receiver)
        if transport is not None:
            if len(arguments) > 1 or not word.endswith("Camera"):
                for port in self._port((file, arguments[0]), at, role, _IMAGE, transport[0]):
                    yield port
                    if word.endswith("Camera"):
                        yield _camera_info(port)
            return
        if word.endswith("Camera"):
            return
        if len(arguments) < 2 and role in (Role.PUBLISHES, Role.SUBSCRIBES) and template is None:
            if self._namespace(file, receiver, 0) is not None:
                self.unclear.append(f"{role.value} `{file.text(arguments[0])[:60]}` at {self._place(file, at)}")
            return
        kind: TypeKind = "srv" if role.is_service else "msg"
        found = self._template_type(file, template, kind)
        if found is None and role in (Role.SUBSCRIBES, Role.SERVES):
            found = self._type_of_callback(file, arguments[1:], kind)
        yield from self._port((file, arguments[0]), at, role, found, self._namespace(file, receiver, 0))

    def _created(self, file: CppFile, at: int, role: Role) -> Iterator[CodePort]:
        qualifier = file.word(at - 2) if file.sign(at - 1) == "::" else ""
        if qualifier == "rclcpp_action" or (call := self._call(file, at)) is None:
            return
        template, arguments = call
        if qualifier == "image_transport":
            if len(arguments) > 1:
                yield from self._port((file, arguments[1]), at, role, _IMAGE, "")
            return
        if template is None or not arguments:
            return
        kind: TypeKind = "srv" if role.is_service else "msg"
        first = 1 if qualifier == "rclcpp" and len(arguments) > 1 else 0
        name = arguments[first]
        yield from self._port((file, name), at, role, self._template_type(file, template, kind), "")

    def _action2(self, file: CppFile, at: int, *, is_server: bool) -> Iterator[CodePort]:
        call = self._call(file, at)
        if call is None or call[0] is None or len(call[1]) < 2:
            return
        kind = self._template_type(file, call[0], "action")
        for port in self._port((file, call[1][1]), at, Role.SERVES, kind, ""):
            yield from action_ports(is_server, port) if kind and kind.kind == "action" else ()

    def _end(self, file: CppFile, at: int, word: str, role: Role) -> Iterator[CodePort]:
        """The ports that objects of a class are, where one is made with a name."""
        owner = file.word(at - 2) if file.sign(at - 1) == "::" else ""
        if owner not in ("message_filters", "image_transport", "realtime_tools", "actionlib"):
            return
        after, template = at + 1, None
        if file.sign(after) == "<":
            end = file.after_angles(after)
            if end is None:
                return
            template, after = range(after + 1, end - 1), end
        kind = _IMAGE if word == "SubscriberFilter" else self._template_type(file, template, "msg")
        for inner, arguments in self._makings(file, after):
            yield from self._made(inner, arguments, role, kind, is_action="Action" in word)

    def _makings(self, file: CppFile, after: int) -> Iterator[tuple[CppFile, list[range]]]:
        """The arguments of each making of an object whose class ends before a place."""
        if file.sign(after) == ">" and file.sign(after + 1) in ("(", "{"):  # make_shared<Class<T>>(...)
            after += 1
        if file.sign(after) in ("(", "{"):
            if arguments := file.arguments(after):
                yield file, arguments
            return
        while word := file.word(after):
            if file.sign(after + 1) in ("(", "{"):
                if arguments := file.arguments(after + 1):
                    yield file, arguments
            else:
                for other in self._files:
                    for at in other.places.get(word, ()):
                        if other.sign(at - 1) in (":", ",") and other.sign(at + 1) in ("(", "{"):
                            arguments = other.arguments(at + 1)
                            if arguments and self._is_initialiser(other, at):
                                yield other, arguments
            after += 2
            if file.sign(after - 1) != ",":
                return

    def _made(
        self, file: CppFile, arguments: list[range], role: Role, kind: MessageType | None, *, is_action: bool
    ) -> Iterator[CodePort]:
        namespace: str | None = ""
        if self._is_handle(file, arguments[0]):
            transport = self._transport(file, arguments[0])
            namespace = transport[0] if transport else self._namespace(file, arguments[0], 0)
            arguments = arguments[1:]
        elif not is_action:
            return
        if not arguments or not len(arguments[0]):
            return
        for port in self._port((file, arguments[0]), arguments[0].start, role, kind, namespace):
            yield from action_ports(role is Role.SERVES, port) if is_action else (port,)

    def _late_filter(self, file: CppFile, at: int, receiver: range, arguments: list[range]) -> Iterator[CodePort]:
        """The port of `filter.subscribe(handle, "name", 1)`."""
        if len(arguments) < 2:
            return
        transport = self._transport(file, arguments[0])
        namespace = transport[0] if transport else self._namespace(file, arguments[0], 0)
        kind = _IMAGE if transport else self._type_of_filter(file, receiver)
        yield from self._port((file, arguments[1]), at, Role.SUBSCRIBES, kind, namespace)

    def _type_of_filter(self, file: CppFile, receiver: range) -> MessageType | None:
        word = file.word(receiver.stop - 1)
        for other in self._files:
            for at in other.places.get(word, ()):
                if other.sign(at - 1) == ">":
                    begin = next((b for b in range(at - 2, max(at - 30, 0), -1) if other.word(b) == "Subscriber"), None)
                    end = other.after_angles(begin + 1) if begin is not None else None
                    if begin is not None and end is not None:
                        return self._template_type(other, range(begin + 2, end - 1), "msg")
        return None

    # Handles

    @staticmethod
    def _receiver(file: CppFile, at: int) -> range:
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

    def _is_handle(self, file: CppFile, places: range) -> bool:
        """Whether an expression is a handle or an image transport."""
        return self._namespace(file, places, 0) is not None or self._transport(file, places) is not None

    def _transport(self, file: CppFile, places: range) -> tuple[str | None] | None:
        """The namespace of an image transport, None in it if computed; None if the expression is none."""
        places = _bare(file, places)
        words = [file.word(at) for at in places]
        if "ImageTransport" in words:
            arguments = self._arguments_at_end(file, places)
            return (self._namespace(file, arguments[0], 0),) if arguments else None
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
                    made = [(each.file, [each.value]) for each in self._values(words[0]) if each.value is not None]
                for each, arguments in made:
                    if not arguments:
                        continue
                    inner = self._transport_argument(each, arguments[0])
                    found.add(self._namespace(each, inner, 0))
                if not made:
                    found.add("")
        return (found.pop() if len(found) == 1 else None,) if found else None

    def _transport_argument(self, file: CppFile, places: range) -> range:
        words = [file.word(at) for at in places]
        if "ImageTransport" in words:
            return (self._arguments_at_end(file, _bare(file, places)) or [places])[0]
        return places

    @staticmethod
    def _arguments_at_end(file: CppFile, places: range) -> list[range] | None:
        if not len(places) or file.sign(places.stop - 1) not in (")", "}"):
            return None
        begin = file.partner(places.stop - 1)
        return None if begin is None or begin < places.start else file.arguments(begin)

    def _namespace(self, file: CppFile, places: range, steps: int) -> str | None:
        """The namespace of the handle that an expression is; None if it is none, or computed."""
        places = _bare(file, places)
        if not len(places) or steps > MOST_STEPS or len(places) > _LONGEST:
            return None
        last = file.word(places.stop - 1)
        if len(places) == 1 or file.sign(places.stop - 2) in (".", "->", "::"):
            if last in _HANDLES or last == "NodeHandle":
                return _HANDLES.get(last, "")
            return self._followed(file, places.stop - 1, last, steps, self._namespace_of_found)
        arguments = self._arguments_at_end(file, places)
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
                name = self._name(file, only, steps + 1)
                return self._namespace(file, only, steps + 1) if name is None else _plain(name)
            case [parent, child, *_]:
                above, name = self._namespace(file, parent, steps + 1), self._name(file, child, steps + 1)
                below = None if name is None else _plain(name)
                if above is None or below is None:
                    return _plain(self._name(file, parent, steps + 1) or ("\0",)) if below is None else None
                return f"{above}/{below}".strip("/") if below else above
        return None

    def _is_declared_handle(self, word: str) -> bool:
        """Whether a variable, member or parameter of this name is declared to be a handle or a node anywhere."""
        return any(_is_handle_at(file, at) for file in self._files for at in file.places.get(word, ()))

    def _namespace_of_found(self, found: _Found, steps: int) -> str | None:
        word = found.file.tokens[found.at].text
        if not self._is_declared_handle(word):
            return None
        if found.parameter is not None:
            calls = self._calls(*found.parameter)
            told = {self._namespace(file, places, steps + 1) for file, places in calls}
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

    # What a word stands for

    def _followed(
        self, file: CppFile, at: int, word: str, steps: int, meaning: Callable[[_Found, int], str | None]
    ) -> str | None:
        """The one meaning of all values of a word at a place; None if they differ."""
        if not word or steps > MOST_STEPS:
            return None
        near = self._nearest(file, at, word)
        told = {meaning(each, steps + 1) for each in near}
        if len(told) == 1:
            return told.pop()
        return None

    def _nearest(self, file: CppFile, at: int, word: str) -> list[_Found]:
        """The values of a word nearest to a place: in its blocks, in its file, elsewhere."""
        found = self._values(word)
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

    def _values(self, word: str) -> list[_Found]:
        """All that stands for a word in all files."""
        if word not in self._memory:
            self._memory[word] = [
                found for file in self._files for at in file.places.get(word, ()) for found in self._found(file, at)
            ]
        return self._memory[word]

    def _found(self, file: CppFile, at: int) -> Iterator[_Found]:
        after = file.sign(at + 1)
        before_sign, before_word = file.sign(at - 1), file.word(at - 1)
        in_class, block = self._is_in_class(file, at), next(file.blocks(at))
        is_typed = bool(before_word) and before_word not in ("return", "new", "else", "case", "throw", "delete")
        is_typed = is_typed or (before_sign in ("&", "*", ">") and (bool(file.word(at - 2)) or before_sign == ">"))
        if before_sign in (".", "->", "::") and not (before_sign == "->" and file.word(at - 2) == "this"):
            return
        if is_typed and (parameter := self._parameter(file, at)) is not None:
            function, number, body = parameter
            yield _Found(file, at, body, None, False, (function, number))
            return
        if after == "=" and file.sign(at + 2) != "=":
            yield _Found(file, at, block, _until_end(file, at + 2), in_class or not self._is_local(file, at, is_typed))
        elif after == "[" and file.sign((file.partner(at + 1) or at) + 1) == "=":
            begin = (file.partner(at + 1) or at) + 2
            yield _Found(file, at, block, _until_end(file, begin), in_class or not self._is_local(file, at, is_typed))
        elif after in ("(", "{"):
            end = file.partner(at + 1)
            if end is None:
                return
            inside = range(at + 2, end)
            if before_sign in (":", ",") and self._is_initialiser(file, at):
                yield _Found(file, at, block, inside, True)
            elif (is_typed or before_sign == ",") and (inside or after == "{") and file.sign(end + 1) in (";", ","):
                yield _Found(file, at, block, inside, in_class)
        elif after in (".", "->") and file.word(at + 2) == "reset" and file.sign(at + 3) == "(":
            end = file.partner(at + 3)
            if end is not None and end > at + 4:
                yield _Found(file, at, block, range(at + 4, end), True)
        elif after in (";", ",") and is_typed:
            yield _Found(file, at, block, None, in_class)

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

    @staticmethod
    def _is_initialiser(file: CppFile, at: int) -> bool:
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

    def _parameter(self, file: CppFile, at: int) -> tuple[str, int, int] | None:
        """Return the function whose parameter a word is, as name, parameter number and start of the body;
        None if none.
        """
        if file.sign(at + 1) not in (",", ")", "="):
            return None
        end = at
        for _ in range(_LONGEST):
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

    def _calls(self, function: str, number: int) -> Iterator[_Spot]:
        """The arguments for a parameter of a function or constructor, where it is called."""
        for file in self._files:
            for at in file.places.get(function, ()):
                begin = at + 1 + bool(file.word(at + 1))
                if file.sign(at + 1) == ">":
                    begin = at + 2
                if file.sign(begin) != "(" and file.sign(begin) != "{":
                    continue
                arguments = file.arguments(begin) if file.sign(begin) == "(" else None
                if arguments and number < len(arguments) and not _is_declared(file, arguments):
                    yield file, arguments[number]

    # Names

    def _name(self, file: CppFile, places: range, steps: int) -> CodeName | None:
        """The parts of a text that an expression makes; None if it is computed."""
        places = _bare(file, places)
        if not len(places) or steps > MOST_STEPS or len(places) > _LONGEST:
            return None
        pieces = _split(file, places, "+")
        if len(pieces) > 1:
            parts = [self._name(file, piece, steps + 1) for piece in pieces]
            return None if None in parts else tuple(one for part in parts for one in part or ())
        if all(file.tokens[at].kind == "text" for at in places):
            return ("".join(file.tokens[at].text for at in places),)
        last = file.word(places.stop - 1)
        if last and all(file.word(at) or file.sign(at) in ("::", "->", ".") for at in places):
            if file.sign(places.stop - 2) in (".", "->") and file.word(places.stop - 3) != "this":
                return self._of_member(last, steps)
            return self._variable(file, places.stop - 1, last, steps)
        arguments = self._arguments_at_end(file, places)
        begin = file.partner(places.stop - 1) if arguments is not None else None
        if arguments is None or begin is None:
            return None
        word = file.word(begin - 1)
        if word in ("string", "c_str", "str", "String"):
            if word == "string" and len(arguments) == 1:
                return self._name(file, arguments[0], steps + 1)
            if word == "c_str" and file.sign(begin - 2) == ".":
                return self._name(file, range(places.start, begin - 2), steps + 1)
            return None
        if word in ("as_string", "get_value", "get") or file.sign(begin - 1) == ">":
            inner = self._behind(file, begin)
            if inner is not None and file.sign(inner) in (".", "->") and inner > places.start:
                return self._name(file, range(places.start, inner), steps + 1)
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
        texts = {self._value_name(each, steps + 1) for each in self._values(word) if each.value is not None}
        return texts.pop() if len(texts) == 1 else None

    def _variable(self, file: CppFile, at: int, word: str, steps: int) -> CodeName | None:
        macros = {each.macros[word] for each in self._files if word in each.macros}
        if macros:
            return (macros.pop(),) if len(macros) == 1 else None
        near = self._nearest(file, at, word)
        if any(each.parameter is not None for each in near):
            return self._given(near, steps)
        read = self._filled(file, at, word, steps)
        if read is not None:
            values = [each for each in near if each.value is not None]
            is_changed = any(each.file.word(place) == word for each in values for place in each.value or ())
            return None if is_changed or len(values) > 1 else read
        texts = {self._value_name(each, steps + 1) for each in near}
        return texts.pop() if len(texts) == 1 else None

    def _given(self, near: Sequence[_Found], steps: int) -> CodeName | None:
        """The text that every call gives for a function's parameter."""
        spots = [spot for each in near if each.parameter for spot in self._calls(*each.parameter)]
        texts = {self._name(*spot, steps + 1) for spot in spots}
        return texts.pop() if len(texts) == 1 else None

    def _value_name(self, found: _Found, steps: int) -> CodeName | None:
        return None if found.value is None else self._name(found.file, found.value, steps + 1)

    def _filled(self, file: CppFile, at: int, word: str, steps: int) -> CodeName | None:
        """The parameter that a call reads into a variable: `nh.param("name", variable, default)`."""
        found = set[CodeName]()
        local = any(each.file is file and not each.is_member for each in self._nearest(file, at, word))
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
        name = self._name(file, arguments[0], steps + 1)
        if name is None or not isinstance(name[0], str) or len(name) != 1:
            return None
        is_ros2 = method in ("get_parameter", "get_parameter_or", "declare_parameter")
        rest = arguments[2:] if into else arguments[1:]
        default = self._name(file, rest[0], steps + 1) if rest and method not in ("getParam", "get") else None
        text = default[0] if default and len(default) == 1 and isinstance(default[0], str) else None
        if rest and text is None and not is_ros2 and method == "param":
            return None
        if is_ros2:
            return (Parameter(f"~{name[0]}", text if text is not None else self._declared(name[0], steps)),)
        if into and text is None:
            text = self._initial(into, steps)
        if file.sign(at - 1) == "::":
            return (Parameter(name[0], text),)
        namespace = self._namespace(file, self._receiver(file, at - 2), steps + 1)
        if namespace is None:
            return None
        inside = name[0] if name[0].startswith(("/", "~")) or not namespace else f"{namespace}/{name[0]}"
        return (Parameter(inside, text),)

    def _initial(self, word: str, steps: int) -> str | None:
        """The only text that a variable has before a parameter is read into it."""
        texts = {self._value_name(each, steps + 1) for each in self._values(word) if each.value is not None}
        name = texts.pop() if len(texts) == 1 else None
        return name[0] if name and len(name) == 1 and isinstance(name[0], str) else None

    def _declared(self, name: str, steps: int) -> str | None:
        """The default of a declared parameter."""
        texts = set[str | None]()
        for file in self._files:
            for at in file.places.get("declare_parameter", ()):
                call = self._call(file, at)
                if call is not None and len(call[1]) > 1 and self._name(file, call[1][0], steps + 1) == (name,):
                    text = self._name(file, call[1][1], steps + 1)
                    texts.add(text[0] if text and len(text) == 1 and isinstance(text[0], str) else None)
        return texts.pop() if len(texts) == 1 else None

    # Types

    def _template_type(self, file: CppFile, places: range | None, kind: TypeKind) -> MessageType | None:
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
                    found.add(file.text(_until_end(file, at + 2)))
                elif file.sign(at + 1) == ";":
                    begin = (
                        next((b for b in range(at, max(at - 40, -1), -1) if file.sign(b) in (";", "{", "}")), -1) + 1
                    )
                    if file.word(begin) == "typedef":
                        found.add(file.text(range(begin + 1, at)))
                    elif file.word(begin) == "using" and file.sign(at - 1) == "::":
                        found.add(file.text(range(begin + 1, at + 1)))
        return found.pop() if len(found) == 1 else None

    def _type_of_callback(self, file: CppFile, arguments: Sequence[range], kind: TypeKind) -> MessageType | None:
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


def _camera_info(port: CodePort) -> CodePort:
    """The port of the camera's data beside its images."""
    last = port.name[-1]
    above = f"{last.rpartition('/')[0]}/" if isinstance(last, str) and "/" in last else ""
    return CodePort(port.role, (*port.name[:-1], f"{above}camera_info"), _INFO, port.place, port.namespace)


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


def _bare(file: CppFile, places: range) -> range:
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


def _split(file: CppFile, places: range, sign: str) -> list[range]:
    pieces, begin, at = [], places.start, places.start
    while at < places.stop:
        if file.sign(at) in ("(", "{", "["):
            at = file.partner(at) or at
        elif file.sign(at) == sign:
            pieces.append(range(begin, at))
            begin = at + 1
        at += 1
    return [*pieces, range(begin, places.stop)]


def _until_end(file: CppFile, begin: int) -> range:
    """The places up to the end of a statement, or of a parameter's default."""
    at = begin
    while at < len(file.tokens) and at < begin + _LONGEST and file.sign(at) not in (";", ",", ")", "}"):
        if file.sign(at) in ("(", "{", "["):
            at = file.partner(at) or at
        at += 1
    return range(begin, min(at, len(file.tokens)))


def _is_declared(file: CppFile, arguments: Sequence[range]) -> bool:
    """Whether brackets hold parameters with types, not values: it is a declaration, no call."""
    return any(
        file.word(at) and (file.word(at + 1) or (file.sign(at + 1) in ("&", "*") and file.word(at + 2)))
        for each in arguments
        for at in each
        if at + 1 in each and file.word(at) not in ("new", "return")
    )
