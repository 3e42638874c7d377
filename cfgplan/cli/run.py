"""`cfgplan run`: start the cheapest configuration that meets the targets, and keep it the cheapest."""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from importlib.machinery import PathFinder
from pathlib import Path
from typing import TYPE_CHECKING

from cfgplan.cli import options as shared
from cfgplan.cli import run_targets
from cfgplan.cli.agent import add_links
from cfgplan.cli.exits import Exit, exit_of
from cfgplan.cli.idle_words import idle_words
from cfgplan.cli.interrupts import Interrupts
from cfgplan.cli.run_checks import (
    check_can_start,
    check_places,
    check_ros2_topics,
    check_ros_nodes,
    raise_all,
    refuse_nodes,
)
from cfgplan.cli.run_middleware import (
    OF_ROS,
    ROS1,
    facts_of_ros,
    fleet_of,
    folder_of,
    qualities_of_ros,
    runtime_of,
    source_check_of,
)
from cfgplan.cli.run_output import JsonLines, Lines, RunOutput
from cfgplan.cli.screen import Screen, counted
from cfgplan.errors import InputError
from cfgplan.extras import needed

if TYPE_CHECKING:
    from cfgplan_runtime.operating.operation import Operation, Settings

    from cfgplan.api import World
    from cfgplan.cli.first_plan import FirstPlan
    from cfgplan.domain import ComputationUnit, Environment

_LIVE_LOOK_S = 0.1
_HOSTS_S = 5.0
"""Seconds after the start until a fleet's backend must have reported each host."""
_EXTRAS = {
    "metrics_port": ("metrics", "prometheus_client"),
    "record": ("recordings", "mcap"),
    "local": ("several computers", "zenoh"),
    "connect": ("several computers", "zenoh"),
}
"""The options that need a package, with what needs it; without the package the run ends before it plans."""
_ESTIMATORS = ("declared", "latest", "trend")
_GUESSES = ("declared", "optimistic", "pessimistic")
_RUN_EXAMPLE = """\
example:
  cfgplan run env.yaml --for 30s --record run.mcap
  cfgplan listen /result      # in another terminal
  cfgplan ctl state           # in another terminal

Editing ENV changes the run. `units:` of ENV is ignored: a run starts from nothing.
Ctrl-C stops the run and lets units finish; a second Ctrl-C kills them.
Exit codes: 0 stopped with every target met, 12 stopped with a target not met, 30 bad input, 31 internal error,
130 stopped by a second Ctrl-C. With --strict and --dry-run: those of `cfgplan solve` too."""


def add_to(parser: argparse.ArgumentParser) -> None:
    parser.epilog = _RUN_EXAMPLE
    shared.add_environment(parser)
    shared.add_span(parser)
    parser.add_argument("--dry-run", action="store_true", help="show what would be started, and start nothing")
    differing = "list how the first configuration differs from the file's `units:`, which a run ignores"
    parser.add_argument("--from", dest="compared", choices=("units",), help=differing)
    parser.add_argument("--strict", action="store_true", help="start nothing if some target can't be met")
    named = "name of the run, for `cfgplan ctl --name NAME` and `cfgplan listen --run NAME`"
    parser.add_argument("--name", type=shared.run_name, metavar="NAME", help=named)
    yes = "stop units that an earlier run left running, without asking"
    parser.add_argument("--yes", action="store_true", help=yes)
    parser.add_argument("--plain", action="store_true", help="print one line for each event, instead of the live view")
    parser.add_argument("--log", metavar="FILE", help="append every event to FILE, as one line of JSON each")
    parser.add_argument("--record", metavar="FILE", help="record the targets' streams and all events into FILE (MCAP)")
    parser.add_argument(
        "--metrics-port",
        type=shared.port,
        metavar="N",
        help="serve metrics for Prometheus on port N of 127.0.0.1; 0: any free port (default: no metrics)",
    )
    parser.add_argument(
        "--estimator",
        choices=_ESTIMATORS,
        default="trend",
        help="costs to plan with: as declared, as observed last, or by the trend (default: trend)",
    )
    parser.add_argument(
        "--guess",
        choices=_GUESSES,
        default="declared",
        help="cost of a transformation that never ran; optimistic: low, so that it is tried soon (default: declared)",
    )
    kept = parser.add_mutually_exclusive_group()
    kept.add_argument(
        "--estimates",
        metavar="FILE",
        help="JSON file that keeps learned costs between runs (default: a file in ~/.local/state/cfgplan)",
    )
    kept.add_argument("--no-estimates", action="store_true", help="do not read or keep learned costs")
    longest = "longest wait before a failing transformation without a replacement is started again (default: 3s)"
    shared.add_time(parser, "--back-off", 3.0, longest)
    shared.add_several(parser, "--preload", "MODULE", "import this module before units start; may be repeated")
    parser.add_argument(
        "--reload", action="store_true", help="when a unit's code changes, replace the unit without a gap in its stream"
    )
    shared.add_page(parser, "the run")
    shared.add_allow_code(parser)
    run_targets.add_to(parser)
    parser.add_argument("--local", action="store_true", help="run the units of all hosts on this computer")
    runs = "run units as processes, or as nodes of ROS 1 or ROS 2 (default: processes)"
    parser.add_argument("--middleware", choices=("processes", *OF_ROS), default="processes", help=runs)
    python = "the Python with rclpy (default: CFGPLAN_ROS_PYTHON, the Python of a sourced setup.bash, or python3)"
    parser.add_argument("--ros-python", metavar="PYTHON", help=python)
    add_links(parser)
    parser.add_argument(
        "--take-over",
        action="store_true",
        help="take over the hosts and their units from a run that is still live on another computer",
    )
    shared.add_planning(parser, "only with --dry-run; to change a run, edit ENV or use `cfgplan ctl`")
    shared.add_matching(parser)
    shared.add_json(parser)
    # A life-cycle's planner remembers from plan to plan; one of PLANNERS is used if it is named.
    parser.set_defaults(run=run, planner=None)


