"""Tags for ports, proposed from names, types of messages and units of measure.

The words of a port choose a class of the ontology, and individuals and classes for restrictions. Reasoners, not words,
decide which ports a tag would match.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass
from functools import cache, cached_property
from itertools import islice
from types import MappingProxyType
from typing import Final, TypeAlias

from cfgplan.domain import Environment, InputPort, OutputPort
from cfgplan.matching.concepts import THING_IRI, Concept, Named, Nominal, Some, conjunction
from cfgplan.matching.names import short_name
from cfgplan.matching.ontology import Ontology
from cfgplan.matching.syntax import parse_tag

OWN, NEAR, FAR = 3.0, 2.0, 1.0
"""What a word counts that is in a port's own name; in its message type, unit of measure, topic or in what feeds it; or
in the name of its transformation or a parameter.
"""
_UNMATCHED: Final = 0.5
"""What a word of a class's name costs that a port does not have."""
_HEADS: Final = 3
"""The number of classes that are tried for a port."""
_FILLERS: Final = 2
"""The number of individuals, and of classes, that are tried in restrictions."""
_MOST_TRIED: Final = 12
_Filler: TypeAlias = Named | Nominal
_SHORTEST_STEM: Final = 4
"""Two words have one stem if one begins with the other, and that has at least this many letters."""
_STEM: Final = 6
"""Two words also have one stem if this many first letters are equal."""
_UNIT: Final = 2
"""A unit of measure may have so few letters, which say nothing in a name."""
_CHUNK: Final = re.compile(r"[^\W\d_]+|\d+")
_NOISE: Final = frozenset(
    (*("msg", "msgs", "std", "node", "data", "in", "out", "the", "of", "and", "a", "x"),
     *("topic", "type", "stamped", "array"))
)  # fmt: skip
_OF_SOURCES: Final = frozenset(["source", "from", "by", "origin", "about", "subject"])
"""Words in the names of properties that lead from information to where it comes from."""
_ANYTHING: Final = ("⊤", "Thing", "owl:Thing")
_PACKAGE: Final = re.compile(r"\b\w+_msgs[-/](msg[-/])?")
"""The package of a message type: it says nothing of a single type."""
_NAME: Final = re.compile(r"[^\W\d][\w-]*")
_MEANINGS: Final = MappingProxyType(
    {
        **dict.fromkeys(("laser", "pointcloud", "point cloud"), "observation sensor distance"),
        **dict.fromkeys(("image", "camera", "detection"), "observation sensor image"),
        **dict.fromkeys(("imu", "acceleration"), "observation sensor acceleration orientation"),
        **dict.fromkeys(("odometry", "odom", "pose", "navsatfix", "nav sat"), "observation position location"),
        **dict.fromkeys(("twist", "cmd", "wrench", "command"), "actuation command velocity"),
        "trajectory": "actuation command position",
        "joint": "position joint",
        **dict.fromkeys(("temperature", "°c", "k", "degc"), "observation sensor temperature"),
        **dict.fromkeys(("pressure", "pa", "bar"), "observation sensor pressure"),
        **dict.fromkeys(("humidity",), "observation sensor humidity"),
        **dict.fromkeys(("illuminance", "lx"), "observation sensor illuminance"),
        **dict.fromkeys(("magnetic", "t"), "observation sensor magnetic field"),
        **dict.fromkeys(("battery", "v", "volt"), "observation voltage"),
        **dict.fromkeys(("m/s", "km/h"), "speed velocity"),
        **dict.fromkeys(("m", "mm", "km"), "length distance"),
        **dict.fromkeys(("w", "kw"), "power"),
        **dict.fromkeys(("wh", "kwh", "j"), "energy"),
        **dict.fromkeys(("a", "ma"), "current"),
        **dict.fromkeys(("hz", "rpm"), "frequency"),
        **dict.fromkeys(("rad", "deg", "°"), "angle"),
        **dict.fromkeys(("kg", "g"), "mass"),
    }
)
"""The subjects of message types and units of measure, in the words of ontologies."""


@cache
def words_of(text: str) -> tuple[str, ...]:
    """The words of a name in lower case: `Y80X60Image`, `cmd_vel` and `ball-detector` are made of several."""
    chunks = _CHUNK.findall(_PACKAGE.sub("", text))
    found = (word.casefold() for chunk in chunks for word in _humps(chunk))
    return tuple(word[:-1] if len(word) > _SHORTEST_STEM and word.endswith("s") else word for word in found)


