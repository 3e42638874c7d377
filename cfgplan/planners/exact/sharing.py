"""A model of given units decides whether they can be rewired to meet targets while they share streams.

Outputs with a limit on consumers, and inputs that take all streams, make the choice of units and wires matter.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
from itertools import pairwise

from ortools.sat.python.cp_model import FEASIBLE, INFEASIBLE, OPTIMAL, IntVar, LinearExpr

from cfgplan.domain import ALL, InputPort, Stream, Target, Transformation
from cfgplan.planners.exact.candidates import Candidates, HostName
from cfgplan.planners.solving.clock import OutOfTimeError
from cfgplan.planners.solving.engine import ExactModel, repeatable_solver, solve


class Sharing:
    """The model of some units: their running, and their wiring. A site is a transformation on a host."""

    def __init__(
        self, candidates: Candidates, units: Iterable[tuple[tuple[str, HostName], int]], targets: tuple[Target, ...]
    ) -> None:
        self._clock = candidates.clock
        self._holds = candidates.problem.similarity.holds
        self._cp = ExactModel()
        self._kinds: list[Transformation] = []
        self._hosts: list[HostName] = []
        self._runs: list[IntVar] = []
        for (label, host), number in sorted(units, key=lambda entry: (entry[0][0], entry[0][1] or "")):
            alike = [self._cp.new_bool_var("") for _ in range(number)]
            self._runs += alike
            self._kinds += [candidates.environment.transformation[label]] * number
            self._hosts += [host] * number
            for one, following in pairwise(alike):
                self._cp.add_implication(following, one)
        self._place = [self._cp.new_int_var(0, len(self._runs), "") for _ in self._runs]
        self._taking: dict[Stream, list[IntVar]] = defaultdict(list)
        for unit, kind in enumerate(self._kinds):
            self._is_fed(unit, kind)
            self._has_company(unit, kind)
        for target in targets:
            self._is_met(target)
        self._serves_only_so_many()

    def exists(self) -> bool:
        """Whether the units can be wired to meet all targets. Raises OutOfTimeError by the candidates' clock."""
        solver = repeatable_solver(small=True, time_limit_s=self._clock.left_s())
        status = solve(solver, self._cp, self._clock)
        if status not in (OPTIMAL, FEASIBLE, INFEASIBLE):
            raise OutOfTimeError
        return status != INFEASIBLE

    def _streams(self, tag: str) -> list[tuple[int, Stream]]:
        return [
            (unit, Stream(str(unit), port.name))
            for unit, kind in enumerate(self._kinds)
            for port in kind.outputs
            if self._holds(port.tag, tag)
        ]

    def _is_fed(self, unit: int, kind: Transformation) -> None:
        sharing: dict[tuple[str, str], list[IntVar]] = defaultdict(list)
        for port in kind.inputs:
            if port.optional and port.count != ALL:
                continue
            connects = self._connected(unit, port)
            for giver, connected in connects:
                if port.distinct is not None:
                    sharing[port.distinct, self._kinds[giver].label].append(connected)
            if port.count == ALL:
                for giver, connected in connects:
                    self._cp.add_bool_or([connected, self._runs[unit].negated(), self._runs[giver].negated()])
                if not port.optional:
                    self._cp.add_bool_or([self._runs[unit].negated(), *(connected for _, connected in connects)])
                continue
            taken = LinearExpr.sum([connected for _, connected in connects])
            self._cp.add(taken == port.count).only_enforce_if(self._runs[unit])
            for giver in {giver for giver, _ in connects} if port.count > 1 else ():
                self._cp.add_at_most_one(connected for other, connected in connects if other == giver)
        for connections in sharing.values():
            self._cp.add_at_most_one(connections)

    def _connected(self, unit: int, port: InputPort) -> list[tuple[int, IntVar]]:
        """Add a boolean for each stream that may feed an input. Returns them with the streams' units."""
        found = []
        for giver, stream in self._streams(port.tag):
            if giver == unit and (port.count == ALL or not port.feedback):
                continue
            connected = self._cp.new_bool_var("")
            self._cp.add_implication(connected, self._runs[giver])
            self._cp.add_implication(connected, self._runs[unit])
            if not port.feedback:
                self._cp.add(self._place[giver] < self._place[unit]).only_enforce_if(connected)
            self._taking[stream].append(connected)
            found.append((giver, connected))
        return found

    def _has_company(self, unit: int, kind: Transformation) -> None:
        for label in kind.beside:
            here = [other for other, host in enumerate(self._hosts) if host == self._hosts[unit]]
            there = [self._runs[other] for other in here if self._kinds[other].label == label]
            self._cp.add_bool_or([self._runs[unit].negated(), *there])

    def _is_met(self, target: Target) -> None:
        if target.run is not None:
            self._cp.add_bool_or(
                [r for r, kind in zip(self._runs, self._kinds, strict=True) if kind.label == target.run]
            )
            return
        publishes = []
        for unit, stream in self._streams(target.tag):
            publishes.append(self._cp.new_bool_var(""))
            self._cp.add_implication(publishes[-1], self._runs[unit])
            self._taking[stream].append(publishes[-1])
        self._cp.add_exactly_one(publishes)

    def _serves_only_so_many(self) -> None:
        for stream, taking in self._taking.items():
            most = self._kinds[int(stream.unit)].output[stream.port].serves
            if most is not None:
                self._cp.add(LinearExpr.sum(taking) <= most)
