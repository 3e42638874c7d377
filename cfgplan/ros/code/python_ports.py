"""Find the ports that Python source creates, by its syntax tree: rospy, rclpy, actionlib and message_filters."""

from __future__ import annotations

import ast
import re
import warnings
from collections import defaultdict
from collections.abc import Iterator, Mapping
from functools import cached_property

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
from cfgplan.ros.graph import Role
from cfgplan.ros.types import MessageType, TypeKind

_ROSPY = {
    "rospy.Publisher": Role.PUBLISHES,
    "rospy.Subscriber": Role.SUBSCRIBES,
    "rospy.Service": Role.SERVES,
    "rospy.ServiceProxy": Role.CALLS,
}
_RCLPY = {
    "create_publisher": Role.PUBLISHES,
    "create_subscription": Role.SUBSCRIBES,
    "create_service": Role.SERVES,
    "create_client": Role.CALLS,
}
_FILTER = "message_filters.Subscriber"
_ACTIONS = {"SimpleActionServer": True, "ActionServer": True, "SimpleActionClient": False, "ActionClient": False}
_NAME_WORDS = ("name", "topic", "topic_name", "srv_name", "action_name", "ns")
_TYPE_WORDS = ("data_class", "service_class", "msg_type", "srv_type", "action_type", "ActionSpec")
_PARAMETERS = ("get_param", "declare_parameter", "get_parameter", "get_parameter_or")
_VALUES = ("value", "string_value", "get_parameter_value")
_PYTHON2 = (
    (re.compile(r"^(\s*)print\s+(?![(=.]).*$|^(\s*)print\s*>>.*$", re.MULTILINE), r"\1\2pass"),
    (re.compile(r"^(\s*except\s+[\w.() ,]+?),\s*(\w+)\s*:", re.MULTILINE), r"\1 as \2:"),
    (re.compile(r"^(\s*raise\s+[\w.]+)\s*,.*$", re.MULTILINE), r"\1"),
)
"""Statements of Python 2 that Python 3 does not parse, and what stands for them; lines keep their numbers."""
_Block = ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef | ast.Module


def python_ports(text: str, file: str) -> CodeReading:
    """Return the ports that calls in a Python source make. Text that does not parse has none, and adds a note."""
    tree = _tree(text)
    if tree is None:
        return CodeReading(unclear=(f"{file}, which does not parse",))
    try:
        return _Source(tree, file).reading
    except RecursionError:
        return CodeReading(unclear=(f"{file}, which is nested too deep",))


def imported_modules(text: str) -> frozenset[str]:
    """The modules that a Python source imports, by dotted name without leading dots."""
    tree = _tree(text)
    found = set[str]()
    for node in ast.walk(tree) if tree is not None else ():
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = f"{node.module}." if node.module else ""
            found |= {node.module or "", *(f"{base}{alias.name}" for alias in node.names)} - {""}
    return frozenset(found)


def _tree(text: str) -> ast.Module | None:
    """The syntax tree of a source in Python 3 or, as far as that is told from it, 2."""
    older = text.expandtabs(8)
    for pattern, instead in _PYTHON2:
        older = pattern.sub(instead, older)
    for each in (text, older):
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                return ast.parse(each)
        except (SyntaxError, ValueError, RecursionError, MemoryError):
            continue
    return None