def _humps(chunk: str) -> Iterator[str]:
    """The words of letters without a space: a capital begins one, unless it stands among capitals."""
    start = 0
    for place in range(1, len(chunk)):
        before, here, after = chunk[place - 1], chunk[place], chunk[place + 1 : place + 2]
        if here.isupper() and (not before.isupper() or after.islower()):
            yield chunk[start:place]
            start = place
    yield chunk[start:]


@dataclass(frozen=True)
class PortWords:
    """The words about a port: `texts` by the weight of their words, such as its name.

    `meant` are message types and units of measure, which stand for further words. `peers` are the tags of ports that it
    is wired to, or that have its name: they are proposed first.
    """

    texts: Mapping[float, Collection[str]]
    meant: Collection[str] = ()
    peers: Collection[str] = ()

    @cached_property
    def weights(self) -> Mapping[str, float]:
        """The weight of each word, also of words that stand for a type or a unit."""
        weights = dict(self.said)
        for text in self.meant:
            for word in _about(text):
                weights.setdefault(word, NEAR)
        return weights

    def weight(self, word: str) -> float:
        """Return the weight of a word, or of one with the same stem; 0 if the port has neither."""
        if word in self.weights:
            return self.weights[word]
        stems = (each for own, each in self.weights.items() if _is_one_stem(word, own))
        return max(stems, default=0.0)

    @cached_property
    def _origins(self) -> Mapping[str, str]:
        """The text that each word is from, or that is about it."""
        origins = {word: text for _, texts in sorted(self.texts.items()) for text in texts for word in words_of(text)}
        for text in self.meant:
            for word in _about(text):
                origins.setdefault(word, text)
        return origins

    def origins(self, words: Iterable[str]) -> str:
        """The texts that contain some words or stand for them, joined by commas."""
        known = self._origins
        stems = ((word, next((own for own in known if _is_one_stem(own, word)), "")) for word in words)
        of_words = (known.get(word, known.get(stem)) for word, stem in stems)
        return ", ".join(sorted({*filter(None, of_words)}))

    @cached_property
    def said(self) -> Mapping[str, float]:
        """The weight of each word in the texts."""
        weights: dict[str, float] = {}
        for weight, texts in sorted(self.texts.items()):
            for text in texts:
                weights |= dict.fromkeys(set(words_of(text)) - _NOISE, weight)
        return weights

    def mention(self, name: str, *, partly: bool = False) -> float:
        """Return how much the texts mention a name: the least weight of its words; with `partly`, half if only its end
        is.
        """
        weights = [self.said.get(word, 0.0) for word in words_of(name)]
        if not weights or not weights[-1]:
            return 0.0
        missing = weights.count(0.0)
        is_enough = not missing or (partly and 2 * missing <= len(weights))
        return min(filter(None, weights)) / (2 if missing else 1) if is_enough else 0.0


@dataclass(frozen=True)
class Suggestion:
    """A tag for a port, why it is proposed, and which ports would match it that do not match now, or no longer."""

    tag: str
    because: str
    gained: tuple[str, ...] = ()
    lost: tuple[str, ...] = ()


