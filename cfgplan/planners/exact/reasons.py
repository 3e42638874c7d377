"""Reasons why no configuration meets all targets together, although each target alone could have a stream."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Collection, Mapping

from cfgplan.costs import taken
from cfgplan.domain import POWER, Environment, Host, Target, Transformation, amount_of
from cfgplan.planners.exact.best_case import least_badness
from cfgplan.planners.exact.candidates import Candidates
from cfgplan.planners.exact.rules import host_loads
from cfgplan.planning import Failures, Feature, Problem
from cfgplan.qualities import is_met
from cfgplan.reasons import Providers, startable
from cfgplan.unmet import Lack, Reason


def joint_reasons(problem: Problem) -> dict[str, Reason]:
    """A reason for each target that can't be met by itself; else one for all targets together."""
    candidates = Candidates(problem)
    unreachable = {
        target.label: reason
        for target in problem.environment.targets
        for reason in [
            _missed_bound(candidates, target) or _missing_room(problem, target) or _fatal_failure(problem, target)
        ]
        if reason
    }
    asked = f" ({', '.join(sorted(problem.features))})"
    missing = _missing_together(problem) or _missing_host(problem) or _missing_places(problem) or asked
    joint = Reason(Lack(f"no configuration meets all that is asked together{missing}"))
    return unreachable or {target.label: joint for target in problem.environment.targets}


def _missed_bound(candidates: Candidates, target: Target) -> Reason | None:
    for wish in target.quality:
        attribute = candidates.environment.quality[wish.attribute]
        least = least_badness(candidates, attribute) if wish.bound is not None else {}
        found = [least[stream] for stream in candidates.streams(target.tag) if stream in least]
        if found and wish.bound is not None and not is_met(attribute, wish, reached := attribute.at(min(found))):
            side = "at most" if attribute.sign > 0 else "at least"
            asked = f"{attribute.name} of {side} {attribute.shown(wish.bound)}"
            best = Lack(f"the best that any wiring reaches is {attribute.shown(reached)}")
            return Reason(best, target.label, asked, verb="asks for")
    return None


def _missing_room(problem: Problem, target: Target) -> Reason | None:
    """Name transformations that never run and that are all the ways there are; None if there are other ways.

    Each is too large for its hosts, or short of feeders. Without any one of them the reason would not hold.
    """
    library, providers = problem.environment.library, Providers(problem.environment.library, problem.similarity)
    lacks = ((t.label, _lack(problem, t) or _missing_streams(problem, providers, t)) for t in library)
    too_large = {label: lack for label, lack in lacks if lack}
    if not too_large or _can_be_met(problem, target, too_large):
        return None
    for label in reversed(list(too_large)):
        others = too_large.keys() - {label}
        if not _can_be_met(problem, target, others):
            del too_large[label]
    return _unmet(target, f": {', and '.join(too_large.values())}")


def _unmet(target: Target, why: str) -> Reason:
    """Return the reason of a target; its words fit several targets, too."""
    return Reason(Lack(f"would have no {'stream' if target.run is None else 'unit'}{why}"), target.label)


def _missing_streams(problem: Problem, providers: Providers, t: Transformation) -> str | None:
    """Name an input for which there can't be units enough; or None."""
    library, holds = problem.environment.transformation, problem.similarity.holds
    for port in (port for port in t.needed_inputs if port.count > 1):
        placed = {
            label: _placed(problem, library[label], min(_most_units(problem, label), port.count))
            for label in providers.of(port.tag)
        }
        most = sum(number for number, _ in placed.values())
        if most < port.count:
            matching = [
                f"{label}/{o.name}" for label in placed for o in library[label].outputs if holds(o.tag, port.tag)
            ]
            only = f"only {' and '.join(matching)} can feed it, {most} in all" if matching else "nothing matches"
            why = "".join(f", as {label} number {lack}" for label, (_, lack) in placed.items() if lack)
            return f"input {port.name} of {t.label} needs {port.count} streams of different units; {only}{why}"
    return None


def _missing_together(problem: Problem) -> str | None:
    """Name a resource that indispensable transformations exceed on some hosts; or None."""
    environment = problem.environment
    demands: dict[str, list[tuple[str, int, tuple[Host, ...]]]] = defaultdict(list)
    for t in environment.library if environment.hosts else ():
        is_needed = t.needs and not all(_can_be_met(problem, target, {t.label}) for target in environment.targets)
        hosts = tuple(host for host in environment.places_for(t) if host is not None)
        for resource, amount in t.needs.items():
            demands[resource].append((t.label, amount * max(t.min_instances, bool(is_needed)), hosts))
    for resource, demanded in sorted(demands.items()):
        for hosts in sorted({hosts for _, _, hosts in demanded}, key=len):
            there = {label: amount for label, amount, of_it in demanded if amount and {*of_it} <= {*hosts}}
            rooms = [host.room(resource, problem.horizon_s) for host in hosts]
            needed, most = sum(there.values()), sum(room or 0 for room in rooms)
            if None not in rooms and needed > most:
                names = [host.name for host in hosts] if len(hosts) < len(environment.hosts) else ["all hosts"]
                has = "has" if len(hosts) == 1 < len(environment.hosts) else "have"
                if not hosts:
                    return f": {', '.join(there)} may run on no host"
                return f": {', '.join(there)} need {amount_of(resource, needed)}, but {', '.join(names)} {has} {most}"
    return None


