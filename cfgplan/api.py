"""The Python API, imported by `import cfgplan`: load, match, plan and judge.

The rooms for formats, matching and planners know nothing of each other; this module joins them.
"""

from __future__ import annotations

import errno
import json
import os
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from threading import Event
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

from cfgplan.arguments import Natural, Seconds, checked, unsuitable
from cfgplan.cache_folder import cache_folder
from cfgplan.canonical import fields_of
from cfgplan.domain import ENVIRONMENT_HEADS, Environment, Similarity, environment_rows
from cfgplan.errors import Fault, InputError, InvalidValueError, UnknownNameError, known
from cfgplan.extras import is_there
from cfgplan.matching import REASONERS, Ontology
from cfgplan.planners import PLANNERS, planner_of
from cfgplan.planners.undecided import Deciding
from cfgplan.planning import Decider, Failures, Plan, Planner, PlannerFaultError, Problem, Progress
from cfgplan.reasons import with_pinned_reasons
from cfgplan.summary import Summary, summarised, summary
from cfgplan.validity import Violation, plan_violations, silent_stops

if TYPE_CHECKING:
    from cfgplan.formats.document import Document
    from cfgplan.formats.environment_file import EnvironmentFile
    from cfgplan.matching import Matches, MatchExplanation, Matching, Nearest, Suggestion
    from cfgplan.observers import Circle

PLANNER_NAMES = tuple(PLANNERS)
REASONER_NAMES = tuple(REASONERS)
FEW_PAIRS = 100
"""With at most this many open pairs of tags, the reasoner decides them all. With more, it decides only those that a
plan would use.
"""
MEMBERSHIP_LIMIT_S = 60.0
"""How long a reasoner may take to find the individuals of a template's class."""


class UntruthfulPlanError(PlannerFaultError):
    """A planner's answer, a `plan`, that the judge does not accept: it `found` these violations."""

    def __init__(self, plan: Plan, found: list[Violation]) -> None:
        self.violations = tuple(found)
        super().__init__(f"the answer of planner {plan.planner} is wrong: {'; '.join(map(str, found))}", plan)


def _world_summary(world: World) -> Summary:
    line = f"{world.environment.counted}; horizon {world.horizon_s} s"
    line += f"; from {world.file.path}" if world.file is not None else ""
    return summary(line, ENVIRONMENT_HEADS, environment_rows(world.environment))


@summarised(_world_summary)
@dataclass(frozen=True)
@checked
class World:
    """An `environment` with the `ontology` that defines its tags, and the other inputs of planning.

    `horizon_s` is in seconds, `max_cost_us` in microseconds of CPU time. `file` is the file that it was read from, if
    any. `survive` says which single failures a plan has to survive.
    """

    environment: Environment
    ontology: Ontology
    horizon_s: Natural
    max_cost_us: Natural | None = None
    file: EnvironmentFile | None = None
    survive: Failures | None = None

    __getstate__ = fields_of

    @cached_property
    def digest(self) -> str:
        """A hash of all input of a plan; a plan file carries it, so that a stale plan is noticed."""
        from cfgplan.formats.environment_file import EnvironmentFile

        file = self.file or EnvironmentFile(
            Path(), self.environment, self.horizon_s, self.max_cost_us, survive=self.survive
        )
        return file.digest


@checked
def load(path: str | os.PathLike[str], *, also: Sequence[str | os.PathLike[str]] = (), use_cache: bool = True) -> World:
    """Read the environment file at `path` (YAML, JSON, or the paper's XML) and the ontologies it names.

    The files `also` are read as if that file included them. With `use_cache`, ontologies as they were read, and the
    individuals of the classes that templates name, are cached between runs.
    Raises InputError with every fault that was found.
    """
    from cfgplan.formats.document import read_document

    document = read_document(path, also)
    return world_of(document, ontology_of(document, use_cache=use_cache), use_cache=use_cache)


