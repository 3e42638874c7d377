"""A ROS 2 node over Zenoh, as `rmw_zenoh` has them: its publishers, its subscriptions, and what others tell of theirs.

References: the design document of ros2/rmw_zenoh, and what its publishers and subscriptions declare.
"""

from __future__ import annotations

import re
import struct
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from cfgplan.errors import InputError
from cfgplan.extras import needed
from cfgplan.ros import EndpointToken, NodeToken, Qos, read_token
from cfgplan.ros.liveliness import ADMIN_SPACE, EndpointKind
from cfgplan.ros.zenoh_config import first_line, ros_domain, zenoh_config
from cfgplan_runtime.errors import RuntimeFaultError
from cfgplan_runtime.ros2.message_form import MessageForm

if TYPE_CHECKING:
    import zenoh

_ATTACHMENT = struct.Struct("<qqB16s")
"""Sequence number, time in nanoseconds since the epoch, and the publisher's id with its length."""
_HEARTBEAT_S = 0.5
_CONNECT_S, _CONNECT_LOOK_S = 3.0, 0.05
_SESSION_CLOSE_S = 2.0
_ROS_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")

Take = Callable[[bytes, int], None]
"""Called with a message in CDR and when it was published (nanoseconds since the epoch), in threads of Zenoh's."""


class RosSession:
    """One node. Its router is at `connect`, else where the variables of `rmw_zenoh` say, else on this computer.

    ROS_DOMAIN_ID holds where `domain` is None. Raises InputError.
    """

    def __init__(self, node: str, *, domain: int | None = None, connect: Sequence[str] = ()) -> None:
        check_installed()
        import zenoh

        self._zenoh = zenoh
        self._config = zenoh_config(connect)
        try:
            self._session = zenoh.open(self._config)
        except zenoh.ZError as error:
            mend = "see the endpoints, ZENOH_SESSION_CONFIG_URI and ZENOH_CONFIG_OVERRIDE"
            raise InputError.of(f"no session of Zenoh can be opened: {first_line(error)}", mend=mend) from None
        self._numbers = iter(range(1 << 31))
        self._kept: list[Any] = []
        """What Zenoh ends when the last reference to it is gone."""
        space, _, name = checked_name(node, "node").rpartition("/")
        self.node = NodeToken(
            ros_domain(domain), str(self._session.info.zid()), next(self._numbers), name, space or "/"
        )
        self._live(str(self.node))

    def tell_if_alone(self, tell: Callable[[str], None]) -> None:
        """Tell if after some seconds neither a router nor another peer is reached."""
        end = time.monotonic() + _CONNECT_S
        while time.monotonic() < end:
            if self._session.is_closed() or self._session.info.routers_zid() or self._session.info.peers_zid():
                return
            time.sleep(_CONNECT_LOOK_S)
        where = self._config.get_json("connect/endpoints")
        tell(f"no Zenoh router is reached at {where} yet; one is started by `ros2 run rmw_zenoh_cpp rmw_zenohd`")

    def publisher(self, topic: str, form: MessageForm, qos: Qos) -> RosPublisher:
        """Begin to publish a topic. Raises InputError."""
        ext, zenoh = self._zenoh.ext, self._zenoh
        endpoint = self._endpoint("publisher", topic, form, qos)
        is_reliable, keeps = qos.reliability == "reliable", qos.durability == "transient_local"
        miss = ext.MissDetectionConfig(heartbeat=None, sporadic_heartbeat=_HEARTBEAT_S)
        publisher = ext.declare_advanced_publisher(
            self._session,
            endpoint.key,
            congestion_control=zenoh.CongestionControl.DROP,
            reliability=zenoh.Reliability.RELIABLE if is_reliable else zenoh.Reliability.BEST_EFFORT,
            express=True,
            cache=ext.CacheConfig(qos.depth) if keeps else None,
            sample_miss_detection=miss if keeps and is_reliable else None,
            publisher_detection=keeps,
        )
        token = self._session.liveliness().declare_token(str(endpoint))
        published = RosPublisher(endpoint, publisher, token, self._kept.remove)
        self._kept.append(published)
        return published

    def subscribe(self, topic: str, form: MessageForm, qos: Qos, take: Take) -> None:
        """Call `take` with each message of a topic from now on, with transient local also with the last ones before.

        Raises InputError.
        """
        ext = self._zenoh.ext
        endpoint = self._endpoint("subscription", topic, form, qos)
        keeps = qos.durability == "transient_local"
        recovers = keeps and qos.reliability == "reliable"

        def tell(sample: zenoh.Sample) -> None:
            head = b"" if sample.attachment is None else sample.attachment.to_bytes()
            time_ns = _ATTACHMENT.unpack_from(head)[1] if len(head) >= _ATTACHMENT.size else time.time_ns()
            take(sample.payload.to_bytes(), time_ns)

        subscriber = ext.declare_advanced_subscriber(
            self._session,
            endpoint.key,
            tell,
            history=ext.HistoryConfig(detect_late_publishers=True, max_samples=qos.depth) if keeps else None,
            recovery=ext.RecoveryConfig(periodic_queries=None, heartbeat=True) if recovers else None,
            subscriber_detection=keeps,
        )
        self._kept.append(subscriber)
        self._live(str(endpoint))

    def watch_publishers(self, topic: str, tell: Callable[[EndpointToken], None]) -> None:
        """Call `tell` with each publisher of a topic, now and later, whatever its type. Zenoh's threads call it."""
        mangled = topic.replace("/", "%")
        keys = f"{ADMIN_SPACE}/{self.node.domain}/*/*/*/MP/*/*/*/{mangled}/**"
        put = self._zenoh.SampleKind.PUT

        def hear(sample: zenoh.Sample) -> None:
            with suppress(InputError):  # it is told in a way that is not known
                token = read_token(str(sample.key_expr))
                if sample.kind == put and isinstance(token, EndpointToken):
                    tell(token)

        self._kept.append(self._session.liveliness().declare_subscriber(keys, hear, history=True))

    def close(self) -> None:
        """End the node. A session that does not close in time is left to itself."""
        thread = threading.Thread(target=self._session.close, daemon=True)
        thread.start()
        thread.join(_SESSION_CLOSE_S)

    def _live(self, key: str) -> None:
        self._kept.append(self._session.liveliness().declare_token(key))

    def _endpoint(self, kind: EndpointKind, topic: str, form: MessageForm, qos: Qos) -> EndpointToken:
        name = checked_name(topic, "topic")
        return EndpointToken(self.node, next(self._numbers), kind, name, form.type, form.type_hash, qos)


