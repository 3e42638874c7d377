"""The liveliness tokens by which `rmw_zenoh` tells a ROS 2 graph over Zenoh, as values and as text.

A token is a key below `@ros2_lv`: who it belongs to, what it is, and, but for a node, its topic or service, its type,
the type's hash and the quality of service. References: the design document of ros2/rmw_zenoh, the quality of service
policies of ros2/rmw.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Literal, TypeAlias, TypeVar, get_args

from cfgplan.errors import InputError
from cfgplan.ros.types import MessageType

ADMIN_SPACE: Final = "@ros2_lv"
EndpointKind: TypeAlias = Literal["publisher", "subscription", "service", "client"]
ReliabilityPolicy: TypeAlias = Literal["system_default", "reliable", "best_effort", "unknown", "best_available"]
DurabilityPolicy: TypeAlias = Literal["system_default", "transient_local", "volatile", "unknown", "best_available"]
HistoryPolicy: TypeAlias = Literal["system_default", "keep_last", "keep_all", "unknown"]
LivelinessPolicy: TypeAlias = Literal[
    "system_default", "automatic", "manual_by_node", "manual_by_topic", "unknown", "best_available"
]
_RELIABILITIES: tuple[ReliabilityPolicy, ...] = get_args(ReliabilityPolicy)
_DURABILITIES: tuple[DurabilityPolicy, ...] = get_args(DurabilityPolicy)
_HISTORIES: tuple[HistoryPolicy, ...] = get_args(HistoryPolicy)
_LIVELINESSES: tuple[LivelinessPolicy, ...] = get_args(LivelinessPolicy)
"""A policy's number on the wire is its place among the values of its type."""
_NODE = "NN"
_ENDPOINTS: Mapping[str, EndpointKind] = {"MP": "publisher", "MS": "subscription", "SS": "service", "SC": "client"}
_MARKS = {kind: mark for mark, kind in _ENDPOINTS.items()}
_INFINITE_NS = 9_223_372_036_854_775_807
_NODE_PARTS, _ENDPOINT_PARTS = 9, 13
_PART = re.compile(r"[^/*$?#]+")
T = TypeVar("T", bound=str)


@dataclass(frozen=True, slots=True, order=True)
class Qos:
    """The quality of service of an endpoint; the defaults are those of rmw_zenoh. Durations are in nanoseconds."""

    reliability: ReliabilityPolicy = "reliable"
    durability: DurabilityPolicy = "volatile"
    history: HistoryPolicy = "keep_last"
    depth: int = 42
    deadline_ns: int = _INFINITE_NS
    lifespan_ns: int = _INFINITE_NS
    liveliness: LivelinessPolicy = "automatic"
    lease_ns: int = _INFINITE_NS

    @classmethod
    def read(cls, text: str) -> Qos:
        """The quality of service in a token: six parts, each empty where it is the default. Raises InputError."""
        try:
            reliability, durability, history, deadline, lifespan, liveliness = text.split(":")[:6]
            kind, depth = history.split(",")
            alive, *lease = liveliness.split(",")
            return cls(
                _named(reliability, _RELIABILITIES, cls().reliability),
                _named(durability, _DURABILITIES, cls().durability),
                _named(kind, _HISTORIES, cls().history),
                int(depth) if depth else cls().depth,
                _nanoseconds(deadline.split(",")),
                _nanoseconds(lifespan.split(",")),
                _named(alive, _LIVELINESSES, cls().liveliness),
                _nanoseconds(lease),
            )
        except (ValueError, IndexError):
            raise InputError.of(f"`{text}` is no quality of service of a liveliness token") from None

    def __str__(self) -> str:
        usual = Qos()
        return ":".join(
            [
                _number(self.reliability, _RELIABILITIES, usual.reliability),
                _number(self.durability, _DURABILITIES, usual.durability),
                f"{_number(self.history, _HISTORIES, usual.history)},{_unless(self.depth, usual.depth)}",
                _duration(self.deadline_ns),
                _duration(self.lifespan_ns),
                f"{_number(self.liveliness, _LIVELINESSES, usual.liveliness)},{_duration(self.lease_ns)}",
            ]
        )


