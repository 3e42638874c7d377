"""Find the ports that C++ source creates, by its tokens: roscpp, rclcpp, image_transport, message_filters, actionlib.

Nothing is compiled: a handle, a name or a type is followed through declarations, initialisers, assignments and calls of
the node's own files. A name that leads to several texts, or to none, counts as computed.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from cfgplan.ros.code.code_ports import BROADCASTERS, CodePort, CodeReading, Place, action_ports
from cfgplan.ros.code.cpp_expressions import CppExpressions
from cfgplan.ros.code.cpp_tokens import CppFile
from cfgplan.ros.code.cpp_types import CppTypes
from cfgplan.ros.code.cpp_values import CppValues, Spot, call_at, is_initialiser, receiver_before
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


def cpp_ports(files: Sequence[CppFile]) -> CodeReading:
    """The ports that calls in the C++ files of one node make."""
    source = _Sources(files)
    ports = list(source.ports())
    return CodeReading(tuple(ports), tuple(source.unclear))


class _Sources:
    """The files of one node."""

    def __init__(self, files: Sequence[CppFile]) -> None:
        self._files = files
        self._expressions, self._types = CppExpressions(files, CppValues(files)), CppTypes(files)
        self.unclear: list[str] = []

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
        self, spot: Spot, at: int, role: Role, kind: MessageType | None, namespace: str | None
    ) -> Iterator[CodePort]:
        """The port whose name is an expression; none, and a note, if that or the handle is computed."""
        file, places = spot
        name = self._expressions.name(file, places, 0)
        place = self._place(file, at)
        if name is None or namespace is None:
            said = " ".join(file.tokens[each].text for each in places)[:60]
            self.unclear.append(f"{role.value} `{said}` at {place}")
        else:
            yield CodePort(role, name, kind, place, namespace)

    def _of_method(self, file: CppFile, at: int, word: str, role: Role) -> Iterator[CodePort]:
        before = at - 1 - (file.word(at - 1) == "template")
        if file.sign(before) not in (".", "->") or (call := call_at(file, at)) is None:
            return
        template, arguments = call
        if not arguments:
            return
        receiver = receiver_before(file, before - 1)
        if word == "subscribe" and self._expressions.is_handle(file, arguments[0]):
            yield from self._late_filter(file, at, receiver, arguments)
            return
        transport = self._expressions.transport(file, receiver)
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
            if self._expressions.namespace(file, receiver, 0) is not None:
                self.unclear.append(f"{role.value} `{file.text(arguments[0])[:60]}` at {self._place(file, at)}")
            return
        kind: TypeKind = "srv" if role.is_service else "msg"
        found = self._types.of_template(file, template, kind)
        if found is None and role in (Role.SUBSCRIBES, Role.SERVES):
            found = self._types.of_callback(file, arguments[1:], kind)
        yield from self._port((file, arguments[0]), at, role, found, self._expressions.namespace(file, receiver, 0))

    def _created(self, file: CppFile, at: int, role: Role) -> Iterator[CodePort]:
        qualifier = file.word(at - 2) if file.sign(at - 1) == "::" else ""
        if qualifier == "rclcpp_action" or (call := call_at(file, at)) is None:
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
        yield from self._port((file, name), at, role, self._types.of_template(file, template, kind), "")

    def _action2(self, file: CppFile, at: int, *, is_server: bool) -> Iterator[CodePort]:
        call = call_at(file, at)
        if call is None or call[0] is None or len(call[1]) < 2:
            return
        kind = self._types.of_template(file, call[0], "action")
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
        kind = _IMAGE if word == "SubscriberFilter" else self._types.of_template(file, template, "msg")
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
                            if arguments and is_initialiser(other, at):
                                yield other, arguments
            after += 2
            if file.sign(after - 1) != ",":
                return

    def _made(
        self, file: CppFile, arguments: list[range], role: Role, kind: MessageType | None, *, is_action: bool
    ) -> Iterator[CodePort]:
        namespace: str | None = ""
        if self._expressions.is_handle(file, arguments[0]):
            transport = self._expressions.transport(file, arguments[0])
            namespace = transport[0] if transport else self._expressions.namespace(file, arguments[0], 0)
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
        transport = self._expressions.transport(file, arguments[0])
        namespace = transport[0] if transport else self._expressions.namespace(file, arguments[0], 0)
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
                        return self._types.of_template(other, range(begin + 2, end - 1), "msg")
        return None


def _camera_info(port: CodePort) -> CodePort:
    """The port of the camera's data beside its images."""
    last = port.name[-1]
    above = f"{last.rpartition('/')[0]}/" if isinstance(last, str) and "/" in last else ""
    return CodePort(port.role, (*port.name[:-1], f"{above}camera_info"), _INFO, port.place, port.namespace)