def ontology_of(document: Document, *, use_cache: bool = False) -> Ontology:
    """The union of the ontologies that a document names.

    With `use_cache`, they are kept between runs as they were read. Raises InputError with the document's faults and
    those of the ontologies.
    """
    from cfgplan.matching import load_ontology

    try:
        ontology = load_ontology(
            document.ontology_paths,
            dict(document.imports),
            ignores_rules=document.ignores_rules,
            cache=cache_folder() if use_cache else None,
        )
    except InputError as error:
        raise InputError((*document.faults, *map(document.at_ontology, error.faults))) from None
    spaces: list[str] = []
    faults: list[Fault] = []
    for written, entry in document.preferred:
        try:
            spaces.append(ontology.namespace(written))
        except UnknownNameError as error:
            mend = "without `ontology:` no name has a namespace: remove it" if ontology.is_open else error.mend
            faults.append(document.files[0].source.fault(entry, error.message, mend))
    if faults:
        raise InputError((*document.faults, *faults))
    return ontology.preferring(spaces)


def world_of(document: Document, ontology: Ontology, *, use_cache: bool = False) -> World:
    """The world that a document describes, with its templates expanded by an ontology.

    With `use_cache`, the individuals of the classes that templates name are cached between runs. Raises InputError with
    every fault, also those of the document.
    """
    from cfgplan.formats.assembly import build

    file = build(document, _OntologyVocabulary(ontology, cache_folder() if use_cache else None))
    return World(file.environment, ontology, file.horizon_s, file.max_cost_us, file, file.survive)


@checked
def what_if(
    world: World,
    *,
    without: Collection[str] = (),
    settings: Mapping[str, str] | None = None,
    observed: str | os.PathLike[str] | None = None,
) -> World:
    """Return the world without some transformations, units or targets, and with other values of `settings`.

    `without` has their names. If several kinds of parts share a name, write the kind before it: `target heat`.

    Settings are `horizon`, `max_cost`, `facts.NAME`, `T.labor`, `T.upkeep`, `T.pinned`, `T.required` and `T.priority`,
    with values as they are written in files. `observed` is a file with the facts and qualities that a run has observed
    (`cfgplan ctl observed --out`); where both have a value, `settings` wins. Raises InputError.
    """
    from cfgplan.explaining import what_if as supposing

    environment = world.environment
    if observed is not None:
        from cfgplan.formats.observed_file import read_observed

        environment = read_observed(observed, environment)
    environment = supposing.without(environment, without)
    supposed = supposing.Supposed(environment, world.horizon_s, world.max_cost_us)
    supposed = supposing.with_settings(supposed, settings or {})
    environment, horizon_s, max_cost_us = supposed.environment, supposed.horizon_s, supposed.max_cost_us
    file = world.file
    if file is not None:
        file = replace(file, environment=environment, horizon_s=horizon_s, max_cost_us=max_cost_us)
    return World(environment, world.ontology, horizon_s, max_cost_us, file, world.survive)


@checked
def world(
    environment: Environment, *, horizon_s: Natural, max_cost_us: Natural | None = None, ontology: object = None
) -> World:
    """Return a world built in code; `ontology` is an `owlready2` ontology, a file's path or a list of paths.

    An `owlready2` ontology is read as it is now: later changes need a new world. Without an ontology every name in a
    tag is free. Tags are read by `match`, which raises InputError for what does not parse.
    """
    known = _as_ontology(ontology)
    return World(environment, known, horizon_s, max_cost_us)


@checked
def match_ports(
    world: World, *, reasoner: str = "auto", time_limit_s: Seconds | None = None, use_cache: bool = True
) -> Matching:
    """Decide which output may feed which input and target; the result has the reasoner's warnings.

    `reasoner` is one of `REASONER_NAMES`. Pairs that are not decided within `time_limit_s` stay unknown.
    """
    return matches(world, reasoner=reasoner, time_limit_s=time_limit_s, use_cache=use_cache, most=None).matching


@checked
def matches(
    world: World,
    *,
    reasoner: str = "auto",
    time_limit_s: Seconds | None = None,
    use_cache: bool = True,
    most: Natural | None = FEW_PAIRS,
) -> Matches:
    """Return the similarity of a world's tags as far as it is known.

    The reasoner decides open pairs at once if there are at most `most`. Otherwise pass the result as `decider` to the
    planning function: it decides only pairs that matter to the plan.
    """
    from cfgplan.matching import Matches

    cache = cache_folder() if use_cache else None
    return Matches(
        *_tags(world.environment), world.ontology, reasoner=reasoner, time_limit_s=time_limit_s, cache=cache, most=most
    )