class Proposer:
    """Proposes tags in the words of one ontology."""

    def __init__(self, ontology: Ontology, foreign: str | None = None, *, words: bool = False) -> None:
        """No class is proposed whose IRI begins with `foreign`. With `words`, tags are in words, not in symbols."""
        self._ontology = ontology
        self._words = words
        self._classes = {
            name: iri for name, iri in ontology.classes.items() if foreign is None or not iri.startswith(foreign)
        }

    def proposals(self, port: PortWords, most: int = 3, now: str | None = None) -> tuple[Suggestion, ...]:
        """Tags for a port, the best first; none if no class fits its words. The tag that it has `now` is as it is
        written.
        """
        known: dict[Concept, str] = {}
        present = None if now is None else parse_tag(now, self._ontology)
        found: dict[str, Suggestion] = {}
        for tag in port.peers:
            found.setdefault(tag, Suggestion(tag, "a port that it is wired to, or that is called so, has this tag"))
        for concept, because in islice(self._concepts(port), _MOST_TRIED):
            if concept not in known:
                known[concept] = because
                tag = now if now and concept == present else self._ontology.render(concept, words=self._words)
                found.setdefault(tag, Suggestion(tag, because))
        return tuple(islice(found.values(), most))

    def _concepts(self, port: PortWords) -> Iterator[tuple[Concept, str]]:
        heads = self._heads(port)
        for number, (head, words) in enumerate(heads):
            for fillers in self._fillers(port, head) if number == 0 else [*self._fillers(port, head)][:1]:
                told = [f"{self._ontology.written(head)} fits {port.origins(words)}"]
                parts: list[Concept] = [Named(head)]
                taken: set[str] = set()
                for filler in fillers:
                    role = self._role(head, filler, taken)
                    if role is not None:
                        taken.add(role)
                        parts.append(Some(role, filler))
                        mentioned = port.origins(words_of(short_name(filler.iri)))
                        told.append(f"{self._ontology.render(filler)} is in {mentioned}")
                yield conjunction(parts), ", ".join(told)

    def _heads(self, port: PortWords) -> list[tuple[str, tuple[str, ...]]]:
        """Return the classes whose names fit best, with the fitting words; among equals, classes without subclasses
        come first.
        """
        ranked = []
        for iri in self._classes.values():
            words = words_of(short_name(iri))
            weights = {word: port.weight(word) for word in words}
            fitting = tuple(word for word, weight in weights.items() if weight)
            score = sum(weights[word] for word in fitting) - _UNMATCHED * (len(words) - len(fitting))
            if fitting and score > 0:
                ranked.append((-score, iri in self._inner, len(words), iri, fitting))
        return [(iri, fitting) for *_, iri, fitting in sorted(ranked)[:_HEADS]]

    @cached_property
    def _above(self) -> Mapping[str, Set[str]]:
        """The named classes directly above each class and individual."""
        above: dict[str, set[str]] = {}
        for tree in self._ontology.trees.values():
            if tree[0] == "SubClassOf" and isinstance(tree[1], str) and isinstance(tree[2], str):
                above.setdefault(tree[1], set()).add(tree[2])
            elif tree[0] == "ClassAssertion" and isinstance(tree[1], str):
                above.setdefault(str(tree[2]), set()).add(tree[1])
        return above

    @cached_property
    def _ranges(self) -> Mapping[str, Set[str]]:
        """The named classes to which each property leads, where that is declared."""
        ranges: dict[str, set[str]] = {}
        for tree in self._ontology.trees.values():
            if tree[0] == "ObjectPropertyRange" and isinstance(tree[1], str) and isinstance(tree[2], str):
                ranges.setdefault(tree[1], set()).add(tree[2])
        return ranges

    def _is_out_of_range(self, role: str, above: Set[str]) -> bool:
        return not self._ranges.get(role, frozenset()) <= above

    @cached_property
    def _inner(self) -> Set[str]:
        """The classes that have subclasses."""
        classes = {*self._classes.values()}
        return {upper for lower, uppers in self._above.items() if lower in classes for upper in uppers - {lower}}

    def _all_above(self, iri: str) -> Set[str]:
        found, waiting = {iri}, [iri]
        while waiting:
            news = self._above.get(waiting.pop(), frozenset()) - found - {THING_IRI}
            found |= news
            waiting += news
        return found

    def _fillers(self, port: PortWords, head: str) -> Iterable[tuple[_Filler, ...]]:
        """Yield fillers for restrictions: individuals that the words mention, classes, both, none."""
        punned = frozenset((*self._ontology.classes.values(), *self._ontology.property_names.by_short_name.values()))
        individuals = self._mentioned(port, self._ontology.individuals, punned, partly=True)
        related = {iri for iri in self._classes.values() if head in self._all_above(iri)} | self._all_above(head)
        classes = self._mentioned(port, self._classes, related)
        one: list[_Filler] = [Nominal(iri) for iri in individuals]
        other: list[_Filler] = [Named(iri) for iri in classes]
        if len(one) > 1:
            yield tuple(one)
        for first in one:
            yield (first,)
            yield from ((first, second) for second in other[:1])
        yield from ((second,) for second in other)
        yield ()

    def _mentioned(
        self, port: PortWords, names: Mapping[str, str], besides: Set[str], *, partly: bool = False
    ) -> list[str]:
        """The names that the words mention, those first that count most."""
        found = [
            (-weight, iri)
            for iri in names.values()
            if iri not in besides and (weight := port.mention(short_name(iri), partly=partly))
        ]
        return [iri for _, iri in sorted(found)[:_FILLERS]]

    def _role(self, head: str, filler: _Filler, taken: Collection[str]) -> str | None:
        """The property that leads from a class to a filler by its name; None if none is left."""
        above = self._all_above(filler.iri)
        about = {word for upper in above for word in words_of(short_name(upper))}

        def rank(role: str) -> tuple[float, str]:
            words = words_of(short_name(role))
            fit = 2 * len(about.intersection(words)) + len(_OF_SOURCES.intersection(words))
            fit += any(_is_one_stem(word, own) for word in words for own in words_of(short_name(head)))
            leads_away = words[:1] == ("is",) and words[-1:] == ("of",)  # isPropertyOf leads away from properties
            return 3 * (leads_away + self._is_out_of_range(role, above)) - fit, role

        roles = [role for role in self._ontology.property_names.by_short_name.values() if role not in taken]
        return min(roles, key=rank, default=None)


