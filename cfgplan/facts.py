"""Facts of the world and of hosts, what transformations require of them, and which streams observe them.

requirement = comparisons joined by and, or, not and brackets, as in selectors
comparison  = NAME | NAME ( >= | <= | > | < | == ) VALUE

A value is a number, true, false, or a word; a name alone says that a fact is true.
"""

from __future__ import annotations

import dataclasses
import operator
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from decimal import Decimal
from functools import lru_cache
from itertools import chain
from types import MappingProxyType
from typing import Annotated, Final, Literal, TypeAlias

from cfgplan.arguments import Natural, checked
from cfgplan.errors import InvalidValueError, TagError, did_you_mean
from cfgplan.noise import Noise
from cfgplan.qualities import MICRO, micro_units, units
from cfgplan.rows import FOUND, QOS, Row, Use
from cfgplan.selectors import ExpressionReader

FactValue: TypeAlias = bool | int | str
"""True or false, a number in millionths, or a word."""

LARGEST_FACT: Final = 10**12 * MICRO
"""The largest number of a fact, in millionths. Pressures in pascals and seconds since 1970 are far below it, and it
fits into 64 bits.
"""
HOST_MARK: Final = "{host}"
"""It stands for the name of a host in the tag and the topic that observe a fact of hosts."""
_NUMBER: Final = re.compile(r"-?[0-9]+(?:\.[0-9]+)?(?:[eE][-+]?[0-9]{1,2})?")
_TRUTH: Final = {"true": True, "false": False}
_SIGNS: Final[Mapping[str, Callable[[int, int], bool]]] = MappingProxyType(
    {">=": operator.ge, "<=": operator.le, ">": operator.gt, "<": operator.lt}
)
"""The comparisons of numbers alone."""
_NO_SIGNS: Final = frozenset("=!≥≤≠")
"""The first characters of comparisons in other languages."""


def value_text(value: FactValue) -> str:
    """A fact's value as files and people write it."""
    if isinstance(value, bool):
        return str(value).lower()
    return format(units(value).normalize(), "f") if isinstance(value, int) else value


def kind_of(value: FactValue) -> str:
    """Return the kind of a fact's value, in words."""
    return "true or false" if isinstance(value, bool) else "a number" if isinstance(value, int) else "a word"


