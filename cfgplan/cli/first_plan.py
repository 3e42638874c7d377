"""The first plan of a run: made as the first review makes it, shown, and confirmed by the user if it stops units."""

from __future__ import annotations

import json
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from types import MappingProxyType
from typing import TYPE_CHECKING

from cfgplan.cli.options import placed_fault
from cfgplan.cli.screen import Screen, counted, json_line
from cfgplan.domain import Environment
from cfgplan.errors import Fault, InputError
from cfgplan.onward import grouped
from cfgplan.summary import some

if TYPE_CHECKING:
    from cfgplan_runtime.lifecycle.basis import Preview
    from cfgplan_runtime.operating.operation import Settings
    from cfgplan_runtime.supervision.events import FailuresKept

    from cfgplan.api import World
    from cfgplan.explaining.best_effort import BestEffort
    from cfgplan.matching import Matches

_MOST_LISTED = 4
_NO_UNITS = Environment()


@dataclass(frozen=True)
class FirstPlan:
    """A first plan of a world. `ended` are the ids of units of an earlier run that it does not adopt. `faults` say, by
    label, why the code of a transformation can't be started.
    """

    world: World
    preview: Preview
    ended: tuple[str, ...] = ()
    faults: Mapping[str, Fault] = field(default_factory=dict)

    @property
    def found(self) -> BestEffort | None:
        """The planner's answer; None if there is none that may be carried out."""
        findings = self.preview.findings
        found = findings.found
        return None if found is None or (findings.change_set is None and found.plan.change_set is not None) else found

    @property
    def stopped(self) -> tuple[str, ...]:
        """The ids of the units of an earlier run that would be stopped."""
        changes = self.preview.findings.change_set
        return tuple(sorted({*self.ended, *(() if changes is None else changes.stopped)}))

    def document(self) -> str:
        """The plan file (JSON)."""
        from cfgplan.formats.plan_file import dump_plan

        assert self.found is not None
        return dump_plan(self.found.plan, self.found.problem, self.world.digest)

    def show(self, screen: Screen, difference: Callable[[Environment], str] | None = None) -> None:
        """Show the plan as text, as `solve` does; `difference` compares the units that it leaves with others."""
        from cfgplan.cli.plan_text import update_text

        found = self.found
        assert found is not None
        screen.show_at_once(update_text(found.problem, found.plan, found.given_up))
        for line in self._notes(found):
            screen.warn(line)
        if difference is not None and found.plan.change_set is not None:
            screen.note(difference(found.problem.after(found.plan)), style="")

    def _notes(self, found: BestEffort) -> Iterator[str]:
        if self.ended:
            ended = ", ".join(self.ended)
            yield f"left by an earlier run, and stopped since the file now starts them differently: {ended}"
        if found.plan.change_set is None:
            return
        library = self.world.environment.transformation
        started = {unit.transformation for unit in found.plan.change_set.started}
        lacking = sorted(label for label in started if not library[label].source)
        if lacking:
            labels = some(lacking, _MOST_LISTED)
            yield f"{labels}: no unit code (`source:`) is named; a run can't start it, and plans again without it"

    def tell(self, screen: Screen) -> None:
        """Print the plan as a line of JSON, as one of the run's events."""
        document = json.loads(self.document())
        screen.tell(json_line({"event": "Planned", "plan": document, "ended": self.ended}))

    def confirm(self, screen: Screen) -> bool:
        """Ask whether to go on where units of an earlier run would be stopped. Returns whether to.

        Raises InputError without a terminal.
        """
        if not self.stopped:
            return True
        count, named = counted(len(self.stopped), "unit"), some(self.stopped, _MOST_LISTED)
        if screen.json or not (sys.stdin.isatty() and sys.stderr.isatty()):
            told = f"this run would stop {count} of an earlier run: {named}; nothing was changed"
            at_terminal = "without --json at a terminal" if screen.json else "at a terminal"
            raise InputError.of(told, mend=f"add --yes to stop them, or start the run {at_terminal}, which asks")
        screen.note(f"This run stops {count} of an earlier run: {named}. Go on? [y/N]", style="bold yellow")
        if sys.stdin.readline().strip().lower() in ("y", "yes"):
            return True
        screen.note("Nothing was changed; the units of the earlier run keep running.")
        return False


def show_faults(faults: Mapping[str, Fault], world: World, screen: Screen) -> None:
    """Show each fault of a world's code once, with the labels of all transformations that have it."""
    from cfgplan_runtime.operating.sources import left_out_text

    for fault, labels in grouped((fault, label) for label, fault in faults.items()).items():
        told = partial(left_out_text, labels)
        screen.warn_of(fault if world.file is None else placed_fault(world.file, fault, labels, told))


def first_review(
    world: World,
    settings: Settings,
    matches: Matches,
    running: Environment = _NO_UNITS,
    warn: Callable[[str], None] = lambda _: None,
    faults: Mapping[str, Fault] = MappingProxyType({}),
    failures: Iterable[FailuresKept] = (),
) -> Preview:
    """Plan as the first review of a run would, with the estimates that earlier runs have kept.

    `running` are the units of an earlier run that this one adopts. `warn` is told if the estimates can't be used.
    Transformations whose code has `faults`, by label, are left out. Places with `failures` are left out while they back
    off.
    """
    from cfgplan_runtime.estimating.estimates_file import EstimatesError, load
    from cfgplan_runtime.estimating.estimator import make_estimator
    from cfgplan_runtime.lifecycle.basis import preview_of
    from cfgplan_runtime.lifecycle.decisions import first_state
    from cfgplan_runtime.lifecycle.deliberation import Deliberation
    from cfgplan_runtime.lifecycle.guarded_estimator import GuardedEstimator

    estimator = make_estimator(settings.estimator, settings.guess)
    if settings.estimates is not None:
        try:
            load(estimator, settings.estimates, time.monotonic())
        except EstimatesError as error:
            warn(str(error))
    policy = replace(settings.policy, hosts_s=None, refuses_hosts=False)  # no host is asked whether it is there
    deliberation = Deliberation(settings.planner, GuardedEstimator(estimator), policy, matches)
    plan_input = first_state(world, policy).plan_input
    now_s = time.monotonic()
    situation = plan_input.situation.with_started(running.units, running, now_s)
    for one in failures:
        back_offs = situation.back_offs.restoring(one, now_s)
        situation = replace(situation, back_offs=back_offs)
    code_faults = {label: str(fault) for label, fault in faults.items()}
    plan_input = replace(plan_input, running=running, situation=replace(situation, code_faults=code_faults))
    return preview_of(deliberation, plan_input, threading.Event())
