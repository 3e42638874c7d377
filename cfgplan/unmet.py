"""Why a target is not met, as data and as a sentence; several targets with the same reason share a sentence."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, NamedTuple, Self

from cfgplan.onward import grouped
from cfgplan.summary import some

LEFT_OUT: Final = "left out for now"
"""These words say that facts or failures forbid a transformation."""
_MOST_LEFT_OUT = 3
"""A reason names at most this many transformations that one cause leaves out, and as many causes."""
_PLURALS = {"wants": "want", "asks for": "ask for", "needs": "need"}
TARGET = "target"


class NeededBy(NamedTuple):
    """An input of a transformation."""

    transformation: str
    port: str

    def __str__(self) -> str:
        return f"input {self.port} of {self.transformation}"


@dataclass(frozen=True, slots=True)
class Lack:
    """The cause for which a demand is not met. Several demands may have `words`, `needs`, causes and `note` in common.

    `words` say what is missing. If an input lacks it, `needed_by` is that input and `needs` its tag. If transformations
    are left out, `left_out` has them with their causes, and `words` are empty. `note` ends the sentence.
    """

    words: str = ""
    needs: str | None = None
    needed_by: NeededBy | None = None
    left_out: tuple[tuple[str, str], ...] = ()
    note: str = ""

    @property
    def shared(self) -> Lack:
        """The part that several demands may have in common."""
        causes = dict.fromkeys(("", cause) for _, cause in self.left_out)
        return replace(self, needed_by=None, left_out=tuple(causes))


class Reason(str):
    """A sentence that keeps the data that it was made of.

    `noun` and `name` are the subject, such as `target` and its label; without a name, the sentence is `lack` alone.
    `wanted` is the tag, or the quality, that the subject `verb`s; None if the sentence does not say it.
    """

    __slots__ = ("lack", "name", "noun", "verb", "wanted")
    lack: Lack
    name: str
    noun: str
    verb: str
    wanted: str | None

    def __new__(
        cls, lack: Lack, name: str = "", wanted: str | None = None, *, noun: str = TARGET, verb: str = "wants"
    ) -> Self:
        subject = _lead([name], noun, wanted, verb) if name else ""
        made = super().__new__(cls, _sentence(subject, wanted, [lack], 1, sys.maxsize))
        made.lack, made.name, made.noun, made.verb, made.wanted = lack, name, noun, verb, wanted
        return made

    @classmethod
    def of(cls, text: str) -> Self:
        """Return a text as a reason: itself if it is one, else without further data."""
        return text if isinstance(text, cls) else cls(Lack(text))

    def __reduce__(self) -> tuple[object, ...]:
        return _made, (self.lack, self.name, self.wanted, self.noun, self.verb)

    @property
    def rest(self) -> str:
        """The sentence without the subject and its wish, for a row that names them. It may begin with a verb."""
        return _sentence("", None, [self.lack], 1, sys.maxsize)

    @property
    def fault(self) -> str:
        """The `rest` where that is a sentence; else the whole sentence."""
        return str(self) if self.wanted is None or self.lack.left_out else self.rest

    def about(self, noun: str, name: str) -> Reason:
        """Return the same reason with another subject; one without a subject stays as it is."""
        return Reason(self.lack, name, self.wanted, noun=noun, verb=self.verb) if self.name else self

    def noted(self, note: str) -> Reason:
        """Return the same reason with further words at its end."""
        lack = replace(self.lack, note=f"{self.lack.note}{note}")
        return Reason(lack, self.name, self.wanted, noun=self.noun, verb=self.verb)


def _made(lack: Lack, name: str, wanted: str | None, noun: str, verb: str) -> Reason:
    return Reason(lack, name, wanted, noun=noun, verb=verb)


def reason_record(text: str) -> dict[str, Any]:
    """Return a reason as plain data, for JSON; `manual/control.md` has its keys. Empty parts are left out."""
    reason = Reason.of(text)
    lack = reason.lack
    record = {
        "subject": {"noun": reason.noun, "name": reason.name} if reason.name else None,
        "verb": reason.verb if reason.wanted is not None else None,
        "wanted": reason.wanted,
        "lack": lack.words,
        "needs": lack.needs,
        "needed_by": None if lack.needed_by is None else lack.needed_by._asdict(),
        "left_out": dict(lack.left_out),
        "note": lack.note,
    }
    return {key: value for key, value in record.items() if value}


def read_reason(record: Mapping[str, Any]) -> Reason:
    """Return the reason of which `record` is the `reason_record`."""
    needed_by, subject = record.get("needed_by"), record.get("subject") or {"noun": TARGET, "name": ""}
    lack = Lack(
        record.get("lack", ""),
        record.get("needs"),
        None if needed_by is None else NeededBy(**needed_by),
        tuple(record.get("left_out", {}).items()),
        record.get("note", ""),
    )
    wanted, verb = record.get("wanted"), record.get("verb", "wants")
    return Reason(lack, subject["name"], wanted, noun=subject["noun"], verb=verb)


@dataclass(frozen=True)
class SharedReason:
    """Why targets are not met; `labels` are these targets. The text is a sentence about them if `names_them`. It names
    the transformations `left_out`.
    """

    labels: tuple[str, ...]
    text: str
    names_them: bool
    left_out: frozenset[str] = frozenset()


def shared_reasons(reasons: Mapping[str, str], most: int = sys.maxsize) -> list[SharedReason]:
    """Return the reasons of targets, by label, so that each is told once, with all targets, inputs and transformations
    that have it. At most `most` of each are named.
    """
    every = {label: Reason.of(reason) for label, reason in reasons.items()}
    alike = grouped((_common(label, reason), label) for label, reason in every.items())
    return [_shared(labels, [every[label] for label in labels], most) for labels in alike.values()]


def _common(label: str, reason: Reason) -> object:
    """Return the part of a target's reason that several targets may have in common."""
    if reason.name != label:
        return str(reason)
    return reason.noun, reason.verb, reason.wanted is None, reason.lack.shared


