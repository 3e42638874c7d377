"""Hosts and quality attributes as written, and what transformations, units and targets say of them."""

from __future__ import annotations

from collections.abc import Mapping

from cfgplan.domain import Host
from cfgplan.errors import Fault, InvalidValueError
from cfgplan.formats.document import Document
from cfgplan.formats.fields import ContributionPart, TargetPart, UnitPart, WishPart
from cfgplan.formats.left_out import LeftOut
from cfgplan.formats.places import Path, Source
from cfgplan.formats.suggestions import did_you_mean
from cfgplan.planning import Failures
from cfgplan.qualities import Better, Contribution, Over, QualityAttribute, QualityRule, Wish


class FleetReader:
    """The hosts and attributes of one document; what is wrong goes into `faults`."""

    def __init__(self, document: Document, left_out: LeftOut, faults: list[Fault]) -> None:
        self._document = document
        self._left_out = left_out
        self._faults = faults
        self.hosts: dict[str, Host] = {}
        self.attributes: dict[str, QualityAttribute] = {}
        main = document.files[0].source if document.files else None
        for index, host in enumerate(document.header.hosts or ()):
            if main is not None and self._is_new(main, ("hosts", index), host.name, self.hosts):
                try:
                    self.hosts[host.name] = Host(**host.values())
                except InvalidValueError as error:
                    self._faults.append(main.fault(("hosts", index, "offers"), str(error), "remove one of the two"))
                    left_out.add("hosts", host.name)
        for index, part in enumerate(document.header.qualities or ()):
            if main is not None and self._is_new(main, ("qualities", index), part.name, self.attributes):
                try:
                    self.attributes[part.name] = QualityAttribute(**part.values())
                except InvalidValueError as error:
                    self._faults.append(main.fault(("qualities", index), str(error), "exchange worst and best"))
                    left_out.add("qualities", part.name)
        self.survive = self._survived(main)

    def _survived(self, main: Source | None) -> Failures | None:
        written = self._document.header.survive
        has_hosts = bool(self._document.header.hosts)
        if written == "hosts" and not has_hosts and not self._left_out.any_of("hosts") and main is not None:
            message = "the failure of a host can't be survived where no hosts are declared"
            self._faults.append(main.fault(("survive",), message, "declare `hosts:`, or write `survive: units`"))
            return None
        if written == 1:
            return Failures.HOSTS if has_hosts else Failures.UNITS
        return Failures(written) if isinstance(written, str) else None

    def check_host(self, source: Source, path: Path, name: str, *, is_choice: bool = False) -> None:
        """Note a host that is not declared. If none are declared, the host of a transformation is free text."""
        if name in self.hosts or self._left_out.any_of("hosts"):
            return
        if self.hosts or is_choice:
            mend = did_you_mean(name, self.hosts, "declare it under `hosts:`")
            self._faults.append(source.fault(path, f"there is no host `{name}`", mend))

    def host_of(self, source: Source, path: Path, part: UnitPart, only: str | None) -> str | None:
        """Where a unit runs: where it says, or the only host that its transformation allows."""
        if part.host is not None:
            self.check_host(source, (*path, "host"), part.host, is_choice=True)
            return part.host
        if self.hosts and only is None and not self._left_out.any_of("hosts"):
            mend = f"add `host:`, one of {', '.join(self.hosts)}"
            self._faults.append(
                source.fault((*path, "id"), f"unit `{part.id}` does not say on which host it runs", mend)
            )
        return only if only in self.hosts else None

    def contributions(
        self, source: Source, path: Path, written: Mapping[str, int | ContributionPart]
    ) -> tuple[Contribution, ...]:
        """The contributions of an output to quality attributes; `path` is that of the mapping.

        Empty if no attributes are declared, so that a library may say more than an environment wants.
        """
        found: list[Contribution] = []
        if not self.attributes and not self._left_out.any_of("qualities"):
            return ()
        for name, part in written.items():
            attribute = self._attribute(source, (*path, name), name)
            if attribute is None:
                continue
            if isinstance(part, ContributionPart):
                stated = {rule: getattr(part, rule) for rule in QualityRule if getattr(part, rule) is not None}
            else:
                stated = {attribute.rule: part}
            if len(stated) != 1:
                message = "an output says exactly one of add, limit, scale and set"
                self._faults.append(source.fault((*path, name), message, "write one of them, such as {scale: 0.7}"))
                continue
            ((rule, value),) = stated.items()
            over = Over(part.of) if isinstance(part, ContributionPart) else Over.WORST
            try:
                found.append(Contribution(name, rule, value, over))
            except InvalidValueError as error:
                message, _, mend = str(error).partition(": ")
                self._faults.append(source.fault((*path, name), message, mend))
        return tuple(found)

    def wishes(self, source: Source, path: Path, part: TargetPart) -> tuple[Wish, ...]:
        """What a target asks of its stream."""
        found = []
        for name, wish in (part.quality or {}).items():
            place = (*path, "quality", name)
            attribute = self._attribute(source, place, name)
            if attribute is not None and self._is_well_put(source, place, attribute, wish):
                found.append(Wish(name, **wish.values()))
        return tuple(found)

    def _is_well_put(self, source: Source, place: Path, attribute: QualityAttribute, wish: WishPart) -> bool:
        wrong = "at_least" if attribute.better is Better.LOWER else "at_most"
        right = "at_most" if attribute.better is Better.LOWER else "at_least"
        if getattr(wish, wrong) is not None:
            message = f"a {attribute.better} {attribute.name} is better, so `{wrong}` asks for a bad one"
            self._faults.append(source.fault((*place, wrong), message, f"write `{right}`", at_key=True))
            return False
        if getattr(wish, right) is None and wish.weight == 0:
            message = f"nothing is asked of {attribute.name}"
            self._faults.append(source.fault(place, message, f"write `{right}`, a `weight`, or both"))
            return False
        return True

    def _attribute(self, source: Source, place: Path, name: str) -> QualityAttribute | None:
        if name not in self.attributes and not self._left_out.any_of("qualities"):
            mend = did_you_mean(name, self.attributes, "declare it under `qualities:` in the main file")
            self._faults.append(source.fault(place, f"there is no quality attribute `{name}`", mend, at_key=True))
        return self.attributes.get(name)

    def _is_new(self, source: Source, path: Path, name: str, known: Mapping[str, object]) -> bool:
        if name in known:
            self._faults.append(source.fault((*path, "name"), f"`{name}` stands here twice", "remove one of them"))
        return name not in known