def _missing_places(problem: Problem) -> str | None:
    """Name inputs that take more streams than outputs that serve only so many can give; or None."""
    library, providers = problem.environment.transformation, Providers(problem.environment.library, problem.similarity)
    demands: dict[str, list[tuple[str, int]]] = defaultdict(list)
    for label, number in _least_units(problem, providers).items():
        for port in library[label].needed_inputs:
            wanted = number * max(port.count, 1)
            demands[port.tag].append((f"{number} x {label} take {wanted} streams as {port.name}", wanted))
    for tag, demanded in demands.items():
        outputs = [
            (g, o) for g in providers.of(tag) for o in library[g].outputs if problem.similarity.holds(o.tag, tag)
        ]
        offered = [(_most_units(problem, g), g, o.serves) for g, o in outputs]
        most = sum(number * (serves or 0) for number, _, serves in offered)
        if all(serves for _, _, serves in offered) and sum(wanted for _, wanted in demanded) > most:
            offers = " and ".join(f"{number} x {provider} (serves {serves})" for number, provider, serves in offered)
            consumers = " and ".join(who for who, _ in demanded)
            return f": {consumers}, but {offers} give {most} at most; max_instances may allow more"
    return None


def _most_units(problem: Problem, label: str) -> int:
    """Return how many units of a transformation may run: running ones and new ones, within `max_instances`."""
    kind = problem.environment.transformation[label]
    running = sum(unit.transformation == label and not unit.standby for unit in problem.environment.units)
    most = running + problem.most_new(kind)
    return most if kind.max_instances is None else min(most, kind.max_instances)


def _least_units(problem: Problem, providers: Providers) -> Mapping[str, int]:
    """How many units of transformations have to run, at least, as far as only one can feed a target or an input."""
    library = problem.environment.transformation
    least: dict[str, int] = {}
    ahead = [(target.tag, 1) for target in problem.environment.targets]
    for tag, number in ahead:
        if len(labels := providers.of(tag)) == 1 and number > least.get(labels[0], 0):
            ahead += [(port.tag, max(port.count, 1)) for port in library[labels[0]].needed_inputs]
            least[labels[0]] = number
    return least


def _missing_host(problem: Problem) -> str | None:
    """Name the first transformation whose `min_instances` do not fit on empty hosts; None if all fit."""
    for t in problem.environment.library:
        _, lack = _placed(problem, t, t.min_instances)
        if lack:
            return f": {t.label} asks for {t.min_instances} units, and number {lack}"
    return None


def _placed(problem: Problem, t: Transformation, wanted: int) -> tuple[int, str]:
    """The number of `wanted` units of a transformation that fit on empty hosts, and the resource that the next lacks:
    `3 finds no host with 512 MB of memory left`; empty if all find one.
    """
    most = wanted if t.max_instances is None else min(wanted, t.max_instances)
    loads, hosts = host_loads(problem), problem.environment.hosts_for(t)
    for number in range(most):
        if not any(loads.put(t, host) for host in hosts):
            lacks = sorted({lack for host in hosts for lack in loads.lacks(t, host)})
            return number, f"{number + 1} finds no host" + (f" with {' and '.join(lacks)}" if lacks else "")
    return most, ""


def _lack(problem: Problem, t: Transformation) -> str | None:
    environment = problem.environment
    hosts = [host for host in environment.places_for(t) if host is not None]
    if environment.hosts and not hosts:
        return f"no host is one that {t.label} may run on" + (f": {t.on}" if t.on else "")
    for label in t.beside if hosts else ():
        other = environment.transformation.get(label)
        if other is None:
            return f"{t.label} runs with {label}, and there is no such transformation"
        both = [h.name for h in hosts if h.name in environment.hosts_for(other)]
        if not any((room := host_loads(problem)).put(t, h) and room.put(other, h) for h in both):
            return f"no host has room for {t.label} together with {label}"
    for resource in sorted(t.takes):
        lacks = [
            (amount := taken(t, host)[resource], room is not None and amount > room)
            for host in hosts
            for room in [host.room(resource, problem.horizon_s)]
        ]
        if hosts and all(is_too_little for _, is_too_little in lacks):
            lasting = f" for {problem.horizon_s} s" if resource == POWER else ""
            return f"no host where {t.label} may run has {amount_of(resource, min(lacks)[0])}{lasting}"
    return None


def _can_be_met(
    problem: Problem, target: Target, without: Collection[str], units: Mapping[str, int] | None = None
) -> bool:
    """Whether the target can be met without some transformations, by so many units, or any number, of the others."""
    library = tuple(t for t in problem.environment.library if t.label not in without)
    providers = Providers(library, problem.similarity)
    return not startable(Environment((), library), providers, units=units).isdisjoint(providers.of(target.tag))


def _fatal_failure(problem: Problem, target: Target) -> Reason | None:
    """Name a failure after which no units could give the target a stream; None if there is none."""
    environment = problem.environment
    if problem.survive is None:
        return None
    for host in environment.hosts if problem.survive is Failures.HOSTS else ():
        bound = {t.label for t in environment.library if environment.hosts_for(t) == (host.name,)}
        if host.name != target.host and not _can_be_met(problem, target, bound):
            return _unmet(target, f" if host {host.name} fails")
    there = Counter(unit.transformation for unit in environment.units)
    most = {t.label: there[t.label] + problem.most_new(t) for t in environment.library}
    most |= {t.label: min(most[t.label], t.max_instances) for t in environment.library if t.max_instances is not None}
    for label, number in most.items():
        left = {**most, label: number - 1}
        if number == 1 and not _can_be_met(problem, target, {label}):
            return _unmet(target, f" if the only unit of {label} fails")
        if number > 1 and Feature.COUNTS in problem.features and not _can_be_met(problem, target, (), left):
            return _unmet(target, f" if one of {number} units of {label} fails")
    return None
