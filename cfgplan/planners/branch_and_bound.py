"""The paper's planner: Algorithms 1 and 2, then the merging of section IV-D.

A breadth-first tree of possible feeders, pruned by cost along each chain; then duplicate subtrees
are merged from the root down. It is faithful, so that it can be compared, and keeps its weaknesses:

* Costs are summed over the tree, so sharing counts only after the choice: with two targets, A giving
  the first at 3 and C giving both at 4, it answers {A, C} at 7. The ratio is unbounded.
* `getBestCostChain` is not specified; here it is the cheapest known completion of any slot on the way
  to the root, from MAX_COST on. MAX_COST bounds single chains, so a whole plan may exceed it: then
  the answer is unknown.
* The paper's algorithm does not end on units that feed each other. Here a transformation may not
  stand below itself, except below a feedback input, where it points at the one above.
* Distinct groups and required transformations are unknown to it. A plan that breaks a rule is not
  given out: the status is unknown and the reasons hold the judge's words. So it is where a plan within
  a largest cost leaves required transformations unused, which come before that cost.
* It proves no bound but 0. Pinned units that can be fed are further children of the root.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field

from cfgplan.costs import keep_cost_us, start_cost_us
from cfgplan.domain import ComputationUnit, Publication, Stream, Subscription, Transformation
from cfgplan.planners.networks.keys import key_of, unused_required
from cfgplan.planning import OnProgress, Plan, Problem, Progress, Status, fresh_unit_ids, refuse_features
from cfgplan.reasons import Providers, startable, unmet_reasons
from cfgplan.validity import plan_violations


@dataclass(eq=False)
class TreeNode:
    """A unit, or a transformation to instantiate, or (with neither) the root.

    `slots` are the streams to be fed: (name, demanded tag, feedback). `cost_us` is its own, `forward_us` the sum from
    the root to it; `best` has the cost of the cheapest complete option of each slot so far, and that option.
    """

    parent: TreeNode | None = None
    slot: int = 0
    transformation: Transformation | None = None
    unit: ComputationUnit | None = None
    slots: list[tuple[str, str, bool]] = field(default_factory=list)
    cost_us: int = 0
    forward_us: int = 0
    above: TreeNode | None = None
    best: dict[int, tuple[int, TreeNode]] = field(default_factory=dict)

    @property
    def name(self) -> tuple[str, bool]:
        """The key shared by duplicates: the id of a running unit, else the label to instantiate."""
        assert self.transformation is not None, "the root has no duplicate"
        return (self.transformation.label, False) if self.unit is None else (self.unit.id, True)

    @property
    def options(self) -> list[TreeNode]:
        """The best option of each slot."""
        return [self.best[i][1] for i in range(len(self.slots))]


def plan(problem: Problem, *, time_limit_s: float | None = None, report: OnProgress | None = None) -> Plan:
    """The paper's approximation of the optimal update; see `planning.Planner` and the module's text."""
    began = time.monotonic()
    refuse_features(problem, "branch-and-bound")
    reasons = unmet_reasons(problem)
    if reasons:
        return Plan("branch-and-bound", Status.INFEASIBLE, reasons=reasons)
    tree = SearchTree(problem, None if time_limit_s is None else began + time_limit_s)
    root = tree.explore()
    seconds = {"explore": time.monotonic() - began}
    if len(root.best) < len(root.slots):
        return _unknown("no complete tree was found within the time limit and the largest cost", tree, seconds)
    units = compiled(problem, root)
    cost_us = key_of(problem, units).cost_us
    unused = unused_required(problem, units)
    if unused and problem.max_cost_us is not None:
        text = f"it does not support `required`, which comes before the largest cost; unused: {', '.join(unused)}"
        return _unknown(text, tree, seconds)
    answer = Plan(
        "branch-and-bound",
        Status.of_plan(cost_us, 0, is_required_proven=not unused),
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
        """The root with the best options that were completed: pinned units that can be fed, then targets."""
        environment, root = self.problem.environment, TreeNode()
        queue: deque[TreeNode] = deque()
        possible = startable(environment, Providers(environment.library, self.problem.similarity))
        for unit in environment.units:
            transformation = self.library.get(unit.transformation)
            if transformation is not None and transformation.pinned and unit.transformation in possible:
                root.slots.append(("", "", False))
                self.add_option(root, len(root.slots) - 1, transformation, unit, queue)
        pinned = len(root.slots)
        root.slots += [(target.topic, target.tag, False) for target in environment.targets]
        self.expand(root, queue, pinned)
        while queue and (self.deadline is None or time.monotonic() < self.deadline):
            self.expand(queue.popleft(), queue)
        return root

    def expand(self, node: TreeNode, queue: deque[TreeNode], first: int = 0) -> None:
        """Queue the options of a node's slots from the `first` on."""
        for i, (_, tag, feedback) in enumerate(node.slots[first:], first):
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
            if slot in at.best:
                best = min(best, at.forward_us + at.best[slot][0])
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
    """Update the parents of a completed subtree, as long as it is cheaper than their best option for its slot."""
    parent = node.parent
    while parent is not None and (node.slot not in parent.best or total_us < parent.best[node.slot][0]):
        parent.best[node.slot] = total_us, node
        if len(parent.best) < len(parent.slots):
            return
        node, total_us = parent, parent.cost_us + sum(us for us, _ in parent.best.values())
        parent = node.parent


def compiled(problem: Problem, root: TreeNode) -> list[ComputationUnit]:
    """The units, with their subscriptions and topics, after duplicate subtrees were merged from the root down."""
    merged: dict[tuple[str, bool], TreeNode] = {}
    ahead = [root]
    for node in ahead:
        for option in node.options:
            if option.above is None and option.name not in merged:
                merged[option.name] = option
                ahead.append(option)
    fresh = fresh_unit_ids(problem.environment, sorted(name for name, is_running in merged if not is_running))
    ids = {(name, is_running): name if is_running else fresh[name] for name, is_running in merged}
    topics: dict[tuple[str, bool], list[Publication]] = {name: [] for name in merged}
    for (topic, tag, _), publisher in zip(root.slots, root.options, strict=True):
        if topic:
            old = [p.port for p in (publisher.unit.publications if publisher.unit else ()) if p.topic == topic]
            topics[publisher.name].append(Publication(_port(problem, publisher, tag, old), topic))

    def subscriptions(node: TreeNode) -> Iterator[Subscription]:
        for (port, tag, _), feeder in zip(node.slots, node.options, strict=True):
            old = node.unit.feeds.get(port, ()) if node.unit else ()
            prefer = [stream.port for stream in old if stream.unit == ids[feeder.name]]
            yield Subscription(port, Stream(ids[feeder.name], _port(problem, feeder, tag, prefer)))

    return [
        ComputationUnit(ids[name], node.transformation.label, tuple(subscriptions(node)), tuple(topics[name]))
        for name, node in merged.items()
        if node.transformation is not None
    ]


def _port(problem: Problem, feeder: TreeNode, tag: str, prefer: list[str]) -> str:
    """The output of the feeder for a demand: one of those to prefer if it matches, else the first."""
    assert feeder.transformation is not None
    fit = [p.name for p in feeder.transformation.outputs if problem.similarity.holds(p.tag, tag)]
    return next((name for name in prefer if name in fit), fit[0])


def _unknown(why: str, tree: SearchTree, seconds: dict[str, float]) -> Plan:
    reasons = {target.label: why for target in tree.problem.environment.targets}
    return Plan("branch-and-bound", Status.UNKNOWN, reasons=reasons, seconds=seconds, counts={"nodes": tree.nodes})
