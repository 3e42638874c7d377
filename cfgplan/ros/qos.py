"""Quality of service in ROS 2: reasons why a subscription does not hear a publisher.

Reference: OMG DDS 1.4, section 2.2.3.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass


@dataclass(frozen=True, slots=True, order=True)
class ServiceQuality:
    """A quality of service, offered or asked for; `deadline_s` and `lease_s` are None if not set.

    The default of ROS 2 is reliable and volatile. With `manual`, a node has to assert its liveliness itself.
    """

    reliable: bool = True
    transient_local: bool = False
    deadline_s: float | None = None
    lease_s: float | None = None
    manual: bool = False

    @classmethod
    def read(cls, text: str) -> ServiceQuality:
        """The value of words such as `best_effort volatile deadline=0.1`, in any order; the last of a kind counts."""
        words = text.split()
        times = dict(word.split("=", 1) for word in words if "=" in word)
        said = {word for word in words if "=" not in word}
        return cls(
            reliable="best_effort" not in said,
            transient_local="transient_local" in said,
            deadline_s=float(times["deadline"]) if "deadline" in times else None,
            lease_s=float(times["lease"]) if "lease" in times else None,
            manual="manual" in said,
        )

    def __str__(self) -> str:
        words = ["reliable" if self.reliable else "best_effort", "transient_local" if self.transient_local else ""]
        words += [f"deadline={self.deadline_s:g}" if self.deadline_s is not None else ""]
        words += [f"lease={self.lease_s:g}" if self.lease_s is not None else "", "manual" if self.manual else ""]
        return " ".join(word for word in words if word)


def obstacles(offered: ServiceQuality, asked: ServiceQuality) -> Iterator[str]:
    """Each reason why a subscription that asks so hears nothing of a publisher that offers so."""
    if asked.reliable and not offered.reliable:
        yield "it asks for reliable messages, and best effort is offered"
    if asked.transient_local and not offered.transient_local:
        yield "it asks for messages from before it came (transient_local), and they are not kept"
    if _is_later(offered.deadline_s, asked.deadline_s):
        yield f"it asks for a message every {asked.deadline_s:g} s (deadline), which is not promised"
    if asked.manual and not offered.manual:
        yield "it asks that the node itself says that it lives (manual), and only its middleware does"
    if _is_later(offered.lease_s, asked.lease_s):
        yield f"it asks for a sign of life every {asked.lease_s:g} s (lease), which is not promised"


def _is_later(offered_s: float | None, asked_s: float | None) -> bool:
    return asked_s is not None and (offered_s is None or offered_s > asked_s)
