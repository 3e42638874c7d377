"""Words of an environment file that have no effect, so that the user learns of each."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass
from itertools import combinations_with_replacement
from typing import TYPE_CHECKING, Any, get_args

from cfgplan.cli.plan_text import nothing_wanted
from cfgplan.domain import CPU, MEMORY, POWER, Environment, Link, Objective, RunOptions, Transformation
from cfgplan.errors import Fault
from cfgplan.facts import requirement
from cfgplan.formats.environment_file import ANY_IMPORT
from cfgplan.onward import grouped
from cfgplan.qualities import Better, Over
from cfgplan.ros.sources import NodeKind
from cfgplan.rows import ALL
from cfgplan.summary import some

if TYPE_CHECKING:
    from cfgplan.api import World
    from cfgplan.formats.environment_file import EnvironmentFile
    from cfgplan.formats.places import Passage

_NO_HOSTS = "no hosts are declared"
_USUAL = RunOptions()
_RESOURCES = (
    ("cpu", CPU, "upkeep` or `source"),
    ("memory", MEMORY, "memory"),
    ("energy", POWER, "needs: {power: ...}"),
)
"""The limits of hosts, with the resource and the key by which transformations say that they take it."""
_PYTHON, _PROGRAM = "python", "program"


@dataclass(frozen=True, slots=True)
class _Idle:
    """The word at `path` in the part of this `kind` and `name`, and `why` it has no effect."""

    kind: str
    name: str
    path: tuple[str, ...]
    why: str


def idle_words(world: World) -> Iterator[Fault]:
    """Yield a fault for each key with words that have no effect, at the first of them, with the reason. The faults come
    in the order of their places.

    These words are not listed: one that describes (`unit`, `kind`, `labels` and `offers` of hosts), one that another
    command or option uses (`standby` by `--survive`), one that states the default, and one of a library that another
    environment uses: of an included file, or of a file that wants nothing to run.
    """
    file, environment = world.file, world.environment
    if file is None:
        return
    found = [*_in_library(world), *_in_fleet(environment), *_in_targets(environment)]
    found += [*_in_head(world)]
    yield from sorted(_faults(found, file), key=lambda each: (each.file or "", each.line or 0, each.column or 0))


def _faults(found: Iterable[_Idle], file: EnvironmentFile) -> Iterator[Fault]:
    for (key, why), idle in grouped(((".".join(_key(each)), each.why), each) for each in found).items():
        names = some(dict.fromkeys(each.name for each in idle if each.name))
        text = f"`{key}`{f' of {names}' if names else ''} has no effect: {why}"
        origin = file.origins.get((idle[0].kind, idle[0].name))
        if origin is None:
            yield Fault(text, str(file.path))
        else:
            place = origin.at(*idle[0].path)
            yield place.source.fault(place.path, text, at_key=True)


def _key(word: _Idle) -> Iterable[str]:
    """The keys that lead to a word, without the names of ports and of outputs' quality attributes."""
    return [each for at, each in enumerate(word.path) if at % 2 == 0 or word.path[0] not in ("inputs", "outputs")]


def _in_library(world: World) -> Iterator[_Idle]:
    environment, file = world.environment, world.file
    assert file is not None
    is_library = bool(nothing_wanted(environment)) and not environment.units
    limited = {each for each in (MEMORY, POWER) for host in environment.hosts if host.room(each, 1) is not None}
    for each in environment.library:
        origin = file.origins[("transformation", each.label)]
        found = [*_of_run(each), *_of_ports(each)]
        if origin.source.file == str(file.path) and not is_library:
            found += _unlimited(each, limited if environment.hosts else None)
            found += [] if environment.qualities else _ungraded(origin)
        yield from (_Idle("transformation", each.label, path, why) for path, why in found)


def runs_as(source: str | None) -> str | None:
    """How a transformation's code runs: as a program, a kind of ROS node, or in Python; None without code."""
    scheme, _, rest = (source or "").partition(":")
    if scheme == _PROGRAM or (scheme in get_args(NodeKind) and "/" in rest):
        return scheme
    return _PYTHON if source else None


_Word = tuple[tuple[str, ...], str]


