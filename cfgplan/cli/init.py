"""`cfgplan init`: write a small environment to begin with, with its ontology and unit code."""

from __future__ import annotations

import argparse
import shlex
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

from cfgplan.cli.exits import Exit
from cfgplan.cli.screen import Screen
from cfgplan.errors import Fault, InputError, close_names

_START = Path(__file__).parents[1] / "manual" / "start"


class _Template(NamedTuple):
    """A folder of `manual/start`: its subject, and the commands to go on with, where `ENV` stands for its file."""

    subject: str
    next: tuple[str, ...]


_FIRST = "kitchen"
TEMPLATES: Mapping[str, _Template] = MappingProxyType(
    {
        _FIRST: _Template(
            "the tutorial's fire alarm, with two ways to a temperature",
            (
                "cfgplan solve ENV",
                "cfgplan solve ENV --without thermometer",
                "cfgplan run ENV",
                "cfgplan listen /fire          # in another terminal",
                "cfgplan help tutorial",
            ),
        ),
        "robot": _Template(
            "a robot that drives on the better of two positions, by their quality",
            (
                "cfgplan solve ENV",
                "cfgplan run ENV",
                "cfgplan listen /cmd_vel          # in another terminal; also cfgplan ctl observed",
                "cfgplan ctl kill scan_matcher.1",
                "cfgplan help observed",
            ),
        ),
        "building": _Template(
            "rooms with a thermostat each, by templates",
            (
                "cfgplan solve ENV",
                "cfgplan run ENV",
                "cfgplan listen /boiler          # in another terminal",
                "cfgplan help mqtt",
            ),
        ),
        "warehouse": _Template(
            "two robots and a base station, with spares for every unit",
            (
                "cfgplan solve ENV",
                "cfgplan run ENV --local          # needs the extra `fleet`",
                "cfgplan listen /map          # in another terminal",
                "cfgplan ctl kill merger.1",
                "cfgplan help hosts",
            ),
        ),
        "ros2": _Template(
            "nodes of ROS 2 that are started, wired and replaced",
            (
                "cfgplan solve ENV",
                "cfgplan run ENV --middleware ros2",
                "cfgplan help ros2_tutorial",
            ),
        ),
    }
)


def add_to(parser: argparse.ArgumentParser) -> None:
    parser.epilog = "templates:\n" + "".join(f"  {name:11}{each.subject}\n" for name, each in TEMPLATES.items())
    parser.epilog += "\nexample:\n  cfgplan init kitchen\n  cfgplan init myrobot --template robot"
    parser.add_argument(
        "folder", metavar="FOLDER", nargs="?", default=".", help="folder to write to (default: this folder)"
    )
    told = f"the environment to write, listed below (default: that of the folder's name, else {_FIRST})"
    parser.add_argument("--template", choices=list(TEMPLATES), metavar="NAME", help=told)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace, screen: Screen) -> Exit:
    from cfgplan import api

    folder = Path(options.folder)
    template = options.template or (folder.name if folder.name in TEMPLATES else _FIRST)
    start = sorted(path for path in (_START / template).iterdir() if path.is_file())
    there = [folder / path.name for path in start if (folder / path.name).exists()]
    if there:
        mend = "name another folder: nothing is overwritten"
        raise InputError([Fault("this file is there already", file=str(path), mend=mend) for path in there])
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        mend = "name a folder that exists or can be made"
        raise InputError.of(f"this folder can't be made: {error.strerror}", file=options.folder, mend=mend) from None
    for path in start:
        api.write_file(folder / path.name, path.read_bytes())
        if path.read_bytes().startswith(b"#!"):
            (folder / path.name).chmod(0o755)
    env = shlex.quote(str(folder / "env.yaml"))
    steps = "".join(f"  {step.replace('ENV', env)}\n" for step in TEMPLATES[template].next)
    if options.template is None and template != folder.name and (other := close_names(folder.name, TEMPLATES)):
        steps += f"This is the template `{template}`; `cfgplan init FOLDER --template {other[0]}` writes another one.\n"
    screen.write(f"Wrote {', '.join(str(folder / path.name) for path in start)}. Next:\n{steps}")
    return Exit.OK
