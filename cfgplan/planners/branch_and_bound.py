"""The paper's planner: Algorithms 1 and 2, then the merging of section IV-D.

A breadth-first tree of who could feed whom, pruned by cost along each chain; then duplicate subtrees
are merged from the root down. It is faithful, so that it can be compared, and keeps its weaknesses:

* Costs are summed over the tree, so sharing counts only after the choice: with two targets, A giving
  the first at 3 and C giving both at 4, it answers {A, C} at 7. The ratio is unbounded.
* `getBestCostChain` is not specified; here it is the cheapest known completion of any slot on the way
  to the root, from MAX_COST on. MAX_COST bounds single chains, so a whole plan may exceed it: then
  the answer is unknown.
* The paper's algorithm does not end on units that feed each other. Here a transformation may not
  stand below itself, except below a feedback input, where it points at the one above.
* Distinct groups and required transformations are unknown to it. A plan that breaks a rule is not
  given out: the status is unknown and the reasons hold the judge's words.
* It proves no bound but 0. Pinned units that can be fed are further children of the root.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

from cfgplan.costs import keep_cost_us, start_cost_us
from cfgplan.domain import ComputationUnit, Publication, Stream, Subscription, Transformation
from cfgplan.planning import Plan, Problem, Progress, Status, fresh_unit_ids, refuse_notions
from cfgplan.reasons import Givers, startable, unmet_reasons
from cfgplan.validity import plan_violations


@dataclass(eq=False)
class TreeNode:
    """A unit, or a transformation to instantiate, or (with neither) the root or a target.

    `slots` are what has to be fed: (name, demanded tag, feedback). `cost_us` is its own, `forward_us`
    the sum from the root to it; `best` is the cheapest complete option of each slot so far.
    """

    parent: TreeNode | None = None
    slot: int = 0
    transformation: Transformation | None = None
    unit: ComputationUnit | None = None
    slots: list[tuple[str, str, bool]] = field(default_factory=list)
    cost_us: int = 0
    forward_us: int = 0
    above: TreeNode | None = None
    best: dict[int, TreeNode] = field(default_factory=dict)
    best_us: dict[int, int] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """What duplicates share: the id of a running unit, else the label to instantiate."""
        if self.unit is not None:
            return f"unit {self.unit.id}"
        return f"new {self.transformation.label}" if self.transformation is not None else ""


def plan(
    problem: Problem,
    *,
    time_limit_s: float | None = None,
    report: Callable[[Progress], None] | None = None,
) -> Plan:
    """The paper's approximation of the optimal update; see `planning.Planner` and the module's text."""
    began = time.monotonic()
    refuse_notions(problem, "branch-and-bound")
    reasons = unmet_reasons(problem)
    if reasons:
        return Plan("branch-and-bound", Status.INFEASIBLE, reasons=reasons)
    tree = SearchTree(problem, None if time_limit_s is None else began + time_limit_s)
    root = tree.explore()
    seconds = {"explore": time.monotonic() - began}
    if len(root.best) < len(root.slots):
        return _unknown("no complete tree was found within the time limit and the largest cost", tree, seconds)
    units = Compilation(problem, root).units()
    cost_us = sum(tree.cost_us(u.transformation, running=u.id in problem.environment.unit) for u in units)
    unused = _unused_required(problem, units)
    answer = Plan(
        "branch-and-bound",
        Status.of_plan(cost_us, 0),
        problem.environment.change_to(units),
        cost_us,
        unused_required=unused,
        required_proven=not unused,
        seconds=seconds,
        counts={"nodes": tree.nodes},
    )
    broken = plan_violations(problem, answer)
    if broken:
        return _unknown("; ".join(map(str, broken)), tree, seconds)
    if report is not None:
        report(Progress(time.monotonic() - began, cost_us, 0))
    return answer


class SearchTree:
    """The exploration (Algorithm 1) and the expansion of its nodes (Algorithm 2)."""

    def __init__(self, problem: Problem, deadline: float | None) -> None:
        self.problem = problem
        self.library = problem.environment.transformation
        self.deadline = deadline
        self.nodes = 0
        self._rows: dict[str, list[tuple[Transformation, ComputationUnit | None]]] = {}

    def explore(self) -> TreeNode:
        """The root with the best option of every target (and pinned unit that can be fed) that was completed."""
        root = TreeNode()
        queue: deque[TreeNode] = deque()
        for target in self.problem.environment.targets:
            node = TreeNode(root, len(root.slots), slots=[(target.topic, target.tag, False)])
            root.slots.append((target.topic, target.tag, False))
            queue.append(node)
        environment = self.problem.environment
        possible = startable(environment, Givers(environment.library, self.problem.similarity))
        for unit in environment.units:
            transformation = self.library.get(unit.transformation)
            if transformation is not None and transformation.pinned and unit.transformation in possible:
                root.slots.append(("", "", False))
                self.add_option(root, len(root.slots) - 1, transformation, unit, queue)
        while queue and (self.deadline is None or time.monotonic() < self.deadline):
            self.expand(queue.popleft(), queue)
        return root

    def expand(self, node: TreeNode, queue: deque[TreeNode]) -> None:
        for i, (_, tag, feedback) in enumerate(node.slots):
            for transformation, unit in self.candidates(tag):
                twin, below_feedback = _twin_above(node, feedback, transformation)
                if twin is not None and below_feedback:
                    self.add_option(node, i, transformation, twin.unit, queue, above=twin)
                elif twin is None:
                    cost_us = self.cost_us(transformation.label, running=unit is not None)
                    if node.forward_us + cost_us < self.best_cost_chain(node, i):
                        self.add_option(node, i, transformation, unit, queue)

    def candidates(self, tag: str) -> list[tuple[Transformation, ComputationUnit | None]]:
        """The row of the validity matrix: running units to reuse, then transformations to instantiate."""
        if tag not in self._rows:
            holds = self.problem.similarity.holds
            fit = [t for t in self.library.values() if any(holds(port.tag, tag) for port in t.outputs)]
            running = [(t, u) for t in fit for u in self.problem.environment.units if u.transformation == t.label]
            self._rows[tag] = [*running, *((t, None) for t in fit)]
        return self._rows[tag]

    def add_option(
        self,
        node: TreeNode,
        slot: int,
        transformation: Transformation,
        unit: ComputationUnit | None,
        queue: deque[TreeNode],
        above: TreeNode | None = None,
    ) -> None:
        """Queue a new option, or complete it at once if it has no inputs or points at a node `above` it."""
        self.nodes += 1
        option = TreeNode(node, slot, transformation, unit, above=above)
        if above is None:
            option.slots = [(port.name, port.tag, port.feedback) for port in transformation.inputs]
            option.cost_us = self.cost_us(transformation.label, running=unit is not None)
        option.forward_us = node.forward_us + option.cost_us
        if option.slots:
            queue.append(option)
        else:
            _propagate(option, option.cost_us)

    def best_cost_chain(self, node: TreeNode, slot: int) -> int | float:
        """The cost, from the root on, of the cheapest known completion of the slot or of one on the way to the root."""
        at: TreeNode | None = node
        limit = self.problem.max_cost_us
        best = float("inf") if limit is None else limit + 1
        while at is not None:
            if slot in at.best_us:
                best = min(best, at.forward_us + at.best_us[slot])
            slot, at = at.slot, at.parent
        return best

    def cost_us(self, label: str, *, running: bool) -> int:
        """The cost of a unit: upkeep, and labor unless it runs already."""
        cost = keep_cost_us if running else start_cost_us
        return cost(self.library[label], self.problem.horizon_s)


def _twin_above(node: TreeNode, feedback: bool, transformation: Transformation) -> tuple[TreeNode | None, bool]:
    """The node of the same transformation on the way to the root, and whether a feedback input lies between."""
    at: TreeNode | None = node
    while at is not None:
        if at.transformation is transformation:
            return at, feedback
        if at.parent is not None:
            feedback = feedback or (at.parent.transformation is not None and at.parent.slots[at.slot][2])
        at = at.parent
    return None, feedback


def _propagate(node: TreeNode, total_us: int) -> None:
    """Tell the parents of a completed subtree, as long as it improves on what they had."""
    parent = node.parent
    while parent is not None and total_us < parent.best_us.get(node.slot, total_us + 1):
        parent.best[node.slot] = node
        parent.best_us[node.slot] = total_us
        if len(parent.best) < len(parent.slots):
            return
        node, total_us = parent, parent.cost_us + sum(parent.best_us.values())
        parent = node.parent


class Compilation:
    """Merging of duplicate subtrees, then the units with their subscriptions and topics (COMPILER)."""

    def __init__(self, problem: Problem, root: TreeNode) -> None:
        self.problem = problem
        self.root = root
        self.merged: dict[str, TreeNode] = {}
        queue = deque([root])
        while queue:
            for child in _best_options(queue.popleft()):
                if child.name and child.above is None and child.name not in self.merged:
                    self.merged[child.name] = child
                    queue.append(child)
                elif not child.name:
                    queue.append(child)

    def units(self) -> list[ComputationUnit]:
        new = [n.transformation.label for n in self.merged.values() if n.unit is None and n.transformation is not None]
        fresh = fresh_unit_ids(self.problem.environment, sorted(new))
        ids = {name: node.unit.id if node.unit else fresh[name[4:]] for name, node in self.merged.items()}
        topics: dict[str, list[Publication]] = {name: [] for name in self.merged}
        for target in _best_options(self.root):
            if not target.name:
                (topic, tag, _), publisher = target.slots[0], target.best[0]
                old = [p.port for p in (publisher.unit.publications if publisher.unit else ()) if p.topic == topic]
                topics[publisher.name].append(Publication(self.port(publisher, tag, old), topic))
        return [
            ComputationUnit(
                ids[name],
                node.transformation.label,
                tuple(self.subscriptions(node, ids)),
                tuple(topics[name]),
            )
            for name, node in self.merged.items()
            if node.transformation is not None
        ]

    def subscriptions(self, node: TreeNode, ids: dict[str, str]) -> Iterator[Subscription]:
        for i, (port, tag, _) in enumerate(node.slots):
            feeder = node.best[i]
            feeder_id = ids[feeder.name]
            old = node.unit.feeds.get(port, ()) if node.unit else ()
            prefer = [stream.port for stream in old if stream.unit == feeder_id]
            yield Subscription(port, Stream(feeder_id, self.port(feeder, tag, prefer)))

    def port(self, feeder: TreeNode, tag: str, prefer: list[str]) -> str:
        """The output of the feeder for a demand: one of those to prefer if it matches, else the first."""
        assert feeder.transformation is not None
        fit = [p.name for p in feeder.transformation.outputs if self.problem.similarity.holds(p.tag, tag)]
        return next((name for name in prefer if name in fit), fit[0])


def _best_options(node: TreeNode) -> list[TreeNode]:
    """The best option of each slot; at the root these are the targets and pinned units."""
    return [node.best[i] for i in range(len(node.slots))]


def _unused_required(problem: Problem, units: list[ComputationUnit]) -> tuple[str, ...]:
    by_id = {unit.id: unit for unit in units}
    serving = [unit.id for unit in units if unit.publications]
    for unit_id in serving:
        serving += sorted({s.stream.unit for s in by_id[unit_id].subscriptions} - set(serving))
    used = {by_id[unit_id].transformation for unit_id in serving}
    return tuple(t.label for t in problem.environment.library if t.required and t.label not in used)


def _unknown(why: str, tree: SearchTree, seconds: dict[str, float]) -> Plan:
    reasons = {target.label: why for target in tree.problem.environment.targets}
    return Plan("branch-and-bound", Status.UNKNOWN, reasons=reasons, seconds=seconds, counts={"nodes": tree.nodes})