@dataclass(frozen=True, slots=True, order=True)
class NodeToken:
    """A node is alive. `session` is the id of its Zenoh session, `number` its own within that."""

    domain: int
    session: str
    number: int
    name: str
    namespace: str = "/"
    enclave: str = "/"

    @property
    def full_name(self) -> str:
        """The node's name with its namespace: `/robot/camera`."""
        return f"{self.namespace.rstrip('/')}/{self.name}"

    def __str__(self) -> str:
        return "/".join(self.parts(self.number, _NODE))

    def parts(self, number: int, mark: str) -> list[str]:
        """The first parts of the token of the node, or of the endpoint of this number."""
        ids = [str(self.domain), self.session, str(self.number), str(number)]
        return [ADMIN_SPACE, *ids, mark, *map(_mangled, (self.enclave, self.namespace, self.name))]


@dataclass(frozen=True, slots=True, order=True)
class EndpointToken:
    """A publisher, a subscription, a service's server or its client is alive. `topic` is the name of a service too."""

    node: NodeToken
    number: int
    kind: EndpointKind
    topic: str
    type: MessageType
    type_hash: str
    """`RIHS01_` and 64 hexadecimal digits."""
    qos: Qos = Qos()
    more: tuple[str, ...] = ()
    """Further parts, which newer versions of rmw_zenoh tell; they are kept as they are."""

    @property
    def key(self) -> str:
        """Where its messages, requests and replies are put."""
        return f"{self.node.domain}/{self.topic.strip('/')}/{self.type.dds}/{self.type_hash}"

    def __str__(self) -> str:
        own = [_mangled(self.topic), self.type.dds, self.type_hash, str(self.qos)]
        return "/".join([*self.node.parts(self.number, _MARKS[self.kind]), *own, *self.more])


LivelinessToken: TypeAlias = NodeToken | EndpointToken


def read_token(text: str) -> LivelinessToken:
    """The token that a key is. Raises InputError if it is none, or has a type that is none of ROS."""
    parts = text.split("/")
    mark = parts[5] if len(parts) > 5 else ""
    needed = _ENDPOINT_PARTS if mark in _ENDPOINTS else _NODE_PARTS
    is_whole = len(parts) >= needed and all(map(_PART.fullmatch, parts)) and mark in {_NODE, *_ENDPOINTS}
    numbers = [*parts[1:2], *parts[3:5]]
    if not is_whole or parts[0] != ADMIN_SPACE or not all(map(str.isdecimal, numbers)):
        mend = f"one has the form {ADMIN_SPACE}/domain/session/node/number/kind/enclave/namespace/name"
        raise InputError.of(f"`{text}` is no liveliness token", mend=mend)
    domain, node_number, number = map(int, numbers)
    enclave, namespace, name = map(_demangled, parts[6:9])
    node = NodeToken(domain, parts[2], node_number, name, namespace, enclave)
    if mark == _NODE:
        return node
    topic, dds, type_hash = map(_demangled, parts[9:12])
    return EndpointToken(
        node,
        number,
        _ENDPOINTS[mark],
        topic,
        MessageType.read(dds),
        type_hash,
        Qos.read(parts[12]),
        tuple(parts[_ENDPOINT_PARTS:]),
    )


def all_tokens(domain: int) -> str:
    """The key expression of every token of a domain."""
    return f"{ADMIN_SPACE}/{domain}/**"


def _mangled(name: str) -> str:
    return name.replace("/", "%")


def _demangled(part: str) -> str:
    return part.replace("%", "/")


def _named(number: str, names: Sequence[T], usual: T) -> T:
    return names[int(number)] if number else usual


def _number(name: T, names: Sequence[T], usual: T) -> str:
    return _unless(names.index(name), names.index(usual))


def _unless(number: int, usual: int) -> str:
    return "" if number == usual else str(number)


def _nanoseconds(parts: Sequence[str]) -> int:
    """A duration of seconds and nanoseconds; each is that of an infinite one where it is empty."""
    usual = divmod(_INFINITE_NS, 10**9)
    seconds, rest = (int(part) if part else one for part, one in zip(parts, usual, strict=True))
    return seconds * 10**9 + rest


def _duration(nanoseconds: int) -> str:
    pairs = zip(divmod(nanoseconds, 10**9), divmod(_INFINITE_NS, 10**9), strict=True)
    return ",".join(_unless(part, usual) for part, usual in pairs)