class RosPublisher:
    """A topic that a node publishes, until it is closed, or its session is."""

    def __init__(
        self, endpoint: EndpointToken, publisher: Any, token: Any, forget: Callable[[RosPublisher], None]
    ) -> None:
        self._endpoint = endpoint
        self._publisher = publisher
        self._token = token
        self._forget = forget
        self._id = _id_of(endpoint)
        self._numbers = iter(range(1, 1 << 62))

    def put(self, message: bytes | bytearray, time_ns: int) -> None:
        """Publish a message in CDR as of a time. Raises RuntimeFaultError once the topic is closed."""
        import zenoh

        head = _ATTACHMENT.pack(next(self._numbers), time_ns, len(self._id), self._id)
        try:
            self._publisher.put(zenoh.ZBytes(message), attachment=head)
        except zenoh.ZError as error:
            raise RuntimeFaultError(f"{self._endpoint.topic}: {first_line(error)}") from None

    def close(self) -> None:
        """Publish the topic no more. To be called once."""
        self._forget(self)
        self._token.undeclare()
        self._publisher.undeclare()


def check_installed() -> None:
    """Raises InputError, which names the extra, if what ROS 2 topics need is not installed."""
    needed("ROS 2 topics", "rosbags", "xxhash", "zenoh")


def checked_name(name: str, what: str) -> str:
    """A name with its namespace, from the root. Raises InputError if ROS 2 allows none such."""
    parts = name.removeprefix("/").split("/")
    if not all(map(_ROS_NAME.fullmatch, parts)):
        mend = "it is made of letters, digits and underscores, each part after a `/`, none with a digit first"
        raise InputError.of(f"`{name}` can't be the name of a ROS 2 {what}", mend=mend)
    return "/" + "/".join(parts)


def _id_of(endpoint: EndpointToken) -> bytes:
    """The id of an endpoint: the hash of its token, 16 bytes, the lower half first."""
    import xxhash

    return xxhash.xxh3_128_intdigest(str(endpoint).encode()).to_bytes(16, "little")