def _tags(environment: Environment) -> tuple[frozenset[str], frozenset[str]]:
    """The tags that are offered, and those that are demanded."""
    return frozenset(environment.outputs.values()), frozenset(environment.demands.values())


def explain_match(
    world: World, offered: str, demanded: str, *, reasoner: str = "auto", time_limit_s: Seconds | None = None
) -> MatchExplanation:
    """Why an output tagged `offered` may or may not feed an input or target tagged `demanded`."""
    from cfgplan.matching import explain_match as explain

    return explain(offered, demanded, world.ontology, reasoner=reasoner, time_limit_s=time_limit_s)


def nearest_offers(world: World, demanded: str, **reasoning: Any) -> tuple[Nearest, ...]:
    """Return the three offered tags of the library most similar to a demanded one; see `near_offers` for
    `reasoning`.
    """
    return near_offers(world, [demanded], **reasoning)[demanded][:3]


def near_offers(
    world: World, demanded: Collection[str], *, reasoner: str = "auto", time_limit_s: Seconds | None = None
) -> dict[str, tuple[Nearest, ...]]:
    """Return, for each demanded tag, all offered tags that have one of its conjuncts, the most similar first."""
    from cfgplan.matching import near_offers as near

    offered, _ = _tags(world.environment.possible)
    return near(demanded, offered, world.ontology, reasoner=reasoner, time_limit_s=time_limit_s)


@checked
def suggested_tags(
    world: World,
    names: Collection[str] | None = None,
    *,
    foreign: str | None = None,
    reasoner: str = "auto",
    time_limit_s: float | None = None,
) -> dict[str, tuple[Suggestion, ...]]:
    """Up to three tags for each input, output and target, or for those of some names, the best first.

    Each says which ports would match by it that do not match now, and which would no longer, as reasoners decide. Tags
    are in words (`and`, `some`) if those of the environment have no symbols (⊓, ∃). No class is proposed whose IRI
    begins with `foreign`. Names are those of `Environment.outputs` and `.demands`; any other raises InputError.
    """
    from cfgplan.matching import match as match_tags
    from cfgplan.matching.suggestions import Proposer, tested, words_of_ports

    environment = world.environment
    tags = {**environment.outputs, **environment.demands}
    in_words = not any(sign in tag for tag in tags.values() for sign in "⊓⊔¬∃∀")
    proposer = Proposer(world.ontology, foreign, words=in_words)
    words = words_of_ports(environment, world.ontology)
    for name in names or ():
        known(name, words, "port or target", "`Environment.outputs` and `.demands` have them all")
    proposed = {name: proposer.proposals(words[name], now=tags[name]) for name in (words if names is None else names)}
    outputs, demands = environment.outputs, environment.demands
    offered = {*outputs.values(), *(each.tag for name in proposed.keys() & outputs for each in proposed[name])}
    demanded = {*demands.values(), *(each.tag for name in proposed.keys() & demands for each in proposed[name])}
    found = match_tags(offered, demanded, world.ontology, reasoner=reasoner, time_limit_s=time_limit_s).similarity

    def matched(name: str, tag: str) -> frozenset[str]:
        if name in outputs:
            return frozenset(other for other, wanted in demands.items() if found.holds(tag, wanted))
        return frozenset(other for other, given in outputs.items() if found.holds(given, tag))

    now = {name: matched(name, outputs.get(name) or demands[name]) for name in proposed}
    then = {name: {each.tag: matched(name, each.tag) for each in some} for name, some in proposed.items()}
    return tested(proposed, now, then)


@checked
def problem(
    world: World,
    similarity: Similarity,
    *,
    horizon_s: Natural | None = None,
    max_cost_us: Natural | None = None,
    survive: Failures | Literal[0] | None = None,
) -> Problem:
    """Return the planning problem of a matched world.

    The arguments override the file (`survive=0`: survive no failure). The library omits each transformation whose
    required facts are not met. Raises InputError if a transformation requires a fact that it helps to observe.
    """
    refuse_circles(world, similarity)
    return Problem(
        world.environment.possible,
        similarity,
        world.horizon_s if horizon_s is None else horizon_s,
        world.max_cost_us if max_cost_us is None else max_cost_us,
        world.survive if survive is None else (survive or None),
    )


