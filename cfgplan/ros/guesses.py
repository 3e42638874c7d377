"""The guesses of an import: a table of well-known types, topics and nodes, and the user's own tables."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from contextlib import suppress
from fnmatch import fnmatchcase
from functools import cache
from pathlib import Path
from typing import Annotated, Literal, TypeAlias

from pydantic import AfterValidator, BaseModel, ConfigDict, ValidationError, model_validator
from pydantic_core import PydanticCustomError

from cfgplan.errors import InputError
from cfgplan.formats.files import read_source
from cfgplan.formats.schema_faults import schema_faults
from cfgplan.ros.graph import Role, RosNode, RosPort, node_port
from cfgplan.ros.types import MessageType

TABLE = Path(__file__).with_name("guesses.yaml")
_ARGUMENT = re.compile(r"\{([1-9]|--[a-z-]+)\}")
Feedback: TypeAlias = bool | Literal["in_cycles"]
"""Whether an input may close a cycle: never, always, or where it lies on one."""


def _type_text(text: str) -> str:
    try:
        MessageType.read(text)
    except InputError as error:
        fault = error.faults[0]
        said = {"text": fault.message, "mend": fault.mend}
        raise PydanticCustomError("value", "{text}", said) from None
    return text


TypeText: TypeAlias = Annotated[str, AfterValidator(_type_text)]


class _Rows(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)


class InputGuess(_Rows):
    """A row about inputs that fit the given patterns of type, topic and node; it says only the words that are given."""

    type: str | None = None
    topic: str | None = None
    node: str | None = None
    optional: bool | None = None
    several: bool | None = None
    feedback: Feedback | None = None
    why: str = "the table says so"

    @model_validator(mode="after")
    def _has_a_pattern(self) -> InputGuess:
        if self.type is None and self.topic is None and self.node is None:
            mend = "add `type`, `topic` or `node`"
            raise PydanticCustomError(
                "value", "{text}", {"text": "this row does not say which inputs it is about", "mend": mend}
            )
        return self

    def fits(self, node: str, port: RosPort) -> bool:
        """Whether it is about an input of a node."""
        if self.type is not None and not (port.type and _fits(self.type, port.type)):
            return False
        return fnmatchcase(port.name, self.topic or "*") and fnmatchcase(node, self.node or "*")


def _fits(pattern: str, kind: MessageType) -> bool:
    return any(fnmatchcase(text, pattern) for text in (kind.ros1, kind.ros2, kind.dds))


class NoiseGuess(_Rows):
    """Patterns of names that every graph has, and of nodes that only observe."""

    topics: list[str] = []
    services: list[str] = []
    nodes: list[str] = []


class NodeGuess(_Rows):
    """The ports of a node by the names in its code, each with its type or null."""

    publishes: dict[str, TypeText | None] = {}
    subscribes: dict[str, TypeText | None] = {}
    serves: dict[str, TypeText | None] = {}
    calls: dict[str, TypeText | None] = {}

    @property
    def ports(self) -> list[tuple[Role, str, MessageType | None]]:
        """Its ports as role, name and type."""
        return [
            (role, name, MessageType.read(text, "srv" if role.is_service else "msg") if text else None)
            for role in Role
            for name, text in getattr(self, role.value).items()
        ]


class GuessTable(_Rows):
    """Rows in order of precedence. `wanted` are patterns of the nodes that have to run; None: they are guessed."""

    inputs: list[InputGuess] = []
    noise: NoiseGuess = NoiseGuess()
    nodes: dict[str, NodeGuess] = {}
    wanted: list[str] | None = None

    def says(self, node: str, port: RosPort, word: Literal["optional", "several", "feedback"]) -> InputGuess | None:
        """The first row that says a word about an input; None if none does."""
        return next((row for row in self.inputs if getattr(row, word) is not None and row.fits(node, port)), None)

    def ports_of(self, node: RosNode) -> tuple[RosPort, ...] | None:
        """Return the ports of a node's plugin or executable, after its remappings; None if the table lacks it.

        A name `{1}` stands for the first argument of the command line; the port is omitted if that is missing.
        `{--namespace}` stands for the value of that option and a slash, or for nothing if the option is missing.
        """
        known = self.nodes.get(node.plugin or f"{node.package}/{node.executable}")
        if known is None:
            return None
        ports = []
        for role, own, kind in known.ports:
            with suppress(IndexError):
                meant = _ARGUMENT.sub(lambda found: _said(node.arguments, found[1]), own)
                ports.append(node_port(node, role, meant, kind))
        return tuple(ports)

    def is_noise(self, node: str) -> bool:
        """Return whether a node only observes."""
        return _any(self.noise.nodes, node)

    def is_noisy(self, port: RosPort) -> bool:
        """Whether the port's topic or service is one that every graph has, such as /rosout."""
        return _any(self.noise.services if port.role.is_service else self.noise.topics, port.name)


def _said(arguments: Sequence[str], place: str) -> str:
    """Return the argument at a place, or an option's value and a slash. Raises IndexError for a missing argument."""
    if place.isdecimal():
        return arguments[int(place) - 1]
    for at, argument in enumerate(arguments):
        option, equals, value = argument.partition("=")
        if option == place:
            value = value if equals else next(iter(arguments[at + 1 :]), "")
            return value and f"{value.rstrip('/')}/"
    return ""


def _any(patterns: Sequence[str], name: str) -> bool:
    return any(fnmatchcase(name, pattern) for pattern in patterns)


def guess_table(files: Iterable[Path] = ()) -> GuessTable:
    """Return the rows of the files, followed by those of this room's own table. Raises InputError."""
    read = [*map(_read, files), _own()]
    return GuessTable(
        inputs=[row for file in read for row in file.inputs],
        noise=NoiseGuess(
            **{name: [each for file in read for each in getattr(file.noise, name)] for name in NoiseGuess.model_fields}
        ),
        nodes={name: ports for file in reversed(read) for name, ports in file.nodes.items()},
        wanted=next((file.wanted for file in read if file.wanted is not None), None),
    )


@cache
def _own() -> GuessTable:
    return _read(TABLE)


def _read(path: Path) -> GuessTable:
    source = read_source(path)
    if source.faults:
        raise InputError(source.faults)
    try:
        return GuessTable.model_validate({} if source.data is None else source.data)
    except ValidationError as error:
        raise InputError(schema_faults(source, (), error.errors(include_url=False), GuessTable)) from None