def run(options: argparse.Namespace, screen: Screen) -> Exit:
    from cfgplan_runtime.lifecycle.worlds import refuse_hosts

    from cfgplan.cli.plan_text import left_out_lines, nothing_wanted

    if options.page is not None:
        shared.needed_for_pages()
    elif options.allow_code:
        raise InputError.of("--allow-code is for the page of the run", mend="add --page, or leave it out")
    for option, (who, package) in _EXTRAS.items():
        given = getattr(options, option)
        if not options.dry_run and given is not None and given is not False and given != []:
            needed(who, package)
    run_targets.check_options(options)
    if not options.dry_run:
        check_places(options)
    for name in options.preload:
        top = name.partition(".")[0]
        if top not in sys.builtin_module_names and PathFinder.find_spec(top, ["", *sys.path]) is None:
            raise InputError.of(f"--preload: there is no module {name!r}", mend="write it as in an `import` statement")
    if options.reload and (options.connect or options.middleware in OF_ROS):
        what = "files of this computer" if options.connect else "unit code, and not nodes of ROS"
        raise InputError.of(f"--reload watches {what}", mend="use `cfgplan ctl restart UNIT`")
    if not options.dry_run and shared.asks_what_if(options):
        mend = "add --dry-run; or edit the file, or use `cfgplan ctl` while it runs"
        raise InputError.of("--without, --with, --set and --observed are allowed only with --dry-run", mend=mend)
    loaded = shared.load(options, screen)
    if not options.dry_run and fleet_of(options) is None:
        refuse_hosts(loaded)
    elif not options.dry_run and not loaded.environment.hosts:
        mend = "name them under `hosts:`, or leave out --local and --connect"
        raise InputError.of("the file has no hosts", file=options.env, mend=mend)
    check_can_start(options, loaded)
    if options.middleware in OF_ROS:
        check_ros_nodes(options, loaded)
    else:
        if not options.dry_run:
            refuse_nodes(options, loaded)
        check_ros2_topics(options, loaded)
        if (check := run_targets.mqtt_check(options, loaded.environment)) is not None:
            raise_all([check], options.env)
    facts = tuple(fact for fact in loaded.environment.facts if fact.type is not None)
    if facts and options.middleware != ROS1:  # in ROS 1, publishers say what their messages are
        from cfgplan_runtime.ros2.facts import check_facts

        check_facts(facts, Path(options.env))
    said = loaded.environment if options.compared else None
    if loaded.environment.units and said is None:
        count = counted(len(loaded.environment.units), "running unit")
        mend = "`--from units` shows the difference"
        screen.note(f"The file names {count}, but `cfgplan run` ignores them and starts from nothing; {mend}.")
    if told := nothing_wanted(loaded.environment):
        screen.warn(told)
    for fault in idle_words(loaded):
        screen.warn_of(fault)
    for line in left_out_lines(loaded.environment):
        screen.note(line)
    world = replace(loaded, environment=replace(loaded.environment, units=()))
    settings = _settings(options, screen)
    planned = _first_plan(options, world, settings, screen)
    findings, found = planned.preview.findings, planned.found
    code = None if found is None else exit_of(found.plan.status, is_exact=found.exact, is_unmet=bool(found.unmet))
    if options.dry_run or (options.strict and code is not Exit.OK):
        if found is None or code is None:
            raise findings.error or RuntimeError(findings.cause)
        screen.write(planned.document()) if screen.json else planned.show(screen, _differing(said))
        return code
    if found is not None:
        planned.tell(screen) if screen.json else planned.show(screen)
        settings = replace(settings, first=planned.preview)
    if not screen.json:
        settings = replace(settings, told={label: str(fault) for label, fault in planned.faults.items()})
    if not (options.yes or planned.confirm(screen)):
        return Exit.INTERRUPTED
    return _operate(options, world, settings, screen, said)