def _of_run(t: Transformation) -> Iterator[_Word]:
    run, kind = t.run, runs_as(t.source)
    starting = [port for port in t.inputs if not (port.service or port.optional)]
    is_node = kind in get_args(NodeKind)
    if not t.inputs:
        for key, value in (("start", run.start), ("queue", run.queue), ("blocks", run.blocks)):
            if value != getattr(_USUAL, key):
                yield ("run", "when_full" if key == "blocks" else key), "a source has no inputs"
    elif run.start == "aligned" and sum(2 if port.count == ALL else port.count for port in starting) < 2:
        yield ("run", "start"), "`aligned` needs two streams that start steps"
    if run.tolerance_us and run.start != "aligned":
        yield ("run", "tolerance"), "it needs `start: aligned`"
    if is_node and t.inputs and run.blocks:
        yield ("run", "when_full"), "ROS nodes have queues of their own"
    if is_node and run.start == "aligned":
        yield ("run", "start"), "ROS nodes align messages by their own code"
    if run.format != _USUAL.format and kind not in (_PROGRAM, None):
        yield ("run", "format"), "only programs exchange messages in it"
    if run.lifecycle and kind not in ("node", "component", None):
        yield ("run", "lifecycle"), "only ROS 2 nodes and components have one"
    if run.container != _USUAL.container and kind not in ("component", None):
        yield ("run", "container"), "only ROS 2 components are in one"
    if run.state and kind not in (_PYTHON, None):
        yield ("run", "state"), "only Python code keeps it"


def _of_ports(t: Transformation) -> Iterator[_Word]:
    is_own = runs_as(t.source) in (_PYTHON, _PROGRAM)
    for key, ports in (("inputs", t.inputs), ("outputs", t.outputs)):
        for port in ports:
            if port.remap is not None and is_own:
                yield (key, port.name, "remap"), "only ROS nodes have names of their own for ports"
    for port in t.inputs:
        group = [each for each in t.inputs if each.distinct == port.distinct]
        if port.distinct is not None and sum(2 if each.count == ALL else each.count for each in group) < 2:
            yield ("inputs", port.name, "distinct"), "no other input is in its group"
    for port in t.outputs:
        if port.topic is not None and is_own:
            yield ("outputs", port.name, "topic"), "only ROS 2 nodes publish outside of a run; add a target"
        for key, said, other in (("rate", port.rate_uhz, "size"), ("size", port.size_bytes, "rate")):
            if said and not port.bytes_per_s:
                yield ("outputs", port.name, key), f"without `{other}`, sending the stream to other hosts costs nothing"
        combined = sum(2 if each.count == ALL else each.count for each in t.inputs if not each.feedback)
        for stated in port.quality:
            if stated.over is not Over.WORST and combined < 2:
                yield ("outputs", port.name, "quality", stated.attribute, "of"), "no two inputs have values to combine"


def _unlimited(t: Transformation, limited: Collection[str] | None) -> Iterator[_Word]:
    """Yield the idle words of a transformation about hosts. Hosts limit the `limited` resources; None: no hosts."""
    for key, value in (("on", t.on), ("at_most", t.at_most), ("memory", t.memory_mb), ("needs", t.needs)):
        if value and limited is None:
            yield (key,), _NO_HOSTS
    for path, resource, by in ((("memory",), MEMORY, "memory"), (("needs", POWER), POWER, "energy")):
        said = t.memory_mb if resource == MEMORY else t.needs.get(resource)
        if said and limited is not None and resource not in limited:
            yield path, f"no host has `{by}`"


def _ungraded(origin: Passage) -> Iterator[_Word]:
    """Yield the qualities of outputs if no attribute is declared: the environment then has none of them."""
    data: Any = origin.source.data
    for step in origin.path:
        data = data[step]
    for port, said in (data.get("outputs") or {}).items():
        if isinstance(said, dict) and said.get("quality"):
            yield ("outputs", port, "quality"), "no attribute is declared under `qualities:`"


