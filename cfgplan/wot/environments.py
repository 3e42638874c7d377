"""Making an environment file and its ontology from Thing Descriptions."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final
from urllib.parse import unquote, urlsplit

from cfgplan.domain import Environment, OutputPort, Transformation
from cfgplan.errors import Fault, InputError
from cfgplan.formats.imported import ImportedSources
from cfgplan.small_ontology import SmallOntology, plain_word
from cfgplan.summary import counted, some
from cfgplan.transformations import RunOptions
from cfgplan.wot.contexts import Contexts
from cfgplan.wot.things import Affordance, Form, Thing, read_things

WOT_NAMES: Final = "urn:cfgplan:wot#"
"""Begins the IRI of each concept that has none of its own."""
_ROOTS: Final = {
    "SemanticType": "What values and things are, by their @type.",
    "Unit": "Units of measurement.",
    "Device": "Things, by their titles.",
    "Affordance": "Properties and events of things.",
}
_ROLES: Final = ("inUnit", "ofThing")
_HEARD: Final = ("observeproperty", "subscribeevent", "readproperty")
_MQTT: Final = ("mqtt", "mqtts")
_HTTP: Final = ("http", "https")
_POLLS_HZ: Final = 1.0
"""A property that has to be asked for is asked for so often."""
_LOGIN: Final = {"basic": "`username` with `password_env`", "bearer": "`token_env`"}
"""Schemes of security, and the params of units for them."""


def wot_imported(paths: Iterable[Path], contexts: Mapping[str, Path]) -> ImportedSources:
    """The environment of the things that files describe: a source for each property that can be read, and each event.

    `contexts` are files that stand for contexts of JSON-LD. Raises InputError.
    """
    things, known = read_things(paths), Contexts(contexts)
    iris: list[Mapping[str, str]] = []
    for thing in things:
        try:
            iris.append(known.iris(thing.context, _terms(thing)))
        except ValueError as error:
            mend = "see the mappings in it, and the files of --context"
            raise InputError([Fault(f"its `@context` can't be used: {error}", thing.file, mend=mend)]) from None
    making = _Making(iri for of_thing in iris for iri in of_thing.values())
    for thing, of_thing in zip(things, iris, strict=True):
        making.add(thing, of_thing)
    if not making.library:
        message = f"nothing that {counted(len(things), 'thing')} describe can be a source"
        raise InputError.of(message, mend="name files of things that have properties or events")
    unread = (
        f"the context {url}, which is never fetched: `--context {url}=FILE` names a file for it; "
        "its terms stand as they are written"
        for url in sorted(known.unread)
    )
    environment = Environment(units=(), library=tuple(making.library), targets=())
    return ImportedSources(
        origin=some(sorted({Path(thing.file).name for thing in things})),
        size=f"{counted(len(environment.library), 'source')} of {counted(len(things), 'thing')}",
        environment=environment,
        ontology=making.ontology.text,
        example=_example(environment.library),
        notes=(*unread, *making.notes),
        hints=tuple(making.hints()),
    )


def _example(library: Sequence[Transformation]) -> str:
    """Return a target, as YAML, for the first source with unit code and a semantic type, or else the first."""
    wanted = next((each for each in library if each.source and not _tag(each).startswith("ofThing ")), library[0])
    tag = _tag(wanted).rpartition(" and ")[0]
    return f"{{label: {wanted.label}, topic: /{wanted.label}, tag: {tag}}}"


def _terms(thing: Thing) -> Iterator[str]:
    yield from thing.types
    for each in thing.affordances:
        yield from each.types
        if each.unit is not None:
            yield each.unit


class _Making:
    """The library and the ontology, which grow from thing to thing."""

    def __init__(self, iris: Iterable[str]) -> None:
        self.library: list[Transformation] = []
        self.ontology = SmallOntology(WOT_NAMES, _ROOTS, _ROLES, iris)
        self.notes: list[str] = []
        self._number = 0
        self._polled: list[str] = []
        self._lacking: list[str] = []
        self._security: dict[str, tuple[str, ...]] = {}
        self._undefined: set[str] = set()

    def add(self, thing: Thing, iris: Mapping[str, str]) -> None:
        """Add what a thing offers; `iris` are those of its terms."""
        self._number += 1
        name = plain_word(thing.title)
        key = (str(self._number), thing.title)
        device = self.ontology.concept(("Device", *key), name, "Device", thing.title)
        kinds = [device, *(self._term("SemanticType", each, iris) for each in thing.types)]
        whole = kinds[0] if len(kinds) == 1 else f"({' and '.join(kinds)})"
        for each in thing.affordances:
            label = self.ontology.concept(
                ("Affordance", *key, each.kind, each.name),
                f"{device}-{plain_word(each.name)}",
                "Affordance",
                f"{thing.title}: {each.name}",
            )
            tags = [self._term("SemanticType", one, iris) for one in each.types]
            if each.unit is not None:
                tags.append(f"inUnit some {self._term('Unit', each.unit, iris)}")
            tag = " and ".join(dict.fromkeys([*tags, f"ofThing some {whole}", label]))
            self.library.append(self._transformation(label, tag, each))
        if thing.security:
            self._security[thing.title] = thing.security

    def hints(self) -> Iterator[str]:
        """Return the hints for the user."""
        if self._undefined:
            yield f"no context defines {some(sorted(self._undefined))}: names of their own in the ontology"
        if self._polled:
            what = "it is asked for" if len(self._polled) == 1 else "each is asked for"
            yield f"{some(self._polled)}: {what} once a second, which `rate` in `run` changes"
        if self._lacking:
            yield f"{some(self._lacking)}: no unit knows how to reach them; name one by `source`"
        for title, schemes in self._security.items():
            known = [f"add {_LOGIN[each]} to its params" for each in schemes if each in _LOGIN]
            yield f"{title} asks for security ({', '.join(schemes)}): {'; '.join(known) or 'no unit knows that scheme'}"

    def _transformation(self, label: str, tag: str, affordance: Affordance) -> Transformation:
        output = OutputPort("value", tag)
        for form in affordance.forms:
            is_heard = form.scheme in _MQTT and any(op in _HEARD for op in form.ops)
            if is_heard and (params := _of_mqtt(form, affordance)) is not None:
                return Transformation(label, outputs=(output,), source="cfgplan_runtime.mqtt:Subscriber", params=params)
        for form in affordance.forms:
            if form.scheme in _HTTP and "readproperty" in form.ops and "{" not in form.href:
                self._polled.append(label)
                return Transformation(
                    label,
                    outputs=(output,),
                    source="cfgplan_runtime.http:Poller",
                    params={"url": form.href, "payload": _payload(form, affordance)},
                    run=RunOptions(rate_hz=_POLLS_HZ),
                )
        ways = sorted({f"{form.scheme} ({', '.join(form.ops)})" for form in affordance.forms})
        self._lacking.append(f"{label} by {some(ways)}")
        return Transformation(label, outputs=(output,))

    def _term(self, root: str, term: str, iris: Mapping[str, str]) -> str:
        """The concept of a term."""
        iri = iris.get(term)
        if iri is None:
            self._undefined.add(term)
            return self.ontology.concept((root, term), plain_word(term), root, term)
        return self.ontology.known_concept(root, iri, term)


def _tag(transformation: Transformation) -> str:
    return transformation.outputs[0].tag


def _of_mqtt(form: Form, affordance: Affordance) -> dict[str, Any] | None:
    """The params of a subscriber: the topic is that of the binding's own keys, or the path of the URL. None without."""
    address = urlsplit(form.href)
    more = {key.removeprefix("mqv:"): value for key, value in form.more.items() if key.startswith("mqv:")}
    topic = more.get("filter", more.get("topic", unquote(address.path.removeprefix("/"))))
    topic = topic[0] if isinstance(topic, list) and topic else topic
    if not address.hostname or not isinstance(topic, str) or not topic:
        return None
    params: dict[str, Any] = {
        "broker": f"{address.scheme}://{address.netloc.rpartition('@')[2]}",
        "topic": topic,
        "payload": _payload(form, affordance),
    }
    if (qos := str(more.get("qos"))) in ("0", "1", "2"):
        params["qos"] = int(qos)
    return params


def _payload(form: Form, affordance: Affordance) -> str:
    """How a message holds its value, by its media type."""
    if form.media_type.endswith("json"):
        return "json"
    if form.media_type.startswith("text/"):
        return "number" if affordance.value in ("number", "integer") else "text"
    return "bytes"