def _first_plan(options: argparse.Namespace, world: World, settings: Settings, screen: Screen) -> FirstPlan:
    """The plan of the run's first review, with the units that an earlier run has left on the hosts of a fleet."""
    from cfgplan_runtime.operating.sources import faults_of

    from cfgplan.api import FEW_PAIRS
    from cfgplan.cli.first_plan import FirstPlan, first_review, show_faults
    from cfgplan.domain import Environment

    left, fleet = None, None if options.dry_run else fleet_of(options)
    if fleet is not None:
        from cfgplan_runtime.fleet.fleet_runtime import left_units

        left = left_units(fleet, world.environment, folder_of(options))
    matches = shared.matches(options, screen, world, FEW_PAIRS)
    known = matches.warnings
    adjusted = _adjusted(options, world)
    faults = faults_of(adjusted.environment.library, folder_of(options), settings.check)
    if options.dry_run or not screen.json:  # the events of a run have them too
        show_faults(faults, adjusted, screen)
    with screen.phase("plan"):
        running = Environment() if left is None else left.running
        failures = () if left is None else left.failures
        preview = first_review(adjusted, settings, matches, running, screen.warn, faults, failures)
    found = preview.findings.found
    reasons = () if found is None else found.plan.reasons.values()
    for warning in preview.findings.warnings:
        if (options.dry_run or options.strict) and warning not in (*known, *reasons):
            screen.warn(warning)
    return FirstPlan(adjusted, preview, () if left is None else left.ended, faults)


def _differing(said: Environment | None) -> Callable[[Environment], str] | None:
    """How units that run differ from those that a file says; None if it is not asked."""
    return None if said is None else partial(difference_text, said)


def _operate(
    options: argparse.Namespace, world: World, settings: Settings, screen: Screen, said: Environment | None
) -> Exit:
    from cfgplan_runtime.operating.operation import Operation

    with Interrupts() as interrupts:
        with screen.phase("start"):
            operation = Operation(world, Path(options.env), replace(settings, beside=partial(_beside, options)))
        with operation:
            interrupts.only_count()
            with screen.phase("plan and start units"):
                while not interrupts.count and not operation.begun.wait(_LIVE_LOOK_S):
                    pass
            operation.observe()
            if said is not None:
                screen.note(difference_text(said, operation.runtime.environment), style="")
            output = _output_for(screen, operation, plain=options.plain)
            with _page(options, operation) as url, output:
                if url is not None:
                    output.note(f"The page is at {url}")
                _hold(operation, output, interrupts, options.span)
        output.sum_up()
    if interrupts.count > 1:
        return Exit.INTERRUPTED
    if operation.failure:
        return Exit.INTERNAL
    return Exit.OK if operation.all_met else Exit.UNMET


@contextmanager
def _beside(options: argparse.Namespace, operation: Operation) -> Iterator[None]:
    """Publish targets, and read topics of ROS, as the options ask for. Raises InputError."""
    published = run_targets.published(options, operation, folder_of(options))
    with published, facts_of_ros(options, operation), qualities_of_ros(options, operation):
        yield


@contextmanager
def _page(options: argparse.Namespace, operation: Operation) -> Iterator[str | None]:
    """Serve the page if an option says so, and give its address. Raises InputError."""
    if options.page is None:
        yield None
        return
    from cfgplan_runtime.operating.control_client import connect
    from cfgplan_runtime.page.server import PageServer

    with PageServer(lambda: connect(operation.id), port=options.page, allows_code=options.allow_code) as server:
        yield server.url


def difference_text(said: Environment, running: Environment) -> str:
    """Return the differences of the running units from the file's, ignoring ids."""
    from cfgplan.cli.plan_text import changes_text

    changes = said.change_to(with_declared_ids(said, running))
    if not changes:
        return "The running units are those of `units:`."
    return f"Changes from `units:` to the running units:\n{changes_text(said, changes).plain.rstrip()}"


