"""`cfgplan check`: faults of the running configuration, the most probable one first."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from cfgplan.cli import options as shared
from cfgplan.cli.exits import Exit
from cfgplan.cli.idle_words import idle_words
from cfgplan.cli.plan_text import left_out_lines, nothing_wanted, plain_barred
from cfgplan.cli.screen import Screen, append_excerpt, counted
from cfgplan.errors import Fault, did_you_mean
from cfgplan.summary import some

if TYPE_CHECKING:
    from cfgplan.api import World
    from cfgplan.cli.styled import Text
    from cfgplan.domain import Environment
    from cfgplan.explaining import WiringFault
    from cfgplan.formats.places import Place


def add_to(parser: argparse.ArgumentParser) -> None:
    parser.epilog = (
        "example:\n  cfgplan check models/nao/2-segmenter-lost.yaml\n  cfgplan check after.yaml --against before.yaml"
    )
    shared.add_environment(parser)
    parser.add_argument(
        "--against",
        metavar="OTHER",
        help="report only what is wrong in ENV but not in this file, such as ENV before a change",
    )
    shared.add_survive(parser)
    shared.add_what_if(parser)
    shared.add_matching(parser)
    shared.add_json(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace, screen: Screen) -> Exit:
    from cfgplan.explaining import Suspicion

    world, every, noisy = _faults(options, screen)
    faulty = [*shared.code_faults(world, world.environment.transformation), *shared.field_faults(world)]
    for warning in noisy:
        screen.warn(warning)
    for fault_of_file in (*faulty, *idle_words(world)):
        screen.warn_of(fault_of_file)
    if not world.environment.units and options.against is None:
        return _nothing_runs(options, world, screen, all_start=not faulty)
    found, gone = every, 0
    if options.against is not None:
        before = {fault.key for fault in _faults(options, screen, options.against)[1]}
        found = tuple(fault for fault in every if fault.key not in before)
        gone = len(before - {fault.key for fault in every})
    broken = [fault for fault in found if fault.breaks]
    is_open = bool(broken) and all(fault.violation is not None and fault.violation.is_open for fault in broken)
    untaken = [f"{fault.unit}/{fault.port}" for fault in found if fault.suspicion is Suspicion.UNTAKEN]
    if screen.json:
        is_valid = not any(fault.breaks for fault in every)
        told = {
            "valid": None if is_open else is_valid,
            "violations": [_as_json(world, fault) for fault in broken],
            "unfed": [_as_json(world, fault) for fault in found if fault.suspicion is Suspicion.PERHAPS],
            "untaken": untaken,
            "remaps": [_as_json(world, fault) for fault in found if fault.suspicion is Suspicion.REMAP],
            **_left_out(world),
        }
        screen.show_json(told if options.against is None else {**told, "against": options.against, "gone": gone})
    else:
        for fault in found:
            if fault.suspicion is not Suspicion.UNTAKEN:
                screen.show(_text(world, fault))
        if untaken:
            screen.show(f"{counted(len(untaken), 'stream')} without a subscriber: {some(untaken)}")
        for line in left_out_lines(world.environment):
            screen.show(line)
        screen.show(_verdict(options, world, broken, gone))
    if is_open:
        return Exit.NOT_PROVEN
    return Exit.INVALID if broken else Exit.OK


def _nothing_runs(options: argparse.Namespace, world: World, screen: Screen, *, all_start: bool) -> Exit:
    """Say that the file itself is valid, where it names no running units whose wiring could be wrong."""
    if screen.json:
        told = {"valid": True, "violations": [], "unfed": [], "untaken": [], "remaps": []}
        screen.show_json({**told, **_left_out(world)})
        return Exit.OK
    for line in left_out_lines(world.environment):
        screen.show(line)
    plans = f"`cfgplan solve {shared.problem_words(options)}` plans what to start"
    but, colour = ("", "green") if all_start else (", but the warnings say what to correct", "yellow")
    screen.show(_bold(world, f"the file is valid{but}. Nothing runs yet: {plans}", colour))
    if nothing := nothing_wanted(world.environment):
        screen.warn(nothing)
    return Exit.OK


def _left_out(world: World) -> dict[str, object]:
    """Return for JSON why transformations may not run for now, or not on some hosts; empty without any."""
    told = {"left_out": dict(world.environment.left_out), "barred": plain_barred(world.environment)}
    return {key: said for key, said in told.items() if said}


def _faults(
    options: argparse.Namespace, screen: Screen, env: str | None = None
) -> tuple[World, tuple[WiringFault, ...], tuple[str, ...]]:
    """Return the world of the file `env` (by default the file of the options), its faults, and its oddities: limits of
    observations, states that two units or none would save, and selectors that choose no host.
    """
    from cfgplan import answers, api
    from cfgplan.explaining import probable_first
    from cfgplan.observed import hidden
    from cfgplan.observers import blurred
    from cfgplan.planners.undecided import used_pairs
    from cfgplan.ros.hearing import ros_faults
    from cfgplan.shared_states import double_owners, shared_states

    world = shared.load(options, screen, env)
    matches = shared.matches(options, screen, world, api.FEW_PAIRS)
    with screen.phase("match"):
        matches.decide([*used_pairs(world.environment, matches.similarity)])
    problem = shared.problem(options, screen, world, matches)
    with screen.phase("judge"):
        reasoning = {"reasoner": options.reasoner, "reasoner_limit_s": options.reasoner_timeout}
        found = answers.wiring_faults(world, problem, **reasoning)
        noisy = (*blurred(world.environment, problem.similarity), *hidden(world.environment, problem.similarity))
        noisy = (*noisy, *double_owners(world.environment), *shared_states(problem))
        noisy = (*noisy, *_idle(world.environment))
        return world, tuple(sorted([*ros_faults(world.environment), *found], key=probable_first)), noisy


def _idle(environment: Environment) -> Iterator[str]:
    """Yield a warning for each selector that chooses none of the declared hosts, and so has no effect."""
    if not environment.hosts:
        return
    names = {name for host in environment.hosts for name in (host.name, *host.labels)}

    def told(text: str) -> str:
        meant = did_you_mean(text, names)
        return f"no host fits `{text}`" + (f" ({meant})" if meant else "")

    def is_idle(text: str) -> bool:
        return not any(host.fits(text) for host in environment.hosts)

    for link in environment.links:
        ends = " and ".join(map(repr, link.between))
        yield from (f"{told(end)}: the link between {ends} has no effect" for end in link.between if is_idle(end))
    for each in environment.library:
        yield from (f"{told(end)}: it limits no units of {each.label}" for end in each.at_most if is_idle(end))
        if each.on is not None and is_idle(each.on):
            yield f"{told(each.on)}: {each.label} can't run on any host"


def _text(world: World, fault: WiringFault) -> Text:
    from cfgplan.cli.styled import Text

    line = Text(f"{_place(world, fault)}: ", style="bold")
    line.append(f"{fault.rule}: ", style="red" if fault.breaks else "yellow")
    line.append(fault.text, style="not bold")
    if (place := _written(world, fault)) is not None:
        append_excerpt(line, Fault(fault.text, *place), "red" if fault.breaks else "yellow")
    for near in fault.near:
        line.append(f"\n    nearest: {near.stream} gives {near.verdict}", style="not bold")
    return line


def _verdict(options: argparse.Namespace, world: World, broken: Sequence[WiringFault], gone: int) -> Text:
    sure = [fault for fault in broken if fault.violation is None or not fault.violation.is_open]
    if options.against is not None:
        new = counted(len(broken), "rule") if broken else "no rule"
        mended = f"; {counted(gone, 'fault is', 'faults are')} mended" if gone else ""
        what = f"the running configuration violates {new} that held in {options.against}{mended}"
        return _bold(world, what, "red" if broken else "green")
    if sure:
        return _bold(world, f"the running configuration violates {counted(len(sure), 'rule')}", "red")
    if broken:
        return _bold(world, "it is not decided whether the running configuration is valid", "yellow")
    return _bold(world, "the running configuration is valid", "green")


def _bold(world: World, verdict: str, colour: str) -> Text:
    """Return a verdict after the number of parts checked."""
    from cfgplan.cli.styled import Text

    environment = world.environment
    size = ", ".join(
        [
            counted(len(environment.library), "transformation"),
            counted(len(environment.units), "running unit"),
            counted(len(environment.targets), "target"),
        ]
    )
    return Text(f"{size}: {verdict}.", style=f"bold {colour}")


def _as_json(world: World, fault: WiringFault) -> dict[str, object]:
    violation = fault.violation
    return {
        "rule": fault.rule,
        "text": fault.text,
        "unit": fault.unit,
        "port": fault.port,
        "target": violation.target if violation else None,
        "undecided": violation is not None and violation.is_open,
        "place": _place(world, fault),
        "nearest": [
            {
                "stream": str(near.stream),
                "offered": near.offer.offered,
                "missing": near.offer.missing,
                "taken": near.is_taken,
            }
            for near in fault.near
        ],
    }


def _place(world: World, fault: WiringFault) -> str:
    """Where the unit or target of a fault is written, as `file:line:column`."""
    place = _written(world, fault)
    return ":".join(map(str, place)) if place else str(world.file.path if world.file else "environment")


def _written(world: World, fault: WiringFault) -> Place | None:
    """Where the unit or target of a fault is written; None if nowhere."""
    file, target = world.file, fault.violation.target if fault.violation else None
    return file.place(unit=fault.unit, port=fault.port, target=target) if file else None
