"""`cfgplan ctl`: steer a run that is under way."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cfgplan.canonical import normal
from cfgplan.cli import ctl_views
from cfgplan.cli import options as shared
from cfgplan.cli.agent import add_links, reached
from cfgplan.cli.exits import Exit
from cfgplan.cli.screen import Screen
from cfgplan.domain import Environment
from cfgplan.errors import Fault, InputError

if TYPE_CHECKING:
    from cfgplan_runtime.operating.control_client import Control
    from cfgplan_runtime.operating.protocol import RefusedError

_DONE = "Done."
_CTL_EXAMPLE = """\
example:
  cfgplan ctl state
  cfgplan ctl add robot2.yaml          # the individuals, transformations and targets of a robot
  cfgplan ctl withdraw robot2
  cfgplan ctl remove-target ball
  cfgplan ctl kill camera.1            # it is replaced at once
  cfgplan ctl restart camera.1         # starts its present code; if that fails, the old unit stays
  cfgplan ctl fact visibility=1.5      # transformations may require it
  cfgplan ctl observed --out now.json  # for `cfgplan solve --observed now.json`
  cfgplan ctl review
  cfgplan ctl plan --out plan.json     # what `review` would do now
  cfgplan ctl why camera.1
  cfgplan ctl logs camera --follow     # output of all units of camera, also of ended ones
  cfgplan ctl events                   # the last events, then new ones; --since 10m: only past ones
  cfgplan ctl topics                   # publisher, rate and age of each
  cfgplan ctl hz /result               # rate and jitter of a topic
  cfgplan ctl --name robot state       # of the run that `cfgplan run --name robot` has started
  cfgplan ctl apply plan.json          # refused if something has changed since
  cfgplan ctl stop
  cfgplan ctl state --connect tls/10.0.0.3:7447 --certificates /etc/cfgplan/manager      # from another computer