@dataclass(frozen=True, slots=True)
@checked
class Fact:
    """A variable of the world: its declared value, which counts until another is observed or set, and its unit.

    In a run, it is observed by the streams tagged `by`, or by the one on `topic`. With a message `type`, the topic is
    one of ROS, in ROS 2 with the quality of service `qos`. If elements are mappings, the value is under `field`; a dot
    leads into nested mappings, and into the parts of a list by their number, `name` or `key`. Values with `noise` are
    filtered. If no element has come for `silent_us`, the declared value counts again.

    A fact `of` hosts has a value on each host: `hosts` has the declared ones that differ. `{host}` in `by` and `topic`
    stands for the host's name. `on` gives the fact of one host.
    """

    name: str
    declared: Annotated[
        FactValue,
        Row("the value of the fact until another one is observed or set: a number, true, false or a word", form="Fact"),
    ]
    unit: Annotated[str | None, Row("the unit of measure, as free text; none if absent", use=Use.NONE)] = None
    by: Annotated[
        str | None,
        Row(
            "the tag of the stream that observes the fact in a run; a run plans for it as for a target", form="TagText"
        ),
    ] = None
    topic: Annotated[
        str | None,
        Row(
            "in place of `by`: the topic that observes the fact in a run: a target's or, with `type`, any ROS topic",
            use=Use.RUNNING,
        ),
    ] = None
    field: Annotated[
        str | None,
        Row(
            "the field of an element that has the value: `range`, `pose.x` in a nested mapping, or `values.volt` "
            "for the item of a list with this `name` or `key`; the whole element if absent",
            use=Use.RUNNING,
        ),
    ] = None
    type: Annotated[
        str | None,
        Row(
            "the message type, such as `std_msgs/Float32`; `topic` is then a ROS topic, whoever publishes it",
            use=Use.RUNNING,
            xml="message",
        ),
    ] = None
    qos: Annotated[str | None, QOS] = None
    noise: Annotated[
        Noise | None,
        Row(
            "the standard deviation of an observed number, or `20 %` of it; exact if absent",
            form="NoiseText",
            use=Use.RUNNING,
        ),
    ] = None
    silent_us: Annotated[
        Natural | None,
        Row(
            "the fact has its declared value again after this time without an element: seconds, or 500ms, 5s; never if "
            "absent",
            form="TimeSpan",
            use=Use.RUNNING,
        ),
    ] = None
    of: Annotated[
        Literal["host"] | None,
        Row(
            "`host`: each host has its own value, and `{host}` in `by` and `topic` is its name; if absent, all hosts "
            "have one value",
            form='Literal["host"]',
        ),
    ] = None
    hosts: Annotated[
        Mapping[str, FactValue],
        Row(
            "with `of: host`: name of a host to its declared value, where it differs from `declared`",
            form="dict[Name, Fact]",
        ),
    ] = dataclasses.field(default_factory=dict, hash=False)
    now: Annotated[FactValue | None, FOUND] = None
    """The present value, if it is known to differ from the declared one."""
    now_on: Annotated[Mapping[str, FactValue], FOUND] = dataclasses.field(default_factory=dict, hash=False)
    """The present values on hosts, if they are known to differ from the declared ones, by host."""
    host: Annotated[str | None, FOUND] = None
    """The host whose value this is; None for a fact of the world, and for a fact of all hosts."""

    def __post_init__(self) -> None:
        if misfit := misfit_of_fact({name: getattr(self, name) for name in self.__slots__}):
            raise InvalidValueError(f"fact {self.name!r}: {misfit[1]}")

    @property
    def value(self) -> FactValue:
        """The value that counts."""
        return self.declared if self.now is None else self.now

    def being(self, value: FactValue | None) -> Fact:
        """Return the fact with this present value; None and values of another kind change nothing."""
        return self if value is None or kind_of(value) != kind_of(self.declared) else replace(self, now=value)

    def on(self, host: str) -> Fact:
        """The fact of one host, of a fact of hosts."""
        by, topic = (text and text.replace(HOST_MARK, host) for text in (self.by, self.topic))
        declared, now = self.hosts.get(host, self.declared), self.now_on.get(host)
        return replace(self, declared=declared, by=by, topic=topic, now=now, hosts={}, now_on={}, host=host)

    def being_on(self, values: Mapping[str, FactValue]) -> Fact:
        """Return the fact of hosts with these present values, by host; values of another kind change nothing."""
        fitting = {host: value for host, value in values.items() if kind_of(value) == kind_of(self.declared)}
        return replace(self, now_on={**self.now_on, **fitting}) if fitting else self

    @property
    def key(self) -> str:
        """The name by which the fact is set and shown: `visibility`, or `r1.battery` on host `r1`."""
        return self.name if self.host is None else f"{self.host}.{self.name}"

    @property
    def observed_on(self) -> str | None:
        """The topic whose stream observes the fact; None if none does."""
        return self.topic if self.by is None else f"/facts/{self.key}"

    def __str__(self) -> str:
        there = "" if self.host is None else f" on {self.host}"
        return f"{self.name} is {value_text(self.value)}{f' {self.unit}' if self.unit else ''}{there}"

    def value_in(self, element: object) -> FactValue | None:
        """Return the fact's value in an element of the observing stream.

        None if a list in it has no part of the name in `field`: it may be the diagnostics of another device. Raises
        InvalidValueError if the element has no such field, or a value of another kind.
        """
        found = element
        for step in self.field.split(".") if self.field is not None else ():
            if isinstance(found, Sequence) and not isinstance(found, str) and not step.isdecimal():
                found = next((one for one in found if _is_called(one, step)), None)
                if found is None:
                    return None
                continue
            try:
                found = found[step] if isinstance(found, Mapping) else found[int(step)]  # type: ignore[index]
            except (LookupError, TypeError, ValueError):
                raise InvalidValueError(
                    f"fact {self.name!r}: an element has no field {self.field!r}: {element!r:.60}"
                ) from None
        if isinstance(found, str) and isinstance(self.declared, bool):
            return self.read(found.strip().lower())
        value: FactValue
        if isinstance(found, bool) or (isinstance(found, str) and isinstance(self.declared, str)):
            value = found
        else:
            try:
                number = Decimal(str(found).strip())
                is_fine = number.is_finite() and -LARGEST_FACT <= number <= LARGEST_FACT
                value = micro_units(round(number, 6) if is_fine else number, LARGEST_FACT)
            except ArithmeticError:
                raise InvalidValueError(f"fact {self.name!r} is {kind_of(self.declared)}, not {found!r:.60}") from None
        if kind_of(value) != kind_of(self.declared):
            raise InvalidValueError(f"fact {self.name!r} is {kind_of(self.declared)}, not {found!r:.60}")
        return value

    def read(self, text: str) -> FactValue:
        """Parse a text as a value of the declared one's kind. Raises InvalidValueError."""
        value = _value(text)
        if isinstance(self.declared, str):
            return text
        if kind_of(value) != kind_of(self.declared):
            raise InvalidValueError(f"fact {self.name!r} is {kind_of(self.declared)}, not {text!r}")
        return value


