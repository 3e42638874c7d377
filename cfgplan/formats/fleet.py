"""Hosts and quality attributes as written, and the references of transformations, units and targets to them."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import replace
from typing import Any

from cfgplan.domain import MANAGER, Host, Link
from cfgplan.errors import Fault, InvalidValueError, TagError, did_you_mean
from cfgplan.facts import Fact, FactValue, kind_of, misfit_of_fact, requirement
from cfgplan.formats.document import Document
from cfgplan.formats.fields import (
    ContributionPart,
    CurvePart,
    FactPart,
    HostPart,
    LinkPart,
    Part,
    TargetPart,
    UnitPart,
    WishPart,
)
from cfgplan.formats.left_out import LeftOut
from cfgplan.formats.places import Passage
from cfgplan.planning import Failures
from cfgplan.qualities import MEASURES, Better, Contribution, Curve, Over, QualityAttribute, QualityRule, Teller, Wish
from cfgplan.selectors import selector


class FleetReader:
    """The hosts and attributes of one document; faults are added to `faults`."""

    def __init__(self, document: Document, left_out: LeftOut, faults: list[Fault]) -> None:
        self._left_out = left_out
        self.hosts: dict[str, Host] = {}
        self.copies: dict[str, tuple[str, ...]] = {}
        """The hosts that have a name together, by that name, such as `node` for `node.1` and `node.2`."""
        self.attributes: dict[str, QualityAttribute] = {}
        self.links: tuple[Link, ...] = ()
        self.facts: dict[str, Fact] = {}
        self.origins: dict[tuple[str, str], Passage] = {}
        """The places of hosts, quality attributes and facts by kind and name, of links by number, and of the header."""
        header = document.header
        main = Passage(document.files[0].source, (), faults) if document.files else None
        if main is None:  # a folder of the paper's XML has no header
            self.survive = None
            return
        self.origins["", ""] = main
        for index, host in enumerate(header.hosts or ()):
            entry = main.at("hosts", index)
            names, known = _names_of(host), {*self.hosts, *self.copies}
            if all(self._is_new(entry, name, known) for name in dict.fromkeys((host.name, *names))):
                self.origins |= {("host", name): entry for name in names}
                try:
                    self.hosts |= {name: _made(host, name) for name in names}
                except InvalidValueError as error:
                    at, mend = (
                        ("name", "name it otherwise") if MANAGER in names else ("offers", "remove one of the two")
                    )
                    entry.at(at).note(str(error), mend)
                    left_out.add("hosts", host.name)
                if host.copies > 1:
                    self.copies[host.name] = names
        for index, part in enumerate(header.qualities or ()):
            entry = main.at("qualities", index)
            if self._is_new(entry, part.name, self.attributes):
                self.origins["quality", part.name] = entry
                try:
                    self.attributes[part.name] = QualityAttribute(**part.values())
                except InvalidValueError as error:
                    entry.note(str(error), "exchange worst and best")
                    left_out.add("qualities", part.name)
        for name, fact in (header.facts or {}).items():
            self._note_fact(main.at("facts", name), name, fact)
        for index, link in enumerate(header.links or ()):
            ends = [main.at("links", index, "between", number) for number in range(len(link.between))]
            if sum(map(self.is_selector, ends, link.between)) == len(ends) and self._may_add(
                main.at("links", index), link
            ):
                between = link.between[0], link.between[1]
                self.origins["link", f"link {len(self.links) + 1}"] = main.at("links", index)
                self.links += (Link(between, link.bandwidth, link.price, link.latency, link.adds),)
        self.survive = self._survived(main.at("survive"), header.survive, has_hosts=bool(header.hosts))

    def _note_fact(self, entry: Passage, name: str, part: FactPart) -> None:
        """Add a fact; a contradiction among its keys is noted, and leaves the fact unobserved."""
        said, self.origins["fact", name] = part.values(), entry
        if misfit := misfit_of_fact(said):
            key, message, mend = misfit
            entry.at(key).note(message, mend, at_key=True)
            said = {"declared": part.declared}
        if said.get("of") is not None and not self.hosts and not self._left_out.any_of("hosts"):
            entry.at("of").note("no hosts are declared", "declare `hosts:`, or remove `of: host`")
        self.facts[name] = Fact(name, **said)
        self.facts[name] = replace(self.facts[name], hosts=self._values_of_hosts(entry.at("hosts"), self.facts[name]))

    def _values_of_hosts(self, entry: Passage, fact: Fact) -> dict[str, FactValue]:
        """The declared values of a fact on hosts; that of a name of several hosts is that of each."""
        found: dict[str, FactValue] = {}
        for name, value in fact.hosts.items():
            hosts = self.copies.get(name, (name,))
            if name not in self.copies:
                self.check_host(entry.at(name), name, is_choice=True)
            if kind_of(value) == kind_of(fact.declared):
                found |= dict.fromkeys(hosts, value)
            else:
                kinds = f"{kind_of(value)}, but its `declared` is {kind_of(fact.declared)}"
                entry.at(name).note(f"the value on {name} is {kinds}", "write a value of the same kind")
        return found

    def _may_add(self, entry: Passage, link: LinkPart) -> bool:
        """Whether the latency of a link may be added to an attribute, if it has one."""
        if link.adds is None:
            if link.latency:
                mend = f"write `adds:`, {', '.join(self.attributes) or 'one of `qualities:`'}"
                entry.at("latency").note(
                    "the link has a `latency`, but no `adds` that names the quality it is added to", mend, at_key=True
                )
            return not link.latency
        if not link.latency:
            entry.at("adds").note("the link has `adds`, but no `latency` to add", "add `latency:`", at_key=True)
            return False
        attribute = self._attribute(entry.at("adds"), link.adds, at_key=False)
        if attribute is not None and attribute.better is Better.HIGHER:
            message = f"a latency can't be added to {link.adds}, whose higher values are better"
            entry.at("adds").note(message, "name an attribute with `better: lower`")
        return attribute is not None and attribute.better is Better.LOWER

    def _survived(self, entry: Passage, written: int | str, *, has_hosts: bool) -> Failures | None:
        if written == "hosts" and not has_hosts and not self._left_out.any_of("hosts"):
            message = "the failure of a host can't be survived where no hosts are declared"
            entry.note(message, "declare `hosts:`, or write `survive: units`")
            return None
        if written == 1:
            return Failures.HOSTS if has_hosts else Failures.UNITS
        return Failures(written) if isinstance(written, str) else None

    def choice(self, names: Iterable[str]) -> tuple[str, ...]:
        """Return the hosts that some names stand for; the name of several copies stands for all of them."""
        return tuple(dict.fromkeys(host for name in names for host in self.copies.get(name, (name,))))

    def check_host(self, entry: Passage, name: str, *, is_choice: bool = False) -> None:
        """Note a host that is not declared. If none are declared, the host of a transformation is free text."""
        if name in self.hosts or self._left_out.any_of("hosts"):
            return
        if name in self.copies:
            entry.note(
                f"`{name}` stands for {len(self.copies[name])} hosts",
                f"write which one, such as {self.copies[name][0]}",
            )
        elif self.hosts or is_choice:
            entry.note(f"there is no host `{name}`", did_you_mean(name, self.hosts, "declare it under `hosts:`"))

    def is_selector(self, entry: Passage, text: str, *, at_key: bool = False) -> bool:
        """Whether an expression over labels can be read; it stands at a value, or at its key."""
        try:
            selector(text)
        except TagError as error:
            entry.note(error.message, error.mend, at_key=at_key, text_column=error.column)
            return False
        return True

    def are_selectors(self, entry: Passage, part: Part) -> bool:
        """Whether each expression over labels that a part says can be read."""
        said = [(key, value) for key in part.selecting() if (value := getattr(part, key)) is not None]
        if not said:
            return True
        places = [
            (entry.at(key, text) if isinstance(value, dict) else entry.at(key), text, isinstance(value, dict))
            for key, value in said
            for text in (value if isinstance(value, dict) else [value])
        ]
        return sum(self.is_selector(at, text, at_key=at_key) for at, text, at_key in places) == len(places)

    def is_requirement(self, entry: Passage, text: str) -> bool:
        """Whether an expression over facts can be read and asks about declared facts."""
        try:
            asked = requirement(text)
        except TagError as error:
            entry.note(error.message, error.mend, text_column=error.column)
            return False
        if self._left_out.any_of("facts"):
            return True
        misfits = [misfit for each in asked.comparisons if (misfit := each.misfit(self.facts)) is not None]
        for message, mend in dict.fromkeys(misfits):
            entry.note(message, mend)
        return not misfits

    def host_of(self, entry: Passage, part: UnitPart, only: str | None) -> str | None:
        """Return the host of a unit: the one it names, or the only one that its transformation allows."""
        host: str | None = part.host
        if host is not None:
            self.check_host(entry.at("host"), host, is_choice=True)
            return host
        if self.hosts and only is None and not self._left_out.any_of("hosts"):
            mend = f"add `host:`, one of {', '.join(self.hosts)}"
            entry.at("id").note(f"unit `{part.id}` does not say on which host it runs", mend)
        return only if only in self.hosts else None

    def contributions(self, entry: Passage, written: Mapping[str, int | ContributionPart]) -> tuple[Contribution, ...]:
        """The contributions of an output to quality attributes; `entry` is that of the mapping.

        Empty if no attributes are declared, so that a library may say more than an environment wants.
        """
        if not self.attributes and not self._left_out.any_of("qualities"):
            return ()
        found = (self._contribution(entry.at(name), name, part) for name, part in written.items())
        return tuple(contribution for contribution in found if contribution is not None)

    def _contribution(self, entry: Passage, name: str, part: int | ContributionPart) -> Contribution | None:
        attribute = self._attribute(entry, name)
        if attribute is None:
            return None
        stated: dict[QualityRule, Any] = {attribute.rule: part}
        over, observe = Over.WORST, None
        if isinstance(part, ContributionPart):
            stated = {rule: getattr(part, rule) for rule in QualityRule if getattr(part, rule) is not None}
            over, observe = Over(part.of), part.observe
        if len(stated) != 1:
            message = "an output's quality needs exactly one of add, limit, scale and set"
            entry.note(message, "write one of them, such as {scale: 0.7}")
            return None
        ((rule, value),) = stated.items()
        curve = value if isinstance(value, CurvePart) else None
        try:
            contribution = Contribution(name, rule, 0 if curve else value, over, observe=observe)
            is_statistic = contribution.told is not None and contribution.told.teller is Teller.STATISTICS
            known = (None, "s") if is_statistic else MEASURES.get(contribution.measured or "")
            if known is not None and attribute.unit not in known:
                message = f"{observe} is in {known[-1] or 'shares'}, but attribute `{name}` is in {attribute.unit}"
                entry.note(message, f"give the attribute the unit {known[-1]}" if known[-1] else "remove its unit")
                return None
            if curve is None:
                return contribution
            return self._following(entry.at(rule.value), contribution, curve)
        except InvalidValueError as error:
            message, _, mend = str(error).partition(": ")
            entry.note(message, mend)
            return None

    def _following(self, entry: Passage, stated: Contribution, part: CurvePart) -> Contribution | None:
        """A contribution whose value follows a fact; raises InvalidValueError for points that don't rise."""
        if part.by not in self.facts:
            if not self._left_out.any_of("facts"):
                mend = did_you_mean(part.by, self.facts, "declare it under `facts:` in the main file")
                entry.at("by").note(f"there is no fact `{part.by}`", mend)
            return None
        fact = self.facts[part.by]
        if fact.of is not None:
            mend = "name a fact of the world, or write a transformation for each kind of host, with `requires`"
            entry.at("by").note(f"a quality can't follow fact `{part.by}`, whose value differs from host to host", mend)
            return None
        if isinstance(fact.value, bool | str):
            entry.at("by").note(
                f"a quality can't follow fact `{part.by}`, which is {kind_of(fact.value)}", "name a number"
            )
            return None
        curve = Curve(part.by, tuple((low, value) for low, value in part.points))
        return replace(stated, value=curve.at(fact.value), by=curve)

    def wishes(self, entry: Passage, part: TargetPart) -> tuple[Wish, ...]:
        """Return a target's demands on the quality of its stream; `entry` is the target's mapping."""
        found = []
        for name, wish in (part.quality or {}).items():
            attribute = self._attribute(entry.at(name), name)
            if attribute is not None and self._is_well_put(entry.at(name), attribute, wish):
                found.append(Wish(name, **wish.values()))
        return tuple(found)

    def _is_well_put(self, entry: Passage, attribute: QualityAttribute, wish: WishPart) -> bool:
        wrong, right = "at_most", "at_least"
        if attribute.better is Better.LOWER:
            wrong, right = right, wrong
        if getattr(wish, wrong) is not None:
            message = f"a {attribute.better} {attribute.name} is better, so `{wrong}` asks for a bad one"
            entry.at(wrong).note(message, f"write `{right}`", at_key=True)
            return False
        if getattr(wish, right) is None and wish.weight == 0:
            entry.note(f"the target states no demand on {attribute.name}", f"write `{right}`, a `weight`, or both")
            return False
        return True

    def _attribute(self, entry: Passage, name: str, *, at_key: bool = True) -> QualityAttribute | None:
        if name not in self.attributes and not self._left_out.any_of("qualities"):
            mend = did_you_mean(name, self.attributes, "declare it under `qualities:` in the main file")
            entry.note(f"there is no quality attribute `{name}`", mend, at_key=at_key)
        return self.attributes.get(name)

    def _is_new(self, entry: Passage, name: str, known: Collection[str]) -> bool:
        if name in known:
            entry.at("name").note(f"`{name}` occurs twice", "remove one of them")
        return name not in known


def _names_of(part: HostPart) -> tuple[str, ...]:
    """The names of the hosts that a part of the file stands for."""
    return (part.name,) if part.copies == 1 else tuple(f"{part.name}.{n}" for n in range(1, part.copies + 1))


def _made(part: HostPart, name: str) -> Host:
    said = {key: value for key, value in part.values().items() if key != "copies"}
    group = () if name == part.name else (part.name,)
    return Host(**{**said, "name": name, "labels": (*said.get("labels", ()), *group)})