Additions stay until they are withdrawn or the run ends, also if the environment file changes.
Exit codes: 0 done, 12 done but a target is not met, 30 refused, failed and undone, or no run is live."""


@dataclass(frozen=True)
class _Command:
    """A command with at most one operand, and the method of the control protocol that it calls."""

    name: str
    says: str
    operand: str = ""
    means: str = ""
    method: str = ""
    key: str = ""


_COMMANDS = (
    _Command("state", "show targets, units, reviews and additions"),
    _Command(
        "add",
        "add the individuals, transformations and targets of a file, under its name",
        "FILE",
        "file in YAML or JSON; - reads standard input",
    ),
    _Command("withdraw", "remove all that `add` added under a name", "NAME", "the name", "withdraw", "name"),
    _Command("remove-target", "remove a target", "LABEL", "label of the target", "remove_target", "label"),
    _Command(
        "remove-transformation",
        "remove a transformation",
        "LABEL",
        "label of the transformation",
        "remove_transformation",
        "label",
    ),
    _Command(
        "remove-individual", "remove an individual", "NAME", "name of the individual", "remove_individual", "name"
    ),
    _Command("restore", "undo a removal", "NAME", "label or name of what was removed", "restore", "name"),
    _Command(
        "kill",
        "kill a unit's process at once; the run replaces it",
        "UNIT",
        "id of the unit, such as camera.1",
        "kill",
        "unit",
    ),
    _Command(
        "restart",
        "replace a unit by a new one without a gap",
        "UNIT",
        "id of the unit, such as camera.1",
        "restart",
        "unit",
    ),
    _Command("lose-host", "take a host out of service", "HOST", "name of the host", "lose_host", "host"),
    _Command("regain-host", "take a host into service again", "HOST", "name of the host", "regain_host", "host"),
    _Command("fact", "set the value of a fact", "NAME=VALUE", "the fact and its value, such as visibility=1.5"),
    _Command("observed", "show the observed facts, and the qualities that streams report and the run has learned"),
    _Command("review", "plan now, without waiting for the horizon, and carry the plan out", method="review"),
    _Command("plan", "show what `review` would do now, and change nothing"),
    _Command(
        "why",
        "say why a unit runs and how much more a plan without it costs",
        "UNIT",
        "id of the unit, such as camera.1",
    ),
    _Command(
        "logs",
        "print the output of a unit",
        "UNIT",
        "id of a unit, or label of a transformation for all of its units, also ended ones",
    ),
    _Command(
        "apply",
        "carry out a plan that was made for the running configuration",
        "FILE",
        "plan saved by `ctl plan --out`",
    ),
    _Command("events", "print the last events, then new ones as they happen"),
    _Command("topics", "list topics of targets and streams of units, with publisher, rate and age"),
    _Command(
        "hz",
        "measure the rate and jitter of a topic, or the rate of a unit or stream",
        "NAME",
        "a topic or stream as `topics` lists it, or the id of a unit",
    ),
    _Command("socket", "print the path of the run's control socket, for other programs"),
    _Command("stop", "stop the run; units may finish first"),
)

NAMES = tuple(command.name for command in _COMMANDS)
"""The commands for a live run."""


def add_to(parser: argparse.ArgumentParser) -> None:
    parser.epilog = _CTL_EXAMPLE
    which = "name (of `cfgplan run --name`) or id of the run; needed if several are live"
    shared.add_run(parser, which)
    add_links(parser)
    shared.add_json(parser)
    parser.set_defaults(run=run)
    commands = parser.add_subparsers(metavar="COMMAND", dest="command", required=True)
    for command in _COMMANDS:
        each: argparse.ArgumentParser = commands.add_parser(
            command.name, help=command.says, description=command.says[0].upper() + command.says[1:] + "."
        )
        # Also behind the command, where people put them; absent there, what stands before it holds.
        spelled = ("-n", "--run") if command.name == "add" else ("--name", "-n", "--run")
        each.add_argument(
            *spelled, dest="run_id", metavar="NAME", default=argparse.SUPPRESS, help="name or id of the run"
        )
        add_links(each, default=argparse.SUPPRESS)
        each.add_argument(
            "--json", action="store_true", default=argparse.SUPPRESS, help="print JSON for programs instead of text"
        )
        if command.operand:
            kinds: dict[str, Callable[[str], Any]] = {"FILE": str, "NAME=VALUE": _fact}
            kind = kinds.get(command.operand, normal)
            each.add_argument("operand", type=kind, metavar=command.operand, help=command.means)
        if command.name == "add":
            under = "name of the addition, for `withdraw` (default: the file's name without ending)"
            each.add_argument("--name", dest="added_as", type=normal, metavar="NAME", help=under)
        if command.name in ("plan", "observed"):
            shared.add_out(each)
        if command.name in ctl_views.OPTIONS:
            ctl_views.OPTIONS[command.name](each)
        if command.method or command.name in ("add", "fact", "plan", "why", "apply"):
            shared.add_time(
                each, "--wait", 60.0, "how long to wait until the change is planned and carried out (default: 60s)"
            )


def _fact(text: str) -> tuple[str, str]:
    return shared.setting(text, "NAME=VALUE", "night=true")


def run(options: argparse.Namespace, screen: Screen) -> Exit:
    from cfgplan_runtime.operating.control_client import connect
    from cfgplan_runtime.operating.protocol import RefusedError

    text = _read(options.operand) if options.command in ("add", "apply") else None
    with reached(options) as fleet, connect(options.run_id, fleet) as control:
        options.fleet = fleet
        try:
            match options.command:
                case "state":
                    return _state(control, screen)
                case "events" | "logs" | "topics" | "hz":
                    return ctl_views.VIEWS[options.command](control, screen, options)
                case "socket":
                    return _socket(control, screen)
                case "stop":
                    return _stop(control, screen)
                case "add":
                    name = options.added_as or _name(options.operand)
                    params = {"name": name, "text": text}
                    return _change(control, screen, "add", params, f"Added {name}.", options.wait)
                case "fact":
                    params = dict(zip(("name", "value"), options.operand, strict=True))
                    return _change(control, screen, "fact", params, _DONE, options.wait)
                case "observed":
                    return _observed(control, screen, options)
                case "plan":
                    return _plan(control, screen, options)
                case "why":
                    reply = control.call("why", timeout_s=options.wait + 10, unit=options.operand, wait_s=options.wait)
                    screen.show_json(reply) if screen.json else screen.show("\n".join(reply["says"]))
                    return Exit.OK
                case "apply":
                    params = {"name": options.operand, "text": text}
                    return _change(control, screen, "apply", params, _DONE, options.wait)
            command = next(command for command in _COMMANDS if command.name == options.command)
            params = {command.key: options.operand} if command.key else {}
            return _change(control, screen, command.method, params, _DONE, options.wait)
        except RefusedError as error:
            raise InputError(_faults(error, options)) from None


def _state(control: Control, screen: Screen) -> Exit:
    from cfgplan.cli.run_picture import state_text

    state, system = control.call("state", timeout_s=60), control.system
    if screen.json:
        screen.show_json(
            {"run": control.system.run, "name": control.system.name, "environment": control.system.environment, **state}
        )
    else:
        system = control.system
        screen.show(state_text(system.name or system.run, Path(system.environment).name, system.pid, state))
    return _met(target["met"] for target in state["targets"])


def _socket(control: Control, screen: Screen) -> Exit:
    if control.path is None:
        mend = "ask on the computer where `cfgplan run` is"
        raise InputError.of(f"the socket of run {control.system.run} is on another computer", mend=mend)
    if screen.json:
        screen.show_json({"run": control.system.run, "socket": str(control.path)})
    else:
        screen.write(f"{control.path}\n")
    return Exit.OK


def _stop(control: Control, screen: Screen) -> Exit:
    control.subscribe()
    control.call("stop", timeout_s=60)
    for _ in control.events():
        pass
    if screen.json:
        screen.show_json({"stopped": control.system.run})
    else:
        screen.show(f"Run {control.system.run} has stopped.")
    return Exit.OK


def _observed(control: Control, screen: Screen, options: argparse.Namespace) -> Exit:
    """Show, or write to a file, the facts and qualities that plans of the run go by."""
    from cfgplan.cli.run_picture import observed_text as text_of
    from cfgplan.formats.observed_file import observed_text

    state = control.call("state", timeout_s=60)
    document = observed_text(state["facts"], state["qualities"])
    if options.out:
        shared.put(document, options.out, screen)
    if screen.json:
        screen.write(document)
    elif not options.out:
        screen.show(text_of(state))
    return Exit.OK


def _plan(control: Control, screen: Screen, options: argparse.Namespace) -> Exit:
    reply = control.call("plan", timeout_s=options.wait + 10, wait_s=options.wait)
    document = json.dumps(reply["plan"], indent=2, ensure_ascii=False) + "\n"
    if options.out:
        shared.put(document, options.out, screen)
    if screen.json:
        screen.write(document)
    else:
        from cfgplan.cli.plan_text import changes_text
        from cfgplan.formats.dump import changes_of, unit_of

        if changes := reply["plan"]["change_set"]:
            running = Environment(tuple(map(unit_of, reply["running"])))
            screen.show(changes_text(running, changes_of(changes)))
        screen.show(reply["says"])
    return _met(not reason for reason in reply["unmet"].values())


def _change(control: Control, screen: Screen, method: str, params: dict[str, Any], done: str, wait_s: float) -> Exit:
    reply = control.call(method, timeout_s=wait_s + 10, wait_s=wait_s, **params)
    review = reply["review"]
    if screen.json:
        screen.show_json(reply)
    elif reply["is_waiting"]:
        screen.show(f"{done} The review is not over yet; see `cfgplan ctl state`.")
    elif review is None:
        screen.show(f"{done} That changes nothing.")
    else:
        is_done = review["decision"] != "failed" or done != _DONE
        screen.show("\n".join([done] * is_done + [review["says"]]))
    if review is not None and review["decision"] == "failed":
        return Exit.BAD_INPUT
    return Exit.OK if review is None else _met(not reason for reason in review["unmet"].values())


def _met(targets: Iterable[bool]) -> Exit:
    return Exit.OK if all(targets) else Exit.UNMET


def _read(file: str) -> str:
    from cfgplan.formats.files import read_text

    return sys.stdin.read() if file == "-" else read_text(Path(file))


def _name(file: str) -> str:
    return "stdin" if file == "-" else Path(file).stem


def _faults(error: RefusedError, options: argparse.Namespace) -> Iterable[Fault]:
    """The faults with the path of the file that was added; the run knows it only by name."""
    if not error.faults:
        return [Fault(error.message, mend=error.mend)]
    if options.command != "add":
        return error.faults
    name = options.added_as or _name(options.operand)
    return [replace(fault, file=options.operand) if fault.file == name else fault for fault in error.faults]
