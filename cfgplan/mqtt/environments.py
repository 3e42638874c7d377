"""Make an environment, with its ontology, from the traffic of a broker, and list the topics that were left out."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import ceil
from typing import Any, Final

from cfgplan.domain import Environment, OutputPort, Transformation
from cfgplan.errors import InputError
from cfgplan.formats.imported import ImportedSources
from cfgplan.mqtt.discovery import Entity, Path
from cfgplan.mqtt.traffic import HeardTopic, Traffic
from cfgplan.mqtt.vocabulary import MqttVocabulary
from cfgplan.qualities import MICRO
from cfgplan.summary import counted, some

_SUBSCRIBER: Final = "cfgplan_runtime.mqtt:Subscriber"
_OWN: Final = "cfgplan/"
"""The prefix of the topics that runs publish."""
_STATUS: Final = re.compile(rf"{_OWN}[^/]+/status")
"""The topic on which a run says by default whether it is online."""
_ALIKE: Final = 3
"""The least number of topics differing in one level for a hint."""
_PATIENCE: Final = 5
"""The number of a source's periods after which a target is silent, rounded up to seconds."""


@dataclass(frozen=True, slots=True)
class MqttSource:
    """A source of the file: a topic or a field of its messages, the entity that describes it, and its tag.

    `is_silent` if no message came on the topic.
    """

    label: str
    topic: HeardTopic
    path: Path
    entity: Entity | None
    tag: str
    is_silent: bool


@dataclass(frozen=True, kw_only=True)
class MqttImported(ImportedSources):
    """The environment of a broker."""

    sources: tuple[MqttSource, ...]


def mqtt_imported(traffic: Traffic, params: Mapping[str, Any]) -> MqttImported:
    """Make an environment with a source for each topic heard; `params` go to the connection of every source.

    A topic that discovery describes becomes one source for each described value, any other topic becomes one source.
    Raises InputError if no source is found.
    """
    told = traffic.discovered
    heard = {topic.name: topic for topic in traffic.topics}
    described = [entity for entity in told.entities if entity.path is not None]
    words = MqttVocabulary(described)
    taken: set[str] = set()
    sources: list[MqttSource] = []

    def add(topic: HeardTopic, entity: Entity | None = None) -> None:
        path = (entity.path if entity is not None else None) or ()
        label = words.tag(topic.name, path)
        sources.append(
            MqttSource(label, topic, path, entity, words.tag(topic.name, path, entity), topic.name not in heard)
        )
        taken.add(topic.name)

    for entity in described:
        add(heard.get(entity.topic) or _silent(entity), entity)
    for topic in traffic.topics:
        if topic.name not in taken | told.commands and not _STATUS.fullmatch(topic.name):
            add(topic)
    sources.sort(key=lambda source: source.label)
    commands = sorted(told.commands & heard.keys() - taken)
    environment = Environment(
        units=(), library=tuple(_transformation(source, params) for source in sources), targets=()
    )
    notes = (*traffic.notes, *_notes(traffic, commands))
    if not sources:
        mend = "listen longer (--for 60s), or name other topics (--topic)"
        raise InputError.of(f"nothing that came from {traffic.broker} can be a source: {'; '.join(notes)}", mend=mend)
    described_too = sum(source.entity is not None for source in sources)
    return MqttImported(
        origin=f"the broker {traffic.broker} in {traffic.span_s:g} s",
        size=f"{counted(len(sources), 'source')}, {described_too} of them described by discovery messages",
        environment=environment,
        ontology=words.text,
        example=_example(sources),
        notes=notes,
        hints=tuple(_hints(sources)),
        remark="; with `silent` another source of the kind takes over from a dead one",
        sources=tuple(sources),
    )


def _example(sources: Sequence[MqttSource]) -> str:
    """Return a target, as YAML, for the first source of a known kind, or else for the first that no run publishes."""
    foreign = [source for source in sources if not source.topic.name.startswith(_OWN)] or sources
    wanted = next((source for source in sources if source.entity and source.entity.kind), foreign[0])
    silent = "" if wanted.topic.period_s is None else f", silent: {_silent_s(wanted.topic.period_s)}s"
    tag = wanted.tag.rpartition(" and ")[0] or wanted.tag
    topic, heard = f"{_OWN}{wanted.label}", {source.topic.name for source in sources}
    while topic in heard:  # the run must not hear what it publishes
        topic += "_"
    return f"{{label: {wanted.label}, topic: {topic}, tag: {tag}{silent}}}"


