"""The basis of a plan: digests of the running units and of the wanted environment, by name, which show why a plan is
stale.
"""

from __future__ import annotations

import hashlib
import threading
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

import msgspec

from cfgplan.api import World
from cfgplan.domain import ChangeSet, Environment
from cfgplan.errors import Fault
from cfgplan.formats.plan_file import dump_plan
from cfgplan.planning import Plan, Problem, Status
from cfgplan_runtime.lifecycle.configuration import PlanInput, avoided_now
from cfgplan_runtime.lifecycle.deliberation import Deliberation, Findings
from cfgplan_runtime.lifecycle.reports import Decision

Basis: TypeAlias = Mapping[str, Mapping[str, str]]
"""By kind and name: a digest of each running unit, each transformation, target and setting, and the truth of each
comparison of a fact. It has neither the numbers of facts nor the qualities that follow from them: noisy ones would make
any plan stale.
"""

_STALE_FOR = {
    "unit": ("{} runs now", "{} does not run any more", "{} is wired differently now"),
    "transformation": ("{} exists now", "{} does not exist any more", "{} has been changed"),
    "fact": ("{} is required now", "{} is not required any more", "{} is not as it was"),
    "target": ("{} is wanted now", "{} is not wanted any more", "{} has been changed"),
    "setting": ("{} is set now", "{} is not set any more", "{} has been changed"),
}
_MOST_REASONS = 6


@dataclass(frozen=True)
class Preview:
    """The change that a review would make now, with its problem and its basis."""

    findings: Findings
    problem: Problem
    basis: Basis

    def holds_for(self, plan_input: PlanInput) -> bool:
        """Whether a review of this input would give the same plan: basis, facts and avoided transformations are equal,
        and no transformation backs off on single hosts, which the preview does not record.
        """
        return (
            not staleness(self.basis, basis_of(plan_input.world, plan_input.running))
            and plan_input.world.environment.facts == self.findings.planned.facts
            and avoided_now(plan_input) == self.findings.avoided
            and not plan_input.situation.back_offs.avoided
            and self.findings.change_set is not None
        )


def preview_of(deliberation: Deliberation, plan_input: PlanInput, stop: threading.Event) -> Preview:
    """The change that an optimising review of this input would make. `stop` ends planning early."""
    findings = deliberation.think(plan_input, optimises=True, stop=stop)
    problem = deliberation.problem(findings.planned, plan_input.world)
    return Preview(findings, problem, basis_of(plan_input.world, plan_input.running))


def basis_of(world: World, running: Environment) -> Basis:
    """The basis of a plan for a world in which `running` runs."""
    wanted = world.environment
    settings: dict[str, object] = {
        "horizon": world.horizon_s,
        "max_cost": world.max_cost_us,
        "survive": world.survive,
        "hosts": wanted.hosts,
        "links": wanted.links,
        "transfer": wanted.transfer_us,
        "minimise": wanted.minimise,
        "qualities": wanted.qualities,
        "ontology": (sorted(world.ontology.axioms), world.ontology.ignored),
    }
    kinds: tuple[tuple[str, Mapping[str, object]], ...] = (
        ("unit", running.unit),
        ("transformation", wanted.as_declared.transformation),
        ("target", wanted.target),
        ("fact", wanted.sides),
        ("setting", settings),
    )
    return {kind: {name: _digest(value) for name, value in values.items()} for kind, values in kinds}


def previewed(preview: Preview) -> Plan:
    """The change that a review would make, as a plan."""
    findings = preview.findings
    status = Status.UNKNOWN if findings.change_set is None else Status.FEASIBLE
    return Plan(
        "review",
        Status.OPTIMAL if findings.is_proven else status,
        findings.change_set if findings.decision is not Decision.KEPT else ChangeSet(),
        findings.cost_us,
        findings.bound_us,
        findings.unmet,
        undecided=findings.undecided,
        seconds=findings.seconds,
    )


def plan_text(preview: Preview) -> str:
    """The plan file (JSON) of a preview."""
    digest = hashlib.sha256(msgspec.json.encode(preview.basis, order="deterministic")).hexdigest()
    return dump_plan(previewed(preview), preview.problem, digest, preview.basis)


def staleness(then: Basis, now: Basis) -> tuple[Fault, ...]:
    """The reasons why a plan for the basis `then` does not fit the basis `now`; empty if it does."""
    why = [f"{kind} {said}" for kind in _STALE_FOR for said in _differences(kind, then.get(kind, {}), now[kind])]
    more = len(why) - _MOST_REASONS
    told = [*why[:_MOST_REASONS], *([f"and {more} more differ"] if more > 0 else [])]
    mend = "make a new plan by `cfgplan ctl plan --out`"
    return tuple(Fault(f"the plan is stale: {each}", mend=mend) for each in told)


def _differences(kind: str, then: Mapping[str, str], now: Mapping[str, str]) -> Iterator[str]:
    come, gone, changed = _STALE_FOR[kind]
    for name in sorted(then.keys() | now.keys()):
        if then.get(name) != now.get(name):
            yield (come if name not in then else gone if name not in now else changed).format(name)


def _digest(value: Any) -> str:
    return hashlib.sha256(msgspec.json.encode(value, order="deterministic", enc_hook=repr)).hexdigest()[:16]
