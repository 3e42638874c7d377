"""Why a node of ROS hears nothing although its file looks right: idle remappings, and qualities of service."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from difflib import get_close_matches

from cfgplan.domain import Environment
from cfgplan.explaining import Suspicion, WiringFault
from cfgplan.ros.qos import ServiceQuality, obstacles
from cfgplan.ros.sources import REMAPS, NodeSource
from cfgplan.summary import some
from cfgplan.transformations import InputPort, OutputPort

_MEND = "let both say the same, or let `cfgplan run --middleware ros2` put its relay between them"
_LIKE = 0.5
"""The least similarity of a name to be proposed instead of another (difflib's ratio)."""


def ros_faults(environment: Environment) -> Iterator[WiringFault]:
    """Yield faults of running ROS nodes that the rules of validity do not cover."""
    yield from _idle_remaps(environment)
    yield from _kept_apart(environment)


def _idle_remaps(environment: Environment) -> Iterator[WiringFault]:
    """The remappings among the arguments of running nodes: each renames a topic or service that the node lacks.

    An import writes a remapping of a port to that port's `remap`; it leaves in `source` only remappings of no port.
    """
    for unit in environment.units:
        transformation = environment.transformation.get(unit.transformation)
        source = NodeSource.read(transformation.source) if transformation and not unit.standby else None
        if transformation is None or source is None:
            continue
        unfed = _own_names([port for port in transformation.inputs if port.name not in unit.feeds])
        own = sorted({*_own_names(transformation.inputs), *_own_names(transformation.outputs)})
        for argument in source.arguments:
            before, is_remap, after = argument.partition(REMAPS)
            if is_remap and own and before not in own:
                near = get_close_matches(before, unfed, 1, _LIKE) or get_close_matches(before, own, 1, _LIKE)
                mend = f"did you mean `{near[0]}`?" if near else f"it has {some(own)}"
                text = f"{unit.id} is to call `{before}` `{after}`, but its code has no `{before}`: {mend}"
                yield WiringFault(Suspicion.REMAP, text, None, unit.id)


def _kept_apart(environment: Environment) -> Iterator[WiringFault]:
    """Yield the directly wired subscriptions that receive nothing because they ask for a quality that is not offered.

    In a run with relays (`cfgplan run --middleware ros2`) they receive all: the relay asks for and offers the right
    quality.
    """
    library = {unit.id: environment.transformation.get(unit.transformation) for unit in environment.units}
    for unit in environment.units:
        consumer = library[unit.id]
        for subscription in unit.subscriptions:
            provider = library.get(subscription.stream.unit)
            asked = consumer.input.get(subscription.port) if consumer else None
            offered = provider.output.get(subscription.stream.port) if provider else None
            if asked is None or offered is None or asked.qos is None or offered.qos is None:
                continue
            found = list(obstacles(ServiceQuality.read(offered.qos), ServiceQuality.read(asked.qos)))
            if found:
                text = f"{unit.id} gets no messages of {subscription.stream} at {asked.name}: {'; '.join(found)}"
                yield WiringFault(Suspicion.QOS, f"{text}; {_MEND}", None, unit.id, asked.name)


def _own_names(ports: Sequence[InputPort] | Sequence[OutputPort]) -> list[str]:
    """The names that the node's code has for its ports."""
    return [port.remap or port.name for port in ports]
