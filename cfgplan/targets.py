"""Targets: the streams and units that are wanted from outside (paper, section III, Definition 4)."""

from __future__ import annotations

from dataclasses import dataclass
from operator import attrgetter
from typing import Annotated

from cfgplan.arguments import Natural, checked
from cfgplan.canonical import refuse_duplicates, store_sorted
from cfgplan.errors import InvalidValueError
from cfgplan.facts import Fact
from cfgplan.qualities import Wish
from cfgplan.rows import ELEMENT, LARGEST_AMOUNT, Feature, Row, Use

A_UNIT_OF = "a unit of "
"""Before a label this is a tag that no port has: the demand for a unit of that transformation."""


@dataclass(frozen=True, slots=True)
@checked
class Target:
    """A semantic subscription from outside (Definition 4), identified by its `label`: a stream of this `tag` comes
    on its `topic`. A larger `priority` matters more.

    `quality` are its demands on the stream. With a `host`, the stream has to be carried there. In a run it counts as
    unmet if no element has come for `silent_us` microseconds; planning ignores that. `type` is the message type of its
    topic in ROS.
    A target that wants a running unit of the transformation `run` instead of a stream has no topic, and A_UNIT_OF that
    transformation as its tag.
    """

    label: Annotated[
        str, Row("the name of the target; unique; contains every template variable of the target", xml=ELEMENT)
    ]
    tag: Annotated[
        str,
        Row(
            "the wanted information: a concept in description logic, or the paper's P(a); needed without `run`",
            form="TagText",
            absent=None,
            xml=ELEMENT,
            below="topic",
        ),
    ] = ""
    topic: Annotated[
        str,
        Row(
            "the topic on which the stream is published; unique; needed without `run`",
            absent=None,
            xml=ELEMENT,
            below="label",
        ),
    ] = ""
    priority: Annotated[
        int,
        Row("a whole number: if not all targets can be met, those of larger priority are kept", least=-LARGEST_AMOUNT),
    ] = 0
    quality: Annotated[
        tuple[Wish, ...],
        Row(
            "demands on the stream: quality attribute to a mapping; none if absent",
            form="dict[Name, WishPart]",
            feature=Feature.QUALITY,
            is_limit=True,
        ),
    ] = ()
    host: Annotated[str | None, Row("the host to which the stream is sent; sent to no certain host if absent")] = None
    silent_us: Annotated[
        Natural | None,
        Row(
            "in a run, the target counts as unmet after this time without an element: seconds, or 500ms, 5s; never if "
            "absent",
            form="TimeSpan",
            use=Use.RUNNING,
        ),
    ] = None
    run: Annotated[
        str | None,
        Row(
            "the label of a transformation of which a unit must run; takes the place of `topic` and `tag`",
            below="type",
            feature=Feature.RUNS,
        ),
    ] = None
    type: Annotated[
        str | None,
        Row(
            "in ROS: the message type, such as `nav_msgs/Odometry`; `cfgplan run --ros2` publishes it",
            use=Use.RUNNING,
            xml="message",
            below="tag",
        ),
    ] = None

    def __post_init__(self) -> None:
        if self.run is not None:
            object.__setattr__(self, "tag", f"{A_UNIT_OF}{self.run}")
            if self.topic or self.quality or self.host is not None or self.type is not None:
                raise InvalidValueError(
                    f"target {self.label!r} has `run`, so it can have no topic, type, quality or host"
                )
        elif not self.topic:
            raise InvalidValueError(f"target {self.label!r} has neither a topic nor `run`")
        if self.quality:
            store_sorted(self, "quality", self.quality, attrgetter("attribute"))
            refuse_duplicates(f"quality attribute of target {self.label!r}", [q.attribute for q in self.quality])


LOWEST_PRIORITY = -1_000_000_000


def observing(fact: Fact) -> Target | None:
    """The target that wants the stream which observes a fact, on its host if it is one of a host; None if it is not
    observed by a tag.
    """
    if fact.by is None or fact.observed_on is None:
        return None
    return Target(f"fact {fact.key}", fact.by, fact.observed_on, LOWEST_PRIORITY, host=fact.host)