def _in_fleet(environment: Environment) -> Iterator[_Idle]:
    hosts, links, library = environment.hosts, environment.links, environment.library
    taken = {each for t in library for each, amount in t.takes.items() if amount}
    taken |= {CPU for t in library if t.source}  # a run measures how much its units take
    for host in hosts:
        for key, resource, by in _RESOURCES:
            if host.room(resource, 1) is not None and resource not in taken:
                yield _Idle("host", host.name, (key,), f"no transformation has `{by}`")
    pairs = _linked(environment)
    is_carried = any(port.bytes_per_s for t in library for port in t.outputs)
    for number, link in enumerate(links, start=1):
        name = f"link {number}"
        if link not in pairs and all(any(host.fits(end) for host in hosts) for end in link.between):
            yield _Idle("link", name, ("between",), "earlier links join its hosts, or it joins one host to itself")
        for key, value in (("bandwidth", link.bandwidth), ("price", link.price_us)):
            if value is not None and not is_carried:
                yield _Idle("link", name, (key,), "no output has both `rate` and `size`")
    if environment.transfer_us and not (is_carried and any(k is None or k.price_us is None for k in pairs)):
        why = "each two hosts have a link's price" if is_carried else "no output has both `rate` and `size`"
        why = why if len(hosts) > 1 else "only one host is declared" if hosts else _NO_HOSTS
        yield _Idle("", "", ("transfer",), why)
    for objective in environment.minimise:
        if objective is Objective.HOSTS and not hosts:
            yield _Idle("", "", ("minimise", objective.value), _NO_HOSTS)
        if objective is Objective.RENT and not any(host.rent_us for host in hosts):
            yield _Idle("", "", ("minimise", objective.value), "no host has `rent`")


def _linked(environment: Environment) -> set[Link | None]:
    """The links that pairs of hosts use: of each pair the first that joins it, or None if no link does."""
    ends = {text for link in environment.links for text in link.between}
    kinds = Counter(frozenset(text for text in ends if host.fits(text)) for host in environment.hosts)
    found = set[Link | None]()
    for one, other in combinations_with_replacement(kinds, 2):
        if one != other or kinds[one] > 1:
            joins = (
                each
                for each in environment.links
                if (each.between[0] in one and each.between[1] in other)
                or (each.between[1] in one and each.between[0] in other)
            )
            found.add(next(joins, None))
    return found


def _in_targets(environment: Environment) -> Iterator[_Idle]:
    for target in environment.targets:
        for wish in target.quality:
            attribute = environment.quality[wish.attribute]
            if wish.bound is not None and not attribute.is_better(wish.bound, attribute.worst):
                key = "at_most" if attribute.better is Better.LOWER else "at_least"
                why = f"{attribute.name} is never worse than {attribute.shown(attribute.worst)}"
                yield _Idle("target", target.label, ("quality", wish.attribute, key), why)
    ports = [port for t in environment.library for port in t.outputs]
    named = {each.attribute for port in ports for each in port.quality} | {link.adds for link in environment.links}
    named |= {wish.attribute for target in environment.targets for wish in target.quality}
    for name in environment.quality.keys() - named:
        yield _Idle("quality", name, ("name",), "no output, target or link has it")
    followed = {each.by.fact for port in ports for each in port.quality if each.by is not None}
    for t in environment.library:
        followed |= {each.fact for each in requirement(t.requires).comparisons} if t.requires is not None else set()
    for fact in environment.facts:
        if fact.name not in followed and fact.by is None and fact.topic is None:
            yield _Idle(
                "fact", fact.name, ("declared",), "no `requires` and no quality uses it, and nothing observes it"
            )


def _in_head(world: World) -> Iterator[_Idle]:
    file, ontology = world.file, world.ontology
    assert file is not None
    for iri, path in file.imports:
        is_used = iri in (ANY_IMPORT, *ontology.ignored) if path is None else path.resolve() in {*ontology.files}
        if not (file.ontology_paths and is_used):
            keys = ("imports", iri) if iri else ("imports",)
            yield _Idle("", "", keys, "no ontology imports it" if iri else "no ontology is named")
    if file.ignores_rules and not ontology.ignored_rules:
        yield _Idle("", "", ("rules",), "the ontologies have no rules")