def refuse_circles(world: World, similarity: Similarity) -> None:
    """Raise InputError if a transformation requires a fact that it observes, or whose observer it feeds."""
    if not world.environment.facts:
        return
    from cfgplan.observers import circles

    if faults := [_fault_of_circle(circle, world.file) for circle in circles(world.environment, similarity)]:
        raise InputError(faults)


def _fault_of_circle(circle: Circle, file: EnvironmentFile | None) -> Fault:
    mend = f"give the observer of `{circle.fact}` a tag that only it has, or remove the comparison"
    origin = None if file is None else file.origins.get(("transformation", circle.transformation))
    message = f"{circle}: once it is left out, no unit would observe when it may run again"
    if origin is None:
        return Fault(message, mend=mend)
    entry = origin.at("requires")
    return entry.source.fault(entry.path, message, mend)


@checked
def match(
    world: World,
    *,
    horizon_s: Natural | None = None,
    max_cost_us: Natural | None = None,
    survive: Failures | Literal[0] | None = None,
) -> Problem:
    """Match a world's tags, and return its planning problem. Raises InputError for tags that do not parse; else as
    `problem`.
    """
    similarity = match_ports(world).similarity
    return problem(world, similarity, horizon_s=horizon_s, max_cost_us=max_cost_us, survive=survive)


@checked
def plan(
    problem: Problem,
    *,
    planner: str | Planner = "cpsat",
    time_limit_s: Seconds | None = None,
    report: Callable[[Progress], None] | None = None,
) -> Plan:
    """Return the optimal update, accepted by the judge. `report` is called with the planner's progress.

    Raises InputError for an unknown planner, OwnPlannerError for one of your own that fails; else as `accepted`.
    """
    return accepted(problem, planner_of(planner)(problem, time_limit_s=time_limit_s, report=report))


class Solved(NamedTuple):
    """A problem, with the pairs of tags that were decided on the way, and its answer."""

    problem: Problem
    plan: Plan

    def _repr_svg_(self) -> str | None:
        """The picture of `cfgplan graph`, for a notebook; None without a plan or without pygraphviz."""
        if self.plan.change_set is None or not is_there("pygraphviz"):
            return None
        from cfgplan import drawing

        return drawing.picture(self.problem.environment, self.plan.change_set).render("svg").decode()


@checked
def solve(
    world: World,
    *,
    planner: str | Planner = "cpsat",
    horizon_s: Natural | None = None,
    max_cost_us: Natural | None = None,
    survive: Failures | Literal[0] | None = None,
    time_limit_s: Seconds | None = None,
    reasoner: str = "auto",
    reasoner_limit_s: Seconds | None = None,
) -> Solved:
    """Match the tags that a plan may use, and plan. Returns the problem and the optimal update, accepted by the judge.

    Planning and reasoning have a time limit each. Raises as `plan`.
    """
    decider = matches(world, reasoner=reasoner, time_limit_s=reasoner_limit_s)
    stated = problem(world, decider.similarity, horizon_s=horizon_s, max_cost_us=max_cost_us, survive=survive)
    return solved(stated, decider, planner=planner, time_limit_s=time_limit_s)


def solved(
    problem: Problem,
    decider: Decider,
    *,
    planner: str | Planner = "cpsat",
    time_limit_s: Seconds | None = None,
    report: Callable[[Progress], None] | None = None,
) -> Solved:
    """Plan a problem; the decider decides the open pairs of tags that matter to the plan. Raises as `plan`.

    The result has the plan, and the problem with the decided pairs.
    """
    stop = Event()
    deciding = Deciding(interruptible(planner, stop), decider, stop.is_set)
    answer = deciding(problem, time_limit_s=time_limit_s, report=report)
    return Solved(deciding.known(problem), accepted(deciding.known(problem), answer))


def interruptible(planner: str | Planner, stop: Event) -> Planner:
    """Return the planner of a name; `cpsat` sets `stop` if Ctrl-C ended it."""
    if planner != "cpsat":
        return planner_of(planner)
    from cfgplan.planners import cpsat

    return partial(cpsat.plan, stop=stop)


def accepted(problem: Problem, answer: Plan) -> Plan:
    """Let the judge check a planner's answer, and return it with a reason for each pinned unit that it can't keep.

    Raises UntruthfulPlanError if the judge refuses it, PlannerFaultError if the judge fails; both have the plan.
    """
    if answer.change_set is not None:
        answer = replace(answer, reasons=with_pinned_reasons({}, problem))
    try:
        found = plan_violations(problem, answer) or silent_stops(problem, answer)
    except Exception as error:
        raise PlannerFaultError(f"the judge failed: {type(error).__name__}: {error}", answer) from error
    if found:
        raise UntruthfulPlanError(answer, found)
    return answer


