"""The mutants: each breaks one rule, and names the tests of its room that must fail."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Mutant:
    """A rule broken by writing `new` for `old`, which must occur in `file` exactly once."""

    broken: str
    file: str
    old: str
    new: str
    tests: tuple[str, ...]


def _room(folder: str, tests: tuple[str, ...], *mutants: tuple[str, str, str, str]) -> tuple[Mutant, ...]:
    return tuple(Mutant(broken, f"{folder}/{file}", old, new, tests) for broken, file, old, new in mutants)


MODEL = _room(
    "cfgplan/planners/exact",
    ("tests/planners/test_fleet_rules.py", "tests/planners/test_rules.py", "tests/planners/test_hosts.py"),
    (
        "a unit is in two places, or runs and waits",
        "units.py",
        "model.cp.add_exactly_one(*literals, found.negated())",
        "model.cp.add_bool_or(*literals, found.negated())",
    ),
    (
        "a unit that waits is not there",
        "units.py",
        "for state in (model.runs, model.waits) if i in state]",
        "for state in (model.runs,)]",
    ),
    (
        "a kept unit may neither stay nor be wired",
        "units.py",
        "model.cp.add_exactly_one(stays, wired, runs.negated())",
        "model.cp.add_at_most_one(stays, wired, runs.negated())",
    ),
    (
        "a staying unit needs no feeders",
        "inputs.py",
        "[model.present(stream, host) for port, stream in kept if not port.feedback])",
        "[])",
    ),
    (
        "a staying unit needs no feedback feeders",
        "inputs.py",
        "model.cp.add_implication(stays, model.present(stream, host))",
        "pass",
    ),
    (
        "cycle of staying units is grounded",
        "inputs.py",
        "model.rests_on_all(stays, [model.present(stream, host) for port, stream in kept if not port.feedback])",
        "[model.cp.add_implication(stays, model.present(s, host)) for port, s in kept if not port.feedback]",
    ),
    ("a staying unit gets its streams from anywhere", "inputs.py", "(host,) = candidate.hosts", "host = None"),
    ("a wired unit is not fed", "inputs.py", "model.rests_on_all(wired, parts)", "model.rests_on_all(wired, [])"),
    (
        "a feedback input is fed by nobody",
        "inputs.py",
        "model.needs_any(wired, [way for s in model.choices(port.tag) for way in model.ways(s, host)])",
        "pass",
    ),
    (
        "an input has several feeders",
        "inputs.py",
        "model.cp.add_exactly_one(*connects.values(), model.runs[unit].negated())",
        "model.cp.add_bool_or(*connects.values(), model.runs[unit].negated())",
    ),
    (
        "a staying unit changes who feeds it",
        "inputs.py",
        "model.cp.add_implication(model.stays[unit], same[0])",
        "pass",
    ),
    (
        "a feedback input is fed by a unit that does not run",
        "inputs.py",
        "model.cp.add_implication(connected, feeder)",
        "pass",
    ),
    (
        "an input is fed by a unit that does not run",
        "inputs.py",
        "model.rests_on_all(connected, [feeder])",
        "model.rests_on_all(connected, [])",
    ),
    (
        "nothing is carried to inputs told apart",
        "inputs.py",
        "for host, on in model.runs_on[unit].items() if stream in model.placed else ():",
        "for host, on in ():",
    ),
    (
        "units feed each other where they are told apart",
        "inputs.py",
        "model.rests_on_any(fed, list(connects.values()))",
        "(model.needs_any(fed, list(connects.values())), model.support.rests_on_all(fed.index, []))",
    ),
    (
        "distinct inputs share a feeder",
        "inputs.py",
        "model.cp.add_at_most_one(connections)",
        "pass",
    ),
    (
        "two units of one transformation feed one group",
        "inputs.py",
        "((port.distinct, model.candidates.label_of(stream)), connected)",
        "((port.distinct, stream.unit), connected)",
    ),
    (
        "a target is published on no host",
        "targets.py",
        "others += model.ways(stream, target.host)",
        "others += model.ways(stream, None)",
    ),
    (
        "a stream told apart is published on no host",
        "targets.py",
        "model.rests_on_all(publishes, [model.present(stream, target.host)])",
        "model.rests_on_all(publishes, [model.present(stream, None)])",
    ),
    (
        "a unit publishes that does not run",
        "targets.py",
        "model.rests_on_all(publishes, [model.present(stream, target.host)])",
        "model.rests_on_all(publishes, [])",
    ),
    (
        "a staying unit changes its topics",
        "targets.py",
        "model.cp.add_implication(model.stays[feeder], publishes if keeps else publishes.negated())",
        "pass",
    ),
    (
        "a staying unit begins to publish",
        "targets.py",
        "publishes if keeps else publishes.negated())",
        "publishes if keeps else model.stays[feeder])",
    ),
    ("a target has two streams", "targets.py", "add_exactly_one(publishers)", "add_bool_or(publishers)"),
    (
        "a hub is fed by nobody",
        "inputs.py",
        "model.rests_on_any(hub, list(ways.values()))",
        "model.support.rests_on_all(hub.index, [])",
    ),
    (
        "units feed each other through hubs",
        "inputs.py",
        "model.rests_on_any(hub, list(ways.values()))",
        "(model.needs_any(hub, list(ways.values())), model.support.rests_on_all(hub.index, []))",
    ),
    (
        "what is met on a host is met on all",
        "model.py",
        "return demand, host if self.is_carried(demand) else None",
        "return demand, None",
    ),
    (
        "an input takes two streams of one unit",
        "inputs.py",
        "for literals in of_units.values() if port.count > 1 else ():",
        "for literals in ():",
    ),
    (
        "several streams need not be grounded",
        "inputs.py",
        "return [_grounded_if_it_holds(model, connected) for connected in connects.values()]",
        "return []",
    ),
    (
        "an input that takes all takes some",
        "inputs.py",
        "model.cp.add_bool_or([connected, runs.negated(), model.runs[feeder].negated()])",
        "pass",
    ),
    ("a stream serves any number", "idle_inputs.py", "if len(taking) > most or model.is_grouped:", "if False:"),
    (
        "an input that starts nothing is fed by what serves enough",
        "idle_inputs.py",
        "barred.append(full := model.boolean())",
        "full = model.boolean()",
    ),
    (
        "an optional input is unfed for nothing",
        "inputs.py",
        "model.more_costs.append(port.worth_us * model.problem.horizon_s * (runs - fed))",
        "pass",
    ),
    (
        "an input that starts nothing starts something",
        "idle_inputs.py",
        "model.cp.add_implication(connected, needed[model.unit_of(stream)])",
        "pass",
    ),
    (
        "an input that starts nothing is left unfed",
        "idle_inputs.py",
        "model.cp.add(model.total(list(free.values())) < port.count).only_enforce_if(unfed)",
        "pass",
    ),
    (
        "an input that starts nothing is fed whatever depends on it",
        "idle_inputs.py",
        "barred = [below[feeder]] if feeder in below else []",
        "barred = list[IntVar]()",
    ),
    ("a pinned unit stops", "units.py", "if model.candidates.is_pinned(i):", "if False:"),
    (
        "units serve through each other",
        "targets.py",
        "model.cp.add(distance[feeder] > distance[consumer]).only_enforce_if(through)",
        "pass",
    ),
    (
        "a unit serves through one that serves nothing",
        "targets.py",
        "model.only_if(connected, serving[consumer])",
        "model.only_if(connected)",
    ),
    (
        "a unit serves through a connection that is not there",
        "targets.py",
        "model.only_if(connected, serving[consumer])",
        "model.only_if(serving[consumer])",
    ),
    (
        "a required transformation counts as used for nothing",
        "targets.py",
        "model.needs_any(model.uses_required[label], serving)",
        "pass",
    ),
    (
        "a rewired unit weighs one",
        "model.py",
        "return (self.most_started() + 1) * LinearExpr.sum(self.rewired())",
        "return 1 * LinearExpr.sum(self.rewired())",
    ),
    (
        "what links add is not added",
        "quality.py",
        "sent = badness if delay is None else badness - delay",
        "sent = badness",
    ),
    ("landmarks need one less", "model.py", "at_least(self.cp, least, [", "at_least(self.cp, max(1, least - 1), ["),
    ("units fed apart are alike", "units.py", "unit not in apart", "unit >= 0"),
    ("running units are alike", "units.py", "candidate.running is None and unit", "True and unit"),
    ("required ones are alike", "units.py", "model.problem.features or model.tracked", "model.problem.features"),
    ("fleets' units are alike", "units.py", "model.problem.features or model.tracked", "model.tracked"),
    (
        "new units come in any order",
        "units.py",
        "model.cp.add_implication(model.is_there[i], model.is_there[i - 1])",
        "pass",
    ),
    (
        "a cold spare costs nothing",
        "model.py",
        "terms += [candidates[i].waiting_cost_us * waits",
        "terms += [0 * waits",
    ),
    (
        "a unit takes the same of each host",
        "hosts.py",
        "candidates[i].places[host].takes)",
        "candidates[i].transformation.takes)",
    ),
    ("units that conflict are together", "company.py", "model.cp.add_at_most_one(one, second)", "pass"),
    ("too few units run", "company.py", ">= t.min_instances", ">= 0"),
    ("a wanted unit does not run", "targets.py", "model.rests_on_any(met, [runs for _, runs in running])", "pass"),
    ("every wanted unit is the first", "targets.py", "model.only_if(runs, *earlier)", "model.only_if(runs)"),
    ("too many units are there", "company.py", "<= t.max_instances)", "<= t.max_instances + 1)"),
    (
        "units that conflict on a host are on one",
        "company.py",
        "there = _hosts_with(model, other) if other != transformation.label else {}",
        "there = {}",
    ),
    (
        "a unit runs alone",
        "company.py",
        "model.needs_any(has, company)",
        "pass",
    ),
    ("a link bears anything", "hosts.py", "loads[link].append(model.placed[stream] * journey)", "pass"),
    ("all links cost the same", "hosts.py", "model.more_costs.append((cost_us - least_us) * journey)", "pass"),
    ("hosts are free", "hosts.py", "model.cp.add_implication(has, used)", "pass"),
    ("too many units are on hosts together", "company.py", "model.cp.add(model.total(chosen) <= most)", "pass"),
    ("too many units are on one host", "company.py", "<= t.per_host * model", "<= (t.per_host + 1) * model"),
    (
        "cold spares count as running",
        "company.py",
        "model.total([model.number[i] for i in model.running(t.label)]) >=",
        "model.total([model.is_there[i] for i in model.candidates.units_of(t.label)]) >=",
    ),
    (
        "cold spares weigh nothing",
        "model.py",
        "[*self.numbers_on[unit].items(), *self.waits_on[unit].items()]",
        "[*self.numbers_on[unit].items()]",
    ),
    (
        "a host bears anything",
        "hosts.py",
        "for resource in sorted({resource for _, takes in here for resource in takes} & kind.rooms.keys()):",
        "for resource in ():",
    ),
    (
        "streams are carried for nothing",
        "model.py",
        "min(self.journeys_us(stream, host).values()) * carried",
        "0 * carried",
    ),
    (
        "what does not run is carried",
        "model.py",
        "self.rests_on_all(carried, [self.runs[unit]])",
        "self.rests_on_all(carried, [])",
    ),
    ("a unit may fail alone", "survival.py", "least = 2 if each.host is None else 1", "least = 1"),
    ("the failing host's units count", "survival.py", "if each.host is None or host != each.host", "if True"),
    ("a target of the failing host is to be met", "survivors.py", "if t.host != host.name))", "if t.host))"),
    (
        "a value is as good as it likes",
        "quality.py",
        "cp.add(by * sent >= made).only_enforce_if([taken, *held, *there, *so])",
        "pass",
    ),
    (
        "a unit is on each host as bad as on the worst",
        "quality.py",
        "yield [on[hosts[0]]] if len(hosts) == 1 < len(there) else there, (value, hosts)",
        "yield [], (value, hosts)",
    ),
    (
        "units that stay get what wired ones get",
        "quality.py",
        "{kept: model.stays[unit]} if kept in self._least else {}",
        "{}",
    ),
    (
        "streams that are worse than any use are taken",
        "quality.py",
        "cp.add_bool_or([taken.negated()])",
        "pass",
    ),
    ("the dear run anywhere", "fleet.py", "if largest_us is None:", "if True:"),
)

JUDGE = _room(
    "cfgplan/validity",
    ("tests/test_validity.py", "tests/test_fleet_validity.py", "tests/test_rewiring_validity.py"),
    ("a bound may exceed the cost", "plans.py", "if plan.bound_us > cost:", "if False:"),
    (
        "an optimal plan needs no bound",
        "plans.py",
        "plan.status is Status.OPTIMAL and plan.bound_us != cost",
        "plan.status is Status.OPTIMAL and plan.bound_us > cost",
    ),
    (
        "a feasible plan may have proven its cost",
        "plans.py",
        "plan.status is Status.FEASIBLE and is_proven and not plan.undecided",
        "False",
    ),
    ("the cost is not looked at", "plans.py", "if plan.cost_us != cost:", "if False:"),
    ("a plan may cost more than allowed", "plans.py", "cost > problem.max_cost_us:\n", "cost < 0:\n"),
    ("a pinned unit may stop", "plans.py", "if transformation.label in possible:", "if False:"),
    ("unused required ones need not be named", "plans.py", "if unused != plan.unused_required:", "if False:"),
    ("a gap is no fault", "environments.py", "if port.name not in unit.feeds and not port.optional:", "if False:"),
    (
        "any stream feeds any input",
        "environments.py",
        "elif not similarity.holds(offered, transformation.input[name].tag):",
        "elif False:",
    ),
    ("a target may have two streams", "environments.py", "if len(streams) != 1:", "if not streams:"),
    ("feedback inputs close no cycle", "environments.py", "and not transformation.input[s.port].feedback", ""),
    (
        "distinct inputs may share a feeder",
        "environments.py",
        "            if len(ports) > 1:",
        "            if len(ports) > 9:",
    ),
    ("a needless unit may run", "environments.py", "if unit.id not in needed:", "if False:"),
    ("a host bears anything", "hosts.py", "taken > room:", "taken < 0:"),
    (
        "a unit is on any host",
        "hosts.py",
        "elif unit.host not in environment.hosts_for(transformation):",
        "elif False:",
    ),
    (
        "too many units are there",
        "environments.py",
        "there[label] > transformation.max_instances:",
        "there[label] < 0:",
    ),
    ("too many units are on hosts together", "hosts.py", "if number > most:", "if False:"),
    ("units that conflict are on one host", "hosts.py", "if other in there and other != label:", "if False:"),
    ("a unit runs alone", "hosts.py", "if (other, unit.host) not in running:", "if False:"),
    ("company is needless", "facts.py", "if len(ids) == 1]", "if len(ids) == 9]"),
    (
        "the failure of its company is not a unit's",
        "survival.py",
        " and all((other, unit.host) in there for other in kind.beside)",
        "",
    ),
    ("a link bears anything", "hosts.py", "carried > link.bandwidth:", "carried < 0:"),
    ("energy never ends", "hosts.py", "energy > host.energy:", "False:"),
    ("too many units are on one host", "hosts.py", "is not None and number > most:", "is not None and number < 0:"),
    ("what is left serves any number", "rewiring.py", "wiring.taken[stream] > most:", "False:"),
    ("what is left feeds an input twice", "rewiring.py", "self._place[s.unit] > need.last", "True"),
    ("what is left of a distinct group shares a feeder", "rewiring.py", "if entry in wiring.groups:", "if False:"),
    ("company on another host starts a spare", "rewiring.py", "if not need.is_local or ", "if True or "),
    (
        "an input may take its own unit's stream at `all`",
        "counts.py",
        "if any(stream.unit == unit.id for",
        "if any(False for",
    ),
    ("an input takes several streams of one unit", "counts.py", "if port.count > 1 and len(", "if False and len("),
    ("an optional input closes a cycle", "counts.py", "stream.unit not in barred", "True"),
    (
        "what takes all closes cycles after a failure",
        "rewiring.py",
        "if wiring.leads_to(reader, stream.unit):",
        "if False:",
    ),
    (
        "fewer streams than before are enough after a failure",
        "startable.py",
        "for label in feeding) < port.count:",
        "for label in feeding) < 0:",
    ),
    ("a wanted unit does not run", "environments.py", "target.run not in running:", "False:"),
    ("a wanted unit is needless", "facts.py", "and not u.standby)[:1])", "and not u.standby)[:0])"),
    ("too few units run", "environments.py", "if len(running[label]) < transformation.min_instances:", "if False:"),
)

SURVIVAL = _room(
    "cfgplan/planners/exact",
    ("tests/planners/test_planners.py",),
    (
        "what is left serves any number",
        "sharing.py",
        "    idle_inputs.a_stream_serves_no_more_than_it_may,\n",
        "",
    ),
    (
        "one unit is as good as several after a failure",
        "survivors.py",
        "return number if are_counted(candidates) else",
        "return number if False else",
    ),
    (
        "a needless unit is a spare",
        "survival.py",
        "if survive_without(self.candidates, units, unit)]",
        "if False]",
    ),
)

BOUNDS = _room(
    "cfgplan/planners/bounding",
    ("tests/planners/test_preprocessing.py::test_bounds_do_not_exceed_the_optimum_and_fixing_keeps_optimal_plans",),
    (
        "a landmark is charged what its most expensive member costs",
        "bounds.py",
        "weight = min(int(self.residual[members].min()), at_most)",
        "weight = min(int(self.residual[members].max()), at_most)",
    ),
    (
        "a landmark's members are not charged",
        "bounds.py",
        "self.residual[members] -= weight\n            self.value += weight\n",
        "self.value += weight\n",
    ),
    (
        "too much is left out",
        "bounds.py",
        "self.value + before[:-1] + self.residual <= limit)",
        "self.value + before[:-1] + self.residual < limit)",
    ),
)

CLOSING = _room(
    "cfgplan/planners",
    ("tests/planners/test_support.py", "tests/planners/test_label_kinds.py", "tests/planners/test_closing.py"),
    (
        "distinct inputs are fed by those alike",
        "closing/program.py",
        "if distinct.isdisjoint(facts.tolist()):",
        "if True:",
    ),
    ("free labels are alike", "closing/program.py", "np.flatnonzero(cost).tolist()", "range(len(cost))"),
    (
        "the best plan is the last",
        "closing/gap.py",
        "if self._cost_of(plan) < self._cost_of(self.best):",
        "if plan:",
    ),
    (
        "a loop holds itself up",
        "solving/support.py",
        "order = sorted(p for p, number in missing.items() if not number)",
        "order = sorted(missing)",
    ),
    (
        "all ways are ways into a loop",
        "solving/support.py",
        "for choice in self.any_of[p] if choice not in dead})",
        "for choice in self.any_of[p]})",
    ),
    (
        "a label's charges are not paid back",
        "closing/program.py",
        "np.add.at(left, self._labels, paid[self._pair])",
        "pass",
    ),
)

SATURATION = _room(
    "cfgplan/matching",
    ("tests/matching/test_engine.py",),
    ("an impossible filler leaves a thing possible", "saturation.py", "if BOTTOM_ATOM in target.atoms:", "if False:"),
    ("conjunctions imply nothing", "saturation.py", "partners = rules.joint.get(atom)", "partners = None"),
    ("roles have no supers", "saturation.py", "for upper in self.rules.supers[role]:", "for upper in (role,):"),
    (
        "chains lead nowhere",
        "saturation.py",
        "for second, composed in rules.chains.get(role, ()):",
        "for second, composed in ():",
    ),
    (
        "ranges say nothing",
        "saturation.py",
        "return self._context((fillers | self.rules.ranges[role]) or frozenset((TOP_ATOM,)))",
        "return self._context(fillers or frozenset((TOP_ATOM,)))",
    ),
    ("subclasses imply nothing", "saturation.py", "for implied in rules.sub.get(atom, ()):", "for implied in ():"),
    ("a later rule is not applied to what is known", "saturation.py", "if self.rules.new_premises:", "if False:"),
    ("what is an individual has nothing of it", "saturation.py", "for one in own:", "for one in ():"),
    ("what is more than an individual is certain", "saturation.py", "found.conditional = True", "pass"),
)

SUPERVISION = _room(
    "runtime/cfgplan_runtime/supervision",
    ("tests/runtime/test_supervisor.py", "tests/runtime/test_updates.py"),
    ("an undone update leaves topics open", "updates.py", "        yield from self.close_topics(self.opened)\n", ""),
    (
        "an undone update leaves new units",
        "updates.py",
        "ending = {*self.started, *failed} - kept",
        "ending = {*failed} - kept",
    ),
    (
        "an undone update leaves its wires",
        "updates.py",
        "        for inlet, old in back.items():",
        "        for inlet, old in ():",
    ),
    (
        "topics that nobody wants stay open",
        "updates.py",
        "    yield from update.close_topics(actual.topics.keys() - wiring.wanted_topics(after).keys())\n",
        "",
    ),
    (
        "a unit that does not stop is not killed",
        "updates.py",
        "in sorted(actual.alive & due):",
        "in ():",
    ),
    ("a dead unit fails no update", "updates.py", "        if dead:", "        if False:"),
    (
        "what died during an update is believed to live",
        "updates.py",
        "if unit.standby else unit.id not in self.actual.alive:",
        "if unit.standby else False:",
    ),
    (
        "spares on a host that is lost during an update are believed to be ready",
        "updates.py",
        "if unit.host in self.actual.lost_hosts if unit.standby else",
        "if False if unit.standby else",
    ),
    (
        "what is planned on a lost host is tried",
        "updates.py",
        "        if unit.host in lost_hosts:\n",
        "        if False:\n",
    ),
    (
        "a cold spare is started",
        "updates.py",
        "            if not unit.standby:\n                yield StartUnit",
        "            if True:\n                yield StartUnit",
    ),
    ("a topic stays where it was", "updates.py", "and actual.topics[topic] != host:", "and False:"),
    (
        "spares on a lost host stay",
        "supervisor.py",
        "if unit.host == host]:\n            self.env",
        "if False]:\n            self.env",
    ),
    (
        "a lost host's topic keeps its source",
        "supervisor.py",
        "            self.environment = without_feed(self.environment, outlet)\n",
        "",
    ),
    (
        "a topic has no address after its host is back",
        "supervisor.py",
        "                    self.backend.open_outlet(topic, host)\n",
        "                    pass\n",
    ),
    (
        "one fed input is enough",
        "wiring.py",
        "else not all(port.takes(",
        "else not any(port.takes(",
    ),
    (
        "every input has to be fed",
        "wiring.py",
        'return not fed if transformation.run.start == "any"',
        'return len(fed) < len(needed) if transformation.run.start == "any"',
    ),
    (
        "the starting input does not count",
        "wiring.py",
        "        return fed.keys().isdisjoint(starting)\n",
        "        return not fed\n",
    ),
    ("a switch is not noted", "wiring.py", "            wire.has_switched = True\n", "            pass\n"),
)

SPARES = _room(
    "runtime/cfgplan_runtime",
    ("tests/runtime/test_spares.py", "tests/lifecycle/test_lost_hosts.py"),
    (
        "a unit of other code begins where a spare is prepared",
        "supervision/spares.py",
        "(one.order, one.host) == (order, host)",
        "one.host == host",
    ),
    (
        "a spare that is lost again and again is always prepared at once",
        "supervision/spares.py",
        "now_s + doubling_s(spare.losses, _PUT_OFF_S, _MOST_PUT_OFF_S)",
        "now_s",
    ),
    ("a spare may grow", "supervision/spares.py", "usage.memory_bytes > most_mb * MEGABYTE", "False"),
    (
        "a spare that an undone update has used is gone",
        "supervision/supervisor.py",
        "            self.spares.keep(self.environment, self.now())\n            self._report(events.RolledBack",
        "            self._report(events.RolledBack",
    ),
    (
        "a unit begins in a spare of old code",
        "processes/process_backend.py",
        "prepared is None or prepared.changed_file() is not None:",
        "prepared is None:",
    ),
    (
        "a unit starts where its spare is, however dear",
        "lifecycle/deliberation.py",
        "if other is plan or not validity.plan_violations(problem, other):",
        "if True:",
    ),
)

LIFECYCLE = _room(
    "runtime/cfgplan_runtime/lifecycle",
    ("tests/lifecycle/test_decisions.py",),
    (
        "a plan that can't know what has happened is carried out",
        "decisions.py",
        "(state.entries or planned.was_interrupted)",
        "False",
    ),
    (
        "what comes while it plans for the last time is forgotten",
        "decisions.py",
        "        entries=entries,\n",
        "        entries=planning.entries or entries,\n",
    ),
    (
        "who asked is not told by the review",
        "decisions.py",
        "for outcome in entry.outcomes]\n    return",
        "for outcome in ()]\n    return",
    ),
    (
        "at the end nobody is told whose unit was to end",
        "decisions.py",
        "for outcomes in state.waiting.values()",
        "for outcomes in ()",
    ),
    (
        "at the end what is under way is forgotten",
        "decisions.py",
        "entries = (*begun, *state.entries)",
        "entries = state.entries",
    ),
    ("the units of a lost host stay known", "intake.py", "replace(situation.without(*gone), p", "replace(situation, p"),
    (
        "who waits for the end of a unit on a lost host is not told",
        "intake.py",
        "HostGone(host, cause), outcomes) if is_ours",
        "HostGone(host, cause)) if is_ours",
    ),
    (
        "the first review waits for no host",
        "decisions.py",
        "(transition.state.policy.hosts_s or 0.0) if is_short",
        "0.0 if True",
    ),
    ("who asked for the end is not told", "decisions.py", "for outcome in state.stops))", "for outcome in ()))"),
    (
        "a review begins while another is under way",
        "decisions.py",
        "state.doing is None and state.due_s <= at_s",
        "state.due_s <= at_s",
    ),
    ("a failure is repeated at once", "decisions.py", "delay_s = 0.0 if is_other else", "delay_s = 0.0 if True else"),
    ("a failure owes no optimising", "decisions.py", "owes_optimising=planning.optimises", "owes_optimising=False"),
    ("a new unit that dies is always missed", "intake.py", "and unit in state.doing.starting", "and False"),
    (
        "a new unit's death is forgotten",
        "decisions.py",
        "        transition = intake.died(transition, gone, lived_s)\n",
        "        pass\n",
    ),
    (
        "an update that is given up blames its slow units",
        "decisions.py",
        "case errors.AbandonedError(units=slow):",
        "case OSError(errno=slow):",
    ),
    (
        "units of a failed update are believed to run",
        "decisions.py",
        "transition.state.situation.without(*gone)), failed",
        "transition.state.situation), failed",
    ),
    ("a killed unit is blamed", "intake.py", "is_blameless = is_killed or", "is_blameless ="),
    (
        "what a unit has done counts for the next of its id",
        "intake.py",
        "        case events.UnitReady(unit):\n            return _unnoted(transition, unit)",
        "        case events.UnitReady(unit):\n            return transition",
    ),
    (
        "one good step does not count",
        "intake.py",
        "if errors == 0 or status.steps - steps > errors + 1:",
        "if errors == 0:",
    ),
    (
        "a lost input waits for nothing",
        "intake.py",
        "delay_s = max(policy.explain_s,",
        "delay_s = 0 * max(policy.explain_s,",
    ),
    (
        "a silent target is asked about at each look",
        "intake.py",
        "        giving = giving.after_asking(silence.target, at_s)\n",
        "",
    ),
    (
        "what dies in an update that starts it gives it up",
        "decisions.py",
        "if is_new or urgency is",
        "if urgency is",
    ),
    (
        "a plan outlives the end",
        "decisions.py",
        "    if state.is_closing or state.stops:\n        return _ended(transition)\n    if not _is_last",
        "    if not _is_last",
    ),
)

COUNTING = _room(
    "cfgplan/planners/exact",
    ("tests/planners/test_counting.py",),
    (
        "hosts that are counted bear any number",
        "hosts.py",
        "<= kind.rooms[resource] * model.hosts_in_use(kind.first)",
        "<= kind.rooms[resource] * len(kind.names) * 99",
    ),
    ("hosts of a kind are not paid", "hosts.py", "model.cp.add(has <= used)", "pass"),
    (
        "units that run with others are counted without them",
        "company.py",
        "model.cp.add(has <= model.total(company))",
        "pass",
    ),
    (
        "units that conflict on a host are counted together",
        "company.py",
        "model.cp.add(one + second <= model.hosts_in_use(host))",
        "pass",
    ),
    (
        "an input takes fewer streams than it counts",
        "inputs.py",
        "for feeder in of_feeders]) >= port.count",
        "for feeder in of_feeders]) >= 1",
    ),
    (
        "a stream that is counted serves any number",
        "idle_inputs.py",
        "streams = model.number[model.unit_of(stream)] if model.is_grouped else 1",
        "streams = 99 if model.is_grouped else 1",
    ),
    (
        "a group that runs is not said to",
        "units.py",
        "model.cp.add(model.number[i] <= candidate.size * runs)",
        "pass",
    ),
    (
        "a counted unit stays though it takes other streams",
        "inputs.py",
        "model.cp.add(model.stays[unit] <= takes[stream])",
        "pass",
    ),
    ("units that are told apart are counted together", "groups.py", "i if label in apart else label", "label"),
    (
        "whom a unit takes several of is counted together",
        "groups.py",
        "                if port.count != 1:\n",
        "                if False:\n",
    ),
    (
        "units of a cycle are counted together",
        "groups.py",
        "Tracking.of(candidates).units | cycles",
        "Tracking.of(candidates).units",
    ),
    ("a cycle beside counted units holds itself up", "model.py", "is_optional or bool(self.in_cycles)", "is_optional"),
    (
        "hosts of any room are alike",
        "groups.py",
        "kinds[own, host.rent_us, tuple(host.rooms.items()), there, traits]",
        "kinds[own, host.rent_us, there, traits]",
    ),
)
MUTANTS = (*MODEL, *SURVIVAL, *COUNTING, *JUDGE, *BOUNDS, *CLOSING, *SATURATION, *SUPERVISION, *SPARES, *LIFECYCLE)