def words_of_ports(environment: Environment, ontology: Ontology) -> dict[str, PortWords]:
    """Return the words about each input, output and target, by its name in `Environment.demands` and `.outputs`."""
    properties = ontology.property_names.by_short_name

    def names_in(tag: str) -> list[str]:
        return [name for name in _names_in(tag) if name not in properties]

    tags = {**environment.outputs, **environment.demands}
    wired: dict[str, set[str]] = {}
    topics: dict[str, set[str]] = {}
    kind_of = {unit.id: unit.transformation for unit in environment.units}
    for unit in environment.units:
        for wire in unit.subscriptions:
            if wire.stream.unit in kind_of:
                consumer, provider = (
                    f"{unit.transformation}/{wire.port}",
                    f"{kind_of[wire.stream.unit]}/{wire.stream.port}",
                )
                wired.setdefault(consumer, set()).add(provider)
                wired.setdefault(provider, set()).add(consumer)
        for told in unit.publications:
            topics.setdefault(f"{unit.transformation}/{told.port}", set()).add(told.topic)
    named: dict[str, set[str]] = {}
    for name in tags:
        named.setdefault(name.rpartition("/")[2], set()).add(name)
    found: dict[str, PortWords] = {}
    for transformation in environment.library:
        params = [str(value) for value in transformation.params.values()]
        ports: tuple[InputPort | OutputPort, ...] = (*transformation.inputs, *transformation.outputs)
        for port in ports:
            name = f"{transformation.label}/{port.name}"
            others = sorted(wired.get(name, ()))
            called = sorted(other for other in named[port.name] - {name} if _may_share(tags[other], other, name))
            peers = [tags[other] for other in (*others, *called) if other in tags]
            feeders = [other.rpartition("/")[0] for other in others if isinstance(port, InputPort)]
            near = [*topics.get(name, ()), port.type or "", *names_in(port.tag), *feeders]
            far = [transformation.label, *params]
            found[name] = PortWords(
                {OWN: [port.name], NEAR: near, FAR: far},
                [*(name for name in (port.name, port.type or "", *names_in(port.tag)) if len(name) > _UNIT), *params],
                [tag for tag in dict.fromkeys(peers) if tag not in (port.tag, *_ANYTHING)],
            )
    for target in environment.stream_targets:
        texts = {OWN: [target.label, target.topic], NEAR: names_in(target.tag)}
        found[f"target {target.label}"] = PortWords(texts, [target.label, *names_in(target.tag)])
    return found


def _about(text: str) -> Iterator[str]:
    """Yield the words that stand for a message type, a unit of measure or a name."""
    for known in (text.casefold(), *(word for word in words_of(text) if len(word) > _UNIT)):
        yield from words_of(_MEANINGS.get(known, ""))


def _may_share(tag: str, other: str, name: str) -> bool:
    """Whether a tag says of another port nothing that is in that port's name alone, such as its robot."""
    own = words_of(name)
    return not any(set(words_of(each)) <= set(words_of(other)) - set(own) for each in _names_in(tag))


def _names_in(tag: str) -> list[str]:
    """The names in a tag; none in one that says nothing."""
    return [] if tag in _ANYTHING else _NAME.findall(tag)


def _is_one_stem(one: str, other: str) -> bool:
    short, long = sorted((one, other), key=len)
    begins = len(short) >= _SHORTEST_STEM and long.startswith(short)
    return begins or (len(short) >= _STEM and one[:_STEM] == other[:_STEM])


def tested(
    proposed: Mapping[str, Sequence[Suggestion]],
    matched_now: Mapping[str, Set[str]],
    matched_then: Mapping[str, Mapping[str, Set[str]]],
) -> dict[str, tuple[Suggestion, ...]]:
    """Return the suggestions with the matches that they would add and remove; `matched_then` is by port and tag."""
    return {
        port: tuple(
            Suggestion(
                each.tag,
                each.because,
                tuple(sorted(matched_then[port][each.tag] - matched_now[port])),
                tuple(sorted(matched_now[port] - matched_then[port][each.tag])),
            )
            for each in suggestions
        )
        for port, suggestions in proposed.items()
    }