def plan_text(world: World, problem: Problem, plan: Plan) -> str:
    """Return the plan file (JSON) of a plan, as `solve --out` writes it."""
    from cfgplan.formats.plan_file import dump_plan

    return dump_plan(plan, problem, world.digest)


@checked
def load_plan(world: World, problem: Problem, path: str | os.PathLike[str]) -> Plan:
    """Return the plan in the plan file at `path`, if it was made for this world and the judge accepts it: it may be
    carried out.

    Change set, cost, status and bound are checked against `problem`; the proof that no plan is cheaper is not repeated.
    A plan becomes stale if an ontology changes that the environment file names under `ontology:` or `imports:`, not if
    one changes that only other ontologies import; the judge uses the present matches in any case. Raises InputError for
    a file that is broken, stale or has been changed.
    """
    from cfgplan.formats.plan_file import load_plan as read_plan

    answer = read_plan(path, world.digest)
    found = plan_violations(problem, answer) or silent_stops(problem, answer)
    if found:
        mend = "write the plan again with `solve --out`"
        raise InputError([Fault(f"the plan contradicts itself: {each}", str(path), mend=mend) for each in found])
    return answer


def schema_text() -> str:
    """The JSON Schema of the environment file."""
    from cfgplan.formats.fields import EnvironmentPart
    from cfgplan.formats.models import json_schema

    return json.dumps(json_schema(EnvironmentPart), indent=2, ensure_ascii=False) + "\n"


def converted(path: str | os.PathLike[str], to: Literal["yaml", "xml"]) -> str:
    """Return an environment file (YAML, JSON, the paper's XML or a folder of it) in another format; templates are kept.

    Included files are written into it. Raises InputError.
    """
    from cfgplan.formats.document import read_document
    from cfgplan.formats.dump import as_xml, as_yaml

    document = read_document(path)
    return as_xml(document) if to == "xml" else as_yaml(document)


class _OntologyVocabulary:
    """An ontology as the formats ask for it."""

    def __init__(self, ontology: Ontology, cache: Path | None) -> None:
        from cfgplan.matching import check_tag

        self._ontology = ontology
        self._cache = cache
        self._check_tag = check_tag

    def instances(self, class_name: str) -> tuple[str, ...]:
        from cfgplan.matching import instances

        return instances(self._ontology, class_name, time_limit_s=MEMBERSHIP_LIMIT_S, cache=self._cache)

    def check_tag(self, text: str) -> None:
        self._check_tag(text, self._ontology)


def _as_ontology(ontology: object) -> Ontology:
    from cfgplan.matching import load_ontology, read_owlready

    if ontology is None:
        return load_ontology([])
    if isinstance(ontology, Ontology):
        return ontology
    paths = [ontology] if isinstance(ontology, (str, os.PathLike)) else ontology
    if isinstance(paths, (list, tuple)) and all(isinstance(path, (str, os.PathLike)) for path in paths):
        return load_ontology(paths)
    try:
        return read_owlready(ontology)
    except InvalidValueError:
        wanted = "None, an owlready2 ontology, a path or a list of paths"
        raise unsuitable("world()", "ontology", wanted, ontology) from None


def write_file(path: Path, content: bytes) -> None:
    """Write a whole file, or nothing of it; raises InputError if that fails.

    A path that is no regular file (a device, a pipe, a link) is written through, not replaced.
    """
    try:
        if path.is_symlink() or (path.exists() and not path.is_file()):
            path.write_bytes(content)
        else:
            _replace(path, content)
    except OSError as error:
        raise InputError.unwritable(error, str(path)) from None


def _replace(path: Path, content: bytes) -> None:
    """Replace a file, which must be writable, by a new one with the same permissions."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}.new")
    exists = path.exists()
    if exists and not os.access(path, os.W_OK):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
    try:
        with temporary.open("xb") as file:
            file.write(content)
        if exists:
            temporary.chmod(path.stat().st_mode & 0o7777)
        temporary.replace(path)
    except OSError:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)
        raise