def variables(facts: Iterable[Fact], hosts: Iterable[str]) -> tuple[Fact, ...]:
    """The facts that have one value: facts of the world, and each fact of hosts once for each host."""
    names = tuple(hosts)
    found = ((fact,) if fact.of is None else tuple(map(fact.on, names)) for fact in facts)
    return tuple(chain.from_iterable(found))


def misfit_of_fact(said: Mapping[str, object]) -> tuple[str, str, str] | None:
    """Return the key that contradicts the other keys of a fact, why, and the mend; None if there is none."""
    by, topic = said.get("by"), said.get("topic")
    if said.get("of") is None and said.get("hosts"):
        return "hosts", "a fact of the world has one value for all hosts", "add `of: host`, or remove it"
    for key, text in (("by", by), ("topic", topic)):
        if said.get("of") and not said.get("host") and isinstance(text, str) and HOST_MARK not in text:
            message = f"all hosts would get the value of one stream: `{HOST_MARK}` stands for the host's name"
            return key, message, f"write `{key}: {text}{'_' if key == 'by' else '/'}{HOST_MARK}`"
    if by is not None and topic is not None:
        return "topic", "a fact is observed `by` a tag or on a `topic`, not by both", "remove one of the two"
    if said.get("type") is not None and topic is None:
        return "type", "`type` is the message type of a `topic`, which this fact does not have", "add `topic: /NAME`"
    if said.get("qos") is not None and said.get("type") is None:
        return "qos", "`qos` is for ROS 2 topics, which have a message `type`", "add its message `type`"
    for key, name in (("field", "field"), ("noise", "noise"), ("silent", "silent_us")):
        if said.get(name) is not None and by is None and topic is None:
            return key, f"`{key}` is only for facts with `by` or `topic`", "add `by: TAG`, or remove it"
    declared = said["declared"]
    if said.get("noise") is not None and (isinstance(declared, bool) or not isinstance(declared, int)):
        return "noise", "`noise` is only for facts that are numbers", "remove it"
    return None


def _is_called(part: object, name: str) -> bool:
    return isinstance(part, Mapping) and name in (part.get("name"), part.get("key"))


def _value(text: str) -> FactValue:
    """The value of a word of a requirement; in quotes it is always a word. Raises InvalidValueError."""
    if text in _TRUTH:
        return _TRUTH[text]
    if text[:1] == "'":
        return text[1:-1]
    return micro_units(Decimal(text), LARGEST_FACT) if _NUMBER.fullmatch(text) else text


@dataclass(frozen=True, slots=True)
class Comparison:
    """A comparison of a fact with a value, by a `sign` such as `>=`."""

    fact: str
    sign: str
    value: FactValue

    def __str__(self) -> str:
        return f"{self.fact} {self.sign} {value_text(self.value)}"

    @property
    def bound(self) -> int | None:
        """The least value on the upper side of the compared number; None for `==`."""
        if self.sign == "==" or not isinstance(self.value, int):
            return None
        return self.value + (self.sign in (">", "<="))

    def holds(self, value: FactValue) -> bool:
        """Whether a value of the fact meets it."""
        if self.sign == "==":
            return kind_of(value) == kind_of(self.value) and value == self.value
        return isinstance(value, int) and isinstance(self.value, int) and _SIGNS[self.sign](value, self.value)

    def misfit(self, facts: Mapping[str, Fact]) -> tuple[str, str | None] | None:
        """Return why the comparison does not apply to these facts, and the mend; None if it does."""
        if self.fact not in facts:
            mend = did_you_mean(self.fact, facts, "declare it under `facts:` in the main file")
            return f"there is no fact `{self.fact}`", mend
        kind = kind_of(facts[self.fact].declared)
        if kind == kind_of(self.value):
            if self.sign != "==" or facts[self.fact].noise is None:
                return None
            return f"fact `{self.fact}` has noise, so it can't be compared by `==`", f"write `{self.fact} >= 1`"
        example = {"a number": f"{self.fact} >= 1", "a word": f"{self.fact} == WORD"}.get(kind, self.fact)
        return f"fact `{self.fact}` is {kind}, but is compared with {value_text(self.value)}", f"write `{example}`"