def with_declared_ids(said: Environment, running: Environment) -> tuple[ComputationUnit, ...]:
    """Return the running units, each with the id of a declared unit of its transformation and host, if one is left."""
    left = dict(said.unit)
    names: dict[str, str] = {}
    for same_id in (True, False):
        for unit in (unit for unit in running.units if unit.id not in names):
            alike = (
                one.id for one in left.values() if _kind(one) == _kind(unit) and (one.id == unit.id or not same_id)
            )
            if (name := min(alike, default=None)) is not None:
                names[unit.id] = name
                del left[name]
    taken = {*said.unit, *names.values()}
    for unit in (unit for unit in running.units if unit.id not in names):
        names[unit.id] = unit.id if unit.id not in taken else f"{unit.id} (runs)"
    return tuple(
        replace(
            unit,
            id=names[unit.id],
            subscriptions=tuple(
                replace(one, stream=replace(one.stream, unit=names.get(one.stream.unit, one.stream.unit)))
                for one in unit.subscriptions
            ),
        )
        for unit in running.units
    )


def _kind(unit: ComputationUnit) -> tuple[str, str | None, bool]:
    return unit.transformation, unit.host, unit.standby


def _output_for(screen: Screen, operation: Operation, *, plain: bool) -> RunOutput:
    """JSON lines with `--json`, lines of text where stdout is no terminal, else the live view."""
    if screen.json:
        return JsonLines(screen, operation)
    if plain or not sys.stdout.isatty() or os.environ.get("TERM") in (None, "", "dumb"):
        return Lines(screen, operation)
    from cfgplan.cli.run_picture import LiveView

    return LiveView(screen, operation)


def _hold(operation: Operation, output: RunOutput, interrupts: Interrupts, span_s: float | None) -> None:
    """Show events until the time is over or the run is stopped."""
    end = None if span_s is None else time.monotonic() + span_s
    while not operation.wait(0) and not interrupts.count and (end is None or time.monotonic() < end):
        output.update(_LIVE_LOOK_S if end is None else max(0.0, min(_LIVE_LOOK_S, end - time.monotonic())))
    if not operation.wait(0):
        output.note("stopping ...")
        operation.observe()
        operation.stop()
        while not operation.wait(0) and interrupts.count < 2:
            output.update(_LIVE_LOOK_S)
    if interrupts.count > 1:
        operation.stop_at_once()
    output.update(0.0)


def _adjusted(options: argparse.Namespace, world: World) -> World:
    """Return the world with the horizon and the largest cost of the options; applied at each reading of the file."""
    asked = {"horizon_s": options.horizon, "max_cost_us": options.max_cost}
    return replace(world, **{name: value for name, value in asked.items() if value is not None})


def _estimates_file(options: argparse.Namespace) -> Path:
    """The file of estimates. A damaged one is renamed, so files of other kinds are refused. Raises InputError."""
    from cfgplan_runtime.estimating.estimates_file import default_file, has_other_content

    if options.estimates is None:
        return default_file(Path(options.env))
    path = Path(options.estimates)
    if path.suffix != ".json":
        mend = f"name a file of its own, such as {path.stem or 'estimates'}.json"
        raise InputError.of("the name of a file of estimates must end in .json", file=str(path), mend=mend)
    if path.is_file() and has_other_content(path):
        mend = "name a file of its own, such as estimates.json"
        raise InputError.of("this file has other content than estimates", file=str(path), mend=mend)
    return path


def _settings(options: argparse.Namespace, screen: Screen) -> Settings:
    from cfgplan_runtime.lifecycle.back_off import BackOffRules
    from cfgplan_runtime.lifecycle.policy import Policy
    from cfgplan_runtime.operating.operation import Settings

    from cfgplan import api

    kept = _estimates_file(options)
    return Settings(
        planner=None if options.planner is None else partial(api.plan, planner=options.planner),
        estimator=options.estimator,
        guess=options.guess,
        estimates=None if options.no_estimates else kept,
        policy=Policy(
            time_limit_s=Policy().time_limit_s if options.timeout is None else options.timeout,
            match_limit_s=options.reasoner_timeout,
            reasoner=options.reasoner,
            hosts_s=None if fleet_of(options) is None else _HOSTS_S,
            refuses_hosts=fleet_of(options) is None,
            back_off=BackOffRules(alone_s=options.back_off),
        ),
        preload=options.preload,
        log=None if options.log is None else Path(options.log),
        record=None if options.record is None else Path(options.record),
        metrics_port=options.metrics_port,
        runtime=runtime_of(options, screen),
        adjust=partial(_adjusted, options),
        check=source_check_of(options),
        reloads=options.reload,
        use_cache=not options.no_cache,
        name=options.name,
    )