def _silent(entity: Entity) -> HeardTopic:
    """Return a described topic without messages; its form is guessed from the description."""
    if entity.path:
        return HeardTopic(entity.topic, "json", False)
    return HeardTopic(entity.topic, "number" if entity.is_measured and entity.unit else "text", False)


def _transformation(source: MqttSource, params: Mapping[str, Any]) -> Transformation:
    topic = source.topic
    own = {"topic": topic.name, "payload": "json" if source.path else topic.form, "retained": topic.is_retained}
    if source.path:
        own["field"] = source.path[0] if len(source.path) == 1 else list(source.path)
    rate_uhz = 0 if topic.period_s is None else round(float(f"{1 / topic.period_s:.3g}") * MICRO)
    output = OutputPort("value", source.tag, rate_uhz=rate_uhz, size_bytes=topic.size)
    return Transformation(source.label, outputs=(output,), source=_SUBSCRIBER, params={**params, **own})


def _notes(traffic: Traffic, commands: Iterable[str]) -> Iterator[str]:
    if traffic.sparkplug:
        yield f"{counted(traffic.sparkplug, 'topic')} of Sparkplug (spBv1.0/...), whose messages are not read"
    if unread := traffic.discovered.unread:
        yield f"{some(unread)}: no message that describes an entity"
    if untold := sorted({entity.topic for entity in traffic.discovered.entities if entity.path is None}):
        yield f"the descriptions of values on {some(untold)}: their templates do more than look up a field"
    if statuses := [topic.name for topic in traffic.topics if _STATUS.fullmatch(topic.name)]:
        yield f"{some(statuses)}: whether a run of cfgplan is online"
    if commands := list(commands):
        yield f"{some(commands)}: commands to devices, for which `cfgplan_runtime.mqtt:Publisher` is there"


def _hints(sources: Iterable[MqttSource]) -> Iterator[str]:
    """Yield hints: topics of the same kind that differ in only one level, and mappings without a description."""
    groups: defaultdict[tuple[object, ...], set[str]] = defaultdict(set)
    for source in sources:
        levels, entity = source.topic.name.split("/"), source.entity
        kind = (source.topic.form, source.path, entity and (entity.kind, entity.is_measured, entity.unit))
        for number in range(len(levels)):
            groups["/".join([*levels[:number], "+", *levels[number + 1 :]]), kind].add(levels[number])
    for (pattern, _), differing in groups.items():
        if len(differing) >= _ALIKE:
            yield (
                f"{pattern}: {len(differing)} topics differ only there ({some(sorted(differing))}); a subscriber to "
                "the pattern gives the values of all with their topics, a template makes a source of each"
            )
    yield from _slash_hints(sources)
    if mappings := [f"{source.topic.name} ({some(source.topic.fields)})" for source in sources if _is_open(source)]:
        yield f"messages with fields: {some(mappings)}; with `field` in its `params` a source gives one of them"
    if silent := sorted({source.topic.name for source in sources if source.is_silent}):
        yield f"{some(silent)}: described, but nothing came; the form of the payload is guessed"


def _slash_hints(sources: Iterable[MqttSource]) -> Iterator[str]:
    """Yield a hint for topics that differ only in slashes at their ends, and are easily confused."""
    groups: defaultdict[tuple[str, Path], list[MqttSource]] = defaultdict(list)
    for source in sources:
        groups[source.topic.name.strip("/"), source.path].append(source)
    for group in groups.values():
        if len(group) > 1:
            named = some(f"{source.topic.name} is {source.label}" for source in group)
            yield f"{named}: topics that differ by a slash are different topics; check that targets name the right one"


def _silent_s(period_s: float) -> int:
    return ceil(period_s * _PATIENCE)


def _is_open(source: MqttSource) -> bool:
    """Return whether a source gives mappings whose fields no discovery message describes."""
    return source.entity is None and bool(source.topic.fields)