Blamed: TypeAlias = tuple[str, ...] | None
"""The facts by which a requirement is not met; None if it is."""


@dataclass(frozen=True, slots=True)
class Requirement:
    """An expression over facts that must hold."""

    comparisons: tuple[Comparison, ...]
    blamed: Callable[[Mapping[str, FactValue]], Blamed]
    """A function from facts' values to the facts by which the requirement is not met; None if it is met."""


@lru_cache(maxsize=4096)
def requirement(text: str) -> Requirement:
    """The requirement that an expression means. Raises TagError."""
    return _RequirementReader(text).whole()


def check_requirement(text: str) -> None:
    """Raise InvalidValueError if an expression over facts can't be read."""
    try:
        requirement(text)
    except TagError as error:
        raise InvalidValueError(f"{text!r} requires nothing: {error}") from error


def why_left_out(text: str, facts: Mapping[str, Fact]) -> str | None:
    """Return why a requirement is not met, such as `visibility is 1 m`; None if it is. `facts` must have all
    its facts by name, facts of hosts as those of one host.
    """
    blamed = requirement(text).blamed({name: fact.value for name, fact in facts.items()})
    if blamed is None:
        return None
    return " and ".join(str(facts[name]) for name in dict.fromkeys(blamed)) or f"{text} never holds"


def _all_names(parts: Iterable[Blamed]) -> tuple[str, ...]:
    return tuple(chain.from_iterable(blamed for blamed in parts if blamed is not None))


class _RequirementReader(ExpressionReader[Requirement]):
    what = "requirement"
    wanted = "a fact"
    examples = "a fact, such as `night` or `visibility >= 2.25`"
    more_tokens = rf"{_NUMBER.pattern}(?![\w.-])|[<>=]=|[<>]|"
    top = Requirement((), lambda _: None)
    bottom = Requirement((), lambda _: ())

    def all_of(self, parts: Sequence[Requirement]) -> Requirement:
        def blamed(values: Mapping[str, FactValue]) -> Blamed:
            broken = [found for part in parts if (found := part.blamed(values)) is not None]
            return _all_names(broken) if broken else None

        return Requirement(_comparisons(parts), blamed)

    def any_of(self, parts: Sequence[Requirement]) -> Requirement:
        def blamed(values: Mapping[str, FactValue]) -> Blamed:
            found = [part.blamed(values) for part in parts]
            return None if None in found else _all_names(found)

        return Requirement(_comparisons(parts), blamed)

    def none_of(self, part: Requirement) -> Requirement:
        names = tuple(comparison.fact for comparison in part.comparisons)
        return Requirement(part.comparisons, lambda values: names if part.blamed(values) is None else None)

    def _mend_here(self, usual: str) -> str:
        if self._written()[:1] in _NO_SIGNS:
            return f"compare by {', '.join(_SIGNS)} or ==; write `not NAME == VALUE` for values that differ"
        return self._mend_of_unit(self._at - 1) or super()._mend_here(usual)

    def _mend_of_unit(self, at: int) -> str | None:
        """Return the mend if a number begins at a token; else None."""
        start = [found.start() for found in self._token.finditer(self._text)][at]
        number = _NUMBER.match(self._text, start)
        return f"write the number without its unit: {number[0]}" if number else None

    def other(self, token: str) -> Requirement:
        fact, sign, value = self._name(token, self._at - 1), "==", "true"
        if self._written() in (*_SIGNS, "=="):
            sign = self._written()
            self._at += 1
            value = self._written()
            if value[:1] in ("", "<", ">", "=", "(", ")"):
                raise self._error(f"a value is missing after {sign}", "write a number, true, false or a word")
            self._at += 1
        try:
            comparison = Comparison(fact, sign, _value(value))
        except InvalidValueError as error:
            message, _, mend = str(error).partition(": ")
            raise self._error(message, mend, self._at - 1) from None
        if sign in _SIGNS and kind_of(comparison.value) != "a number":
            mend = self._mend_of_unit(self._at - 1) or f"only == takes a word; {sign} takes a number"
            raise self._error(f"{value!r} is not a number", mend, self._at - 1)
        return Requirement((comparison,), lambda values: None if comparison.holds(values[fact]) else (fact,))


def _comparisons(parts: Sequence[Requirement]) -> tuple[Comparison, ...]:
    return tuple(comparison for part in parts for comparison in part.comparisons)