class _Source:
    """One Python source: its imports, the values of its names, and the calls that make ports."""

    def __init__(self, tree: ast.Module, file: str) -> None:
        self._tree = tree
        self._file = file
        self._above: dict[ast.AST, ast.AST] = {
            child: parent for parent in ast.walk(tree) for child in ast.iter_child_nodes(parent)
        }
        self._unclear: list[str] = []

    @property
    def reading(self) -> CodeReading:
        calls = (node for node in ast.walk(self._tree) if isinstance(node, ast.Call))
        ports = tuple(port for call in calls for port in self._ports(call))
        return CodeReading(ports, tuple(self._unclear))

    def _ports(self, call: ast.Call) -> Iterator[CodePort]:
        path = self._path(call.func)
        last = path.rpartition(".")[2]
        if role := _ROSPY.get(path):
            kind: TypeKind = "srv" if role.is_service else "msg"
            yield from self._port(
                call, role, self._argument(call, 0, _NAME_WORDS), self._argument(call, 1, _TYPE_WORDS), kind
            )
        elif path == _FILTER and (call.args or call.keywords):
            shift = 1 if len(call.args) > 2 and not isinstance(call.args[0], ast.Constant) else 0
            name, kinds = (2, 1) if shift and self._type(call.args[1], "msg") else (0, 1)
            ends = self._argument(call, name, _NAME_WORDS), self._argument(call, kinds, _TYPE_WORDS)
            yield from self._port(call, Role.SUBSCRIBES, *ends, "msg")
        elif isinstance(call.func, ast.Attribute) and last in _RCLPY:
            role = _RCLPY[last]
            ends = self._argument(call, 1, _NAME_WORDS), self._argument(call, 0, _TYPE_WORDS)
            if ends[0] is not None and ends[1] is not None:
                yield from self._port(call, role, *ends, "srv" if role.is_service else "msg")
        elif last in _ACTIONS and path.startswith("actionlib."):
            ends = self._argument(call, 0, _NAME_WORDS), self._argument(call, 1, _TYPE_WORDS)
            for port in self._port(call, Role.SERVES, *ends, "msg"):
                yield from action_ports(_ACTIONS[last], port)
        elif last in _ACTIONS and path.startswith("rclpy.action."):
            ends = self._argument(call, 2, _NAME_WORDS), self._argument(call, 1, _TYPE_WORDS)
            for port in self._port(call, Role.SERVES, *ends, "action"):
                yield from action_ports(_ACTIONS[last], port)
        elif last in BROADCASTERS and path.partition(".")[0] in ("tf", "tf2_ros"):
            yield CodePort(Role.PUBLISHES, (BROADCASTERS[last],), MessageType("tf2_msgs", "TFMessage"), self._at(call))

    def _port(
        self, call: ast.Call, role: Role, name: ast.expr | None, kind: ast.expr | None, words: TypeKind
    ) -> Iterator[CodePort]:
        meant = None if name is None else self._name(name, 0)
        if meant is None:
            said = "" if name is None else ast.unparse(name)[:60]
            self._unclear.append(f"{role.value} `{said}` at {self._at(call)}")
        else:
            yield CodePort(role, meant, None if kind is None else self._type(kind, words), self._at(call))

    def _at(self, node: ast.expr) -> Place:
        return Place(self._file, node.lineno)

    @staticmethod
    def _argument(call: ast.Call, at: int, names: tuple[str, ...]) -> ast.expr | None:
        if at < len(call.args):
            return None if any(isinstance(each, ast.Starred) for each in call.args[: at + 1]) else call.args[at]
        return next((each.value for each in call.keywords if each.arg in names), None)

    @cached_property
    def _imports(self) -> Mapping[str, str]:
        """The dotted name of each imported name."""
        found: dict[str, str] = {}
        for node in ast.walk(self._tree):
            if isinstance(node, ast.Import):
                for alias in node.names:
                    found[alias.asname or alias.name.partition(".")[0]] = (
                        alias.name if alias.asname else alias.name.partition(".")[0]
                    )
            elif isinstance(node, ast.ImportFrom):
                for alias in node.names:
                    found[alias.asname or alias.name] = f"{node.module or ''}.{alias.name}"
        return found

    @cached_property
    def _stars(self) -> list[str]:
        """The modules imported with `*`."""
        return [
            node.module or ""
            for node in ast.walk(self._tree)
            if isinstance(node, ast.ImportFrom) and any(alias.name == "*" for alias in node.names)
        ]

    def _path(self, node: ast.expr) -> str:
        """Return an expression's dotted name, with imported names in full; "" if it is not a dotted name."""
        if isinstance(node, ast.Name):
            return self._imports.get(node.id, node.id)
        if isinstance(node, ast.Attribute):
            inner = self._path(node.value)
            return f"{inner}.{node.attr}" if inner else node.attr
        return ""

    def _type(self, node: ast.expr, words: TypeKind) -> MessageType | None:
        path = self._path(node)
        if isinstance(node, ast.Name) and node.id not in self._imports:
            modules = [module for module in self._stars if module.endswith((".msg", ".srv", ".action"))]
            path = f"{modules[0]}.{node.id}" if len(modules) == 1 else ""
        package, _, rest = path.partition(".")
        if rest.partition(".")[0] not in ("msg", "srv", "action"):
            return None
        kind, _, name = rest.partition(".")
        return type_of(f"{package}.{kind}.{name.rpartition('.')[2]}", words)

    def _name(self, node: ast.expr, steps: int) -> CodeName | None:
        """The parts of a text that an expression makes; None if it is computed."""
        if steps > MOST_STEPS:
            return None
        match node:
            case ast.Constant(str(text)):
                return (text,)
            case ast.JoinedStr(values):
                return self._joined(values, steps)
            case ast.FormattedValue(value, -1, None):
                return self._name(value, steps + 1)
            case ast.BinOp(left, ast.Add(), right):
                return self._joined([left, right], steps)
            case ast.BinOp(ast.Constant(str(text)), ast.Mod(), right):
                values = right.elts if isinstance(right, ast.Tuple) else [right]
                return self._filled(text.split("%s"), values, steps)
            case ast.Call(ast.Name("str"), [inner]):
                return self._name(inner, steps + 1)
            case ast.Call(ast.Attribute(ast.Constant(str(text)), "format"), values, []):
                return self._filled(text.split("{}"), values, steps)
            case ast.Call(ast.Attribute(inner, word), []) if word in _VALUES:
                return self._name(inner, steps + 1)
            case ast.Call(ast.Attribute(inner, word), [ast.Constant(str(name)), *default]) if word in _PARAMETERS:
                return self._parameter(word, name, default, self._path(inner) == "rospy", steps)
            case ast.Attribute(inner, word) if word in _VALUES and isinstance(inner, ast.Call | ast.Name):
                return self._name(inner, steps + 1)
            case ast.Attribute(ast.Name("self"), word):
                return self._only([*self._attributes.get((self._class_of(node), word), ())], steps)
            case ast.Name(word):
                return self._variable(node, word, steps)
        return None

    def _joined(self, values: list[ast.expr], steps: int) -> CodeName | None:
        parts = [self._name(each, steps + 1) for each in values]
        return None if None in parts else tuple(one for part in parts for one in part or ())

    def _filled(self, pieces: list[str], values: list[ast.expr], steps: int) -> CodeName | None:
        if len(pieces) != len(values) + 1 or any("%" in piece or "{" in piece for piece in pieces):
            return None
        texts: list[ast.expr] = [ast.Constant(piece) for piece in pieces]
        return self._joined([each for pair in zip(texts, values, strict=False) for each in pair] + texts[-1:], steps)

    def _parameter(self, word: str, name: str, default: list[ast.expr], is_rospy: bool, steps: int) -> CodeName | None:
        given = self._name(default[0], steps + 1) if default else None
        if default and (given is None or len(given) != 1 or not isinstance(given[0], str)):
            return None
        if not default and word in ("get_parameter", "get_parameter_or"):
            given = self._declared.get(name)
        text = given[0] if given else None
        private = name if is_rospy else f"~{name}"
        return (Parameter(private, text if isinstance(text, str) else None),)

    @cached_property
    def _declared(self) -> Mapping[str, CodeName]:
        """The defaults of declared parameters that are plain texts."""
        found: dict[str, CodeName] = {}
        for node in ast.walk(self._tree):
            match node:
                case ast.Call(
                    ast.Attribute(_, "declare_parameter"), [ast.Constant(str(name)), ast.Constant(str(text))]
                ):
                    found[name] = (text,)
                case ast.Call(ast.Attribute(_, "declare_parameters"), _, _):
                    for pair in ast.walk(node):
                        match pair:
                            case ast.Tuple([ast.Constant(str(name)), ast.Constant(str(text))]):
                                found[name] = (text,)
        return found

    def _variable(self, node: ast.AST, word: str, steps: int) -> CodeName | None:
        """Return the name that a variable holds, looked up in the enclosing functions and in the module; None if
        unknown.
        """
        scope = self._scope_of(node)
        while scope is not None:
            if isinstance(scope, ast.FunctionDef | ast.AsyncFunctionDef):
                arguments = scope.args
                own = [
                    *arguments.posonlyargs,
                    *arguments.args,
                    *arguments.kwonlyargs,
                    arguments.vararg,
                    arguments.kwarg,
                ]
                if any(each is not None and each.arg == word for each in own):
                    return None
            values = self._assigned.get((scope, word))
            if values is not None:
                return self._only(values, steps)
            scope = self._scope_of(scope)
        return None

    def _only(self, values: list[ast.expr | None], steps: int) -> CodeName | None:
        """The one text that all values are."""
        names = {None if each is None else self._name(each, steps + 1) for each in values}
        return names.pop() if len(names) == 1 else None

    @cached_property
    def _assigned(self) -> Mapping[tuple[ast.AST, str], list[ast.expr | None]]:
        """The values that each variable of each scope gets; None stands for one that is no plain assignment."""
        found: dict[tuple[ast.AST, str], list[ast.expr | None]] = defaultdict(list)
        for node in ast.walk(self._tree):
            if not isinstance(node, ast.Name) or not isinstance(node.ctx, ast.Store):
                continue
            scope = self._scope_of(node) or self._tree
            if any(isinstance(each, ast.Global) and node.id in each.names for each in ast.walk(scope)):
                scope = self._tree
            found[scope, node.id].append(self._value_of(node))
        return found

    @cached_property
    def _attributes(self) -> Mapping[tuple[ast.AST | None, str], list[ast.expr | None]]:
        """The values that each attribute of `self` gets in each class."""
        found: dict[tuple[ast.AST | None, str], list[ast.expr | None]] = defaultdict(list)
        for node in ast.walk(self._tree):
            match node:
                case ast.Attribute(ast.Name("self"), word, ast.Store()):
                    found[self._class_of(node), word].append(self._value_of(node))
                case ast.Name(word, ast.Store()) if isinstance(self._scope_of(node), ast.ClassDef):
                    found[self._class_of(node), word].append(self._value_of(node))
        return found

    def _value_of(self, target: ast.expr) -> ast.expr | None:
        above = self._above.get(target)
        if isinstance(above, ast.Assign) and target in above.targets:
            return above.value
        return above.value if isinstance(above, ast.AnnAssign) else None

    def _scope_of(self, node: ast.AST) -> _Block | None:
        above = self._above.get(node)
        while above is not None and not isinstance(above, _Block):
            above = self._above.get(above)
        return above

    def _class_of(self, node: ast.AST) -> ast.AST | None:
        above = self._above.get(node)
        while above is not None and not isinstance(above, ast.ClassDef):
            above = self._above.get(above)
        return above
