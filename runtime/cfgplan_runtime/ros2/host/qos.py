"""Qualities of service of the helper's endpoints, which are compatible with every endpoint of a topic."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, HistoryPolicy, LivelinessPolicy, QoSProfile, ReliabilityPolicy

_INFINITE_NS = (1 << 63) - 1


class Quality(NamedTuple):
    """The quality of service that the helper asks or offers at its end of a topic, without its depth."""

    is_reliable: bool = True
    is_latched: bool = False
    deadline_ns: int = 0
    lease_ns: int = 0
    is_manual: bool = False
    """Whether the node itself has to say that it lives. Deadline and lease are 0 if there is none."""

    def profile(self, depth: int) -> QoSProfile:
        """This as rclpy takes it."""
        return QoSProfile(
            history=HistoryPolicy.KEEP_LAST,
            depth=max(1, depth),
            reliability=ReliabilityPolicy.RELIABLE if self.is_reliable else ReliabilityPolicy.BEST_EFFORT,
            durability=DurabilityPolicy.TRANSIENT_LOCAL if self.is_latched else DurabilityPolicy.VOLATILE,
            deadline=Duration(nanoseconds=self.deadline_ns),
            liveliness=LivelinessPolicy.MANUAL_BY_TOPIC if self.is_manual else LivelinessPolicy.AUTOMATIC,
            liveliness_lease_duration=Duration(nanoseconds=self.lease_ns),
        )


def asked_of(publishers: Sequence[Any]) -> Quality:
    """Return the strongest quality that a subscription may ask and still hear all `publishers`."""
    return Quality(all(map(_is_reliable, publishers)), all(map(_is_latched, publishers)))


def offered_to(subscriptions: Sequence[Any], *, is_latched: bool) -> Quality:
    """Return the weakest quality that a publisher has to offer so that all `subscriptions` hear it."""
    profiles = [one.qos_profile for one in subscriptions]
    deadlines = [ns for one in profiles if (ns := _finite(one.deadline))]
    leases = [ns for one in profiles if (ns := _finite(one.liveliness_lease_duration))]
    return Quality(
        True,
        is_latched or any(map(_is_latched, subscriptions)),
        min(deadlines, default=0),
        min(leases, default=0),
        any(one.liveliness == LivelinessPolicy.MANUAL_BY_TOPIC for one in profiles),
    )


def mended(publishers: Sequence[Any], subscriptions: Sequence[Any]) -> list[str]:
    """Return the mismatches that would keep subscriptions from hearing the publishers without a relay."""
    if not publishers:
        return []
    words = []
    if not all(map(_is_reliable, publishers)) and any(map(_is_reliable, subscriptions)):
        words.append("asks for reliable messages and is given best effort")
    if not all(map(_is_latched, publishers)) and any(map(_is_latched, subscriptions)):
        words.append("asks for messages from before it came (transient local), which are not kept")
    return words


def _is_reliable(endpoint: Any) -> bool:
    return bool(endpoint.qos_profile.reliability != ReliabilityPolicy.BEST_EFFORT)


def _is_latched(endpoint: Any) -> bool:
    return bool(endpoint.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL)


def _finite(duration: Duration) -> int:
    """The nanoseconds of a duration; 0 for none, which some middlewares tell as the longest there is."""
    return 0 if duration.nanoseconds >= _INFINITE_NS // 2 else int(duration.nanoseconds)