def _shared(labels: Sequence[str], reasons: Sequence[Reason], most: int) -> SharedReason:
    first, lacks = reasons[0], [reason.lack for reason in reasons]
    is_about = first.name == labels[0]
    if len(labels) == 1 or not is_about:
        return SharedReason(tuple(labels), str(first), is_about, _named_left_out(lacks[:1], 1, most))
    of = grouped((reason.wanted, label) for label, reason in zip(labels, reasons, strict=True))
    leads = (_lead(these, first.noun, wanted, first.verb, most) for wanted, these in of.items())
    text = _sentence(some(leads, most), first.wanted, lacks, len(labels), most)
    return SharedReason(tuple(labels), text, True, _named_left_out(lacks, len(labels), most))


def _lead(names: Sequence[str], noun: str, wanted: str | None, verb: str, most: int = sys.maxsize) -> str:
    is_one = len(names) == 1
    who = f"{noun}{'' if is_one or not noun else 's'} {some(names, most)}".lstrip()
    return who if wanted is None else f"{who} {verb if is_one else _PLURALS[verb]} {wanted}"


def _sentence(lead: str, wanted: str | None, lacks: Sequence[Lack], number: int, most: int) -> str:
    """Return the sentence about `number` demands with a lack in common; `lead` is its beginning, or empty."""
    lack = lacks[0]
    words = lack.words
    if lack.left_out:
        verb = "needs" if number == 1 else _PLURALS["needs"]
        named = (f"{some(labels, _most(number, most))} ({why})" for why, labels in _by_cause(lacks).items())
        words = f"{verb} transformations that are {LEFT_OUT}: {some(named, _MOST_LEFT_OUT)}"
    elif inputs := list(dict.fromkeys(str(each.needed_by) for each in lacks if each.needed_by is not None)):
        verb = "needs" if len(inputs) == 1 else _PLURALS["needs"]
        words = f"{some(inputs, most)} {verb} {lack.needs}, and {lack.words}"
    joint = "" if not lead else " " if wanted is None else ", but "
    return f"{lead}{joint}{words}{lack.note}"


def _most(number: int, most: int) -> int:
    """Return how many transformations that one cause leaves out are named in a sentence about `number` demands."""
    return min(most, max(_MOST_LEFT_OUT, number))


def _by_cause(lacks: Iterable[Lack]) -> dict[str, list[str]]:
    pairs = dict.fromkeys((why, label) for lack in lacks for label, why in lack.left_out)
    return grouped(pairs)


def _named_left_out(lacks: Iterable[Lack], number: int, most: int) -> frozenset[str]:
    causes = list(_by_cause(lacks).values())[:_MOST_LEFT_OUT]
    return frozenset(label for labels in causes for label in labels[: _most(number, most)])
