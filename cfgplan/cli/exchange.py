"""`cfgplan import` and `cfgplan export`: environment files from the formats of other programs, and to them."""

from __future__ import annotations

import argparse
import shlex
from dataclasses import replace
from functools import partial
from os.path import relpath
from pathlib import Path
from typing import TYPE_CHECKING

from cfgplan.amounts import span
from cfgplan.cli import options as shared
from cfgplan.cli.broker import add_connection, connection
from cfgplan.cli.exits import OF_STATUS, Exit
from cfgplan.cli.screen import Screen
from cfgplan.errors import InputError

if TYPE_CHECKING:
    from cfgplan.formats.imported import ImportedSources
    from cfgplan.ros.graph import RosGraph

_LISTEN_S = 10.0


def add_import(parser: argparse.ArgumentParser) -> None:
    parser.epilog = (
        "example:\n"
        "  cfgplan import xml specifications/ --out env.yaml\n"
        "  cfgplan import wsc wsc08/set01 --out set01.yaml\n"
        "  cfgplan import ros1 live --out robot.yaml\n"
        "  cfgplan import ros2 live --out robot.yaml\n"
        "  ros2 node info /camera | cfgplan import ros2 - --out robot.yaml\n"
        "  cfgplan import ros1 robot.launch sim:=true drive.bag --out robot.yaml\n"
        "  cfgplan import mqtt localhost --for 1m --out house.yaml\n"
        "  cfgplan import wot lamp.td.json thermostat.td.json --out house.yaml"
    )
    parser.add_argument("what", choices=("xml", "wsc", "ros1", "ros2", "mqtt", "wot"), help="the kind of source")
    parser.add_argument(
        "path",
        metavar="PATH",
        nargs="+",
        help="xml: one file, or a folder of files. wsc: the folder of a test set. "
        "ros1: `live` for the master of ROS_MASTER_URI, the address of a master, a launch file and its arguments "
        "(NAME:=VALUE), the output of `rosnode info` (FILE.txt, or `-` for standard input), or bags. "
        "ros2: `live`, a launch file in XML or YAML and its arguments, the output of `ros2 node info` and "
        "`ros2 topic info -v` (FILE.txt, or `-`), or recordings (bags, MCAP). ros1 and ros2 join several PATHs. "
        "mqtt: a broker, as HOST, HOST:PORT, mqtt://HOST:PORT, or mqtts://HOST:PORT for TLS. "
        "wot: Thing Descriptions of the W3C (JSON)",
    )
    parser.add_argument(
        "--objective",
        choices=("services", "length"),
        help="wsc: minimise the number of services, or first the length of the composition and then their number "
        "(default: services)",
    )
    shared.add_several(
        parser,
        "--guesses",
        "FILE",
        "ros1, ros2: a table of what you know of types, topics and nodes, "
        "used instead of guesses; see `cfgplan help ros`; may be repeated",
    )
    parser.add_argument(
        "--works",
        action="store_true",
        help="ros1, ros2: take the graph as correct: "
        "inputs without a publisher become optional, and a topic may have several publishers",
    )
    python = (
        "ros2 live: the Python with rclpy (default: CFGPLAN_ROS_PYTHON, the Python of a sourced setup.bash, or python3)"
    )
    parser.add_argument("--ros-python", metavar="PYTHON", help=python)
    _add_mqtt(parser)
    context = "wot: read the JSON-LD context URL from FILE, since contexts are never fetched; may be repeated"
    shared.add_several(parser, "--context", "URL=FILE", context, kind=_context)
    shared.add_out(parser)
    parser.set_defaults(run=_import)


def _import(options: argparse.Namespace, screen: Screen) -> Exit:
    from cfgplan import api

    is_ros = options.what in ("ros1", "ros2")
    given = {"--objective": options.objective and options.what != "wsc"}
    given |= {"--ros-python": options.ros_python and options.what != "ros2"}
    given |= {"--guesses": options.guesses and not is_ros, "--works": options.works and not is_ros}
    given |= {"--context": options.context and options.what != "wot"}
    given |= {f"--{name.replace('_', '-')}": value for name, value in _of_mqtt(options) if options.what != "mqtt"}
    if foreign := [name for name, is_foreign in given.items() if is_foreign]:
        raise InputError.of(
            f"{', '.join(foreign)}: `import {options.what}` does not take this option", mend="leave it out"
        )
    _refuse_ending(options.out, "yaml")
    if is_ros:
        return _import_ros(options, screen)
    if options.what == "wot":
        return _import_wot(options, screen)
    path, *more = options.path
    if more:
        one = "broker" if options.what == "mqtt" else "file or folder"
        raise InputError.of(f"`import {options.what}` takes one path", file=more[0], mend=f"name one {one}")
    if options.what == "mqtt":
        return _import_mqtt(path, options, screen)
    if options.what == "xml":
        shared.put(api.converted(path, "yaml"), options.out, screen)
        return Exit.OK
    from cfgplan.formats.wsc import wsc_texts
    from cfgplan.formats.wsc_files import unread

    ontology = _beside(options.out, "this import writes two files, the environment and its ontology", ".ofn")
    environment_text, ontology_text = wsc_texts(path, options.objective or "services", ontology=ontology.name)
    shared.put(ontology_text, str(ontology), screen)
    shared.put(environment_text, options.out, screen)
    if dropped := unread(Path(path)):
        screen.warn(f"not read: {', '.join(dropped)}; costs are the number of services, concepts those of taxonomy.xml")
    return Exit.OK


def _add_mqtt(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("mqtt", "the written file gets the options of the connection too")
    shared.add_span(group, f"how long to listen, such as 10s or 1m (default: {_LISTEN_S:g}s)")
    shared.add_several(
        group,
        "--topic",
        "FILTER",
        "listen only to this topic filter, such as house/#; may be repeated (default: all topics)",
    )
    add_connection(group)


def _of_mqtt(options: argparse.Namespace) -> list[tuple[str, object]]:
    """Return the options given to `import mqtt`, as names and values."""
    given = [("for", options.span), ("topic", options.topic), *connection(options).items()]
    return [(name, value) for name, value in given if value]


def _import_mqtt(broker: str, options: argparse.Namespace, screen: Screen) -> Exit:
    from cfgplan_runtime.mqtt.listening import Listening
    from rich.table import Table

    from cfgplan.mqtt.environments import mqtt_imported

    ontology = _beside(options.out, "this import writes two files, the environment and its ontology", ".ttl")
    params = connection(options)
    span_s = _LISTEN_S if options.span is None else options.span
    listening = Listening(broker, options.topic or ("#",), **params)
    screen.note(f"Listening for {span_s:g} s.")
    with screen.phase("listen"):
        traffic = listening.traffic(span_s)
    found = mqtt_imported(traffic, {"broker": broker, **params})
    shown = Table("topic", "field", "payload", "every", "retained", "tag", box=None, pad_edge=False)
    for source in found.sources:
        period_s, path = source.topic.period_s, ".".join(map(str, source.path))
        every = "" if period_s is None else span(period_s)
        kept = "yes" if source.topic.is_retained else "no"
        shown.add_row(source.topic.name, path, source.topic.form, every, kept, source.tag)
    screen.show(shown)
    return _written(found, ontology, options, screen)


def _written(found: ImportedSources, ontology: Path, options: argparse.Namespace, screen: Screen) -> Exit:
    """Write the two files of an import, and tell the user what is left to do."""
    shared.put(found.ontology, str(ontology), screen)
    shared.put(found.text(ontology.name), options.out, screen)
    for note in found.notes:
        screen.warn(f"not imported: {note}")
    for hint in found.hints:
        screen.note(f"hint: {hint}")
    screen.note(f"{found.size}. It has no targets yet: the head of {options.out} shows how to add them.")
    return Exit.OK


def _context(text: str) -> tuple[str, Path]:
    """A context's URL and the file that stands for it."""
    url, sign, file = text.rpartition("=")
    if not (url and sign and file):
        raise argparse.ArgumentTypeError(f"{text!r} is not URL=FILE")
    return url, Path(file)


def _import_wot(options: argparse.Namespace, screen: Screen) -> Exit:
    from cfgplan.wot.environments import wot_imported

    ontology = _beside(options.out, "this import writes two files, the environment and its ontology", ".ttl")
    return _written(wot_imported(map(Path, options.path), dict(options.context)), ontology, options, screen)


def _beside(out: str | None, message: str, ending: str) -> Path:
    """The ontology file beside the environment file that `--out` names. Raises InputError if it names none."""
    if out is None:
        raise InputError.of(message, mend="name the environment file with --out; the ontology is written beside it")
    return Path(out).with_suffix(ending)


def _refuse_ending(out: str | None, kind: str) -> None:
    """Raise InputError for a file whose ending would have it read as something else than an environment in `kind`."""
    ending = "" if out is None else Path(out).suffix.lower()
    if out is not None and (ending != ".xml" if kind == "xml" else ending in (".xml", ".json", ".ttl", ".ofn")):
        raise InputError.of(f"this name does not end as {kind.upper()} does", file=out, mend=f"end it in .{kind}")


def _import_ros(options: argparse.Namespace, screen: Screen) -> Exit:
    from rich.table import Table

    from cfgplan.ros.environments import imported
    from cfgplan.ros.guesses import guess_table
    from cfgplan.ros.origins import ros1_graph, ros2_graph

    ontology = _beside(options.out, "this import writes two files, the environment and its ontology", ".ttl")
    table = guess_table(map(Path, options.guesses))
    with screen.phase("read"):
        graph = (
            ros1_graph(options.path) if options.what == "ros1" else ros2_graph(options.path, partial(_live, options))
        )
    found = imported(graph, table, works=options.works, keeps_topics=options.what == "ros2")
    shared.put(found.ontology, str(ontology), screen)
    shared.put(found.text(ontology.name), options.out, screen)
    if found.guesses:
        shown = Table("of", "guessed", "why", box=None, pad_edge=False)
        for guess in found.guesses:
            shown.add_row(guess.about, guess.guess, guess.why)
        screen.show(shown)
    for note in found.graph.notes:
        screen.warn(f"unknown: {note}")
    for each in found.graph.dropped:
        screen.warn(f"not imported: {each}")
    screen.note(f"{found.size}. `cfgplan check {shlex.quote(options.out)}` lists its faults.")
    return Exit.OK


def _live(options: argparse.Namespace) -> RosGraph:
    """The graph of a running ROS 2 system."""
    from cfgplan_runtime.ros2.live_graph import live_graph

    return live_graph(options.ros_python)


def add_export(parser: argparse.ArgumentParser) -> None:
    parser.epilog = (
        "example:\n"
        "  cfgplan export schema --out cfgplan.schema.json\n"
        "  cfgplan export xml models/nao/1-piff-registered.yaml --out nao.xml\n"
        "  cfgplan export launch robot.yaml --out robot.launch.py"
    )
    parser.add_argument(
        "what",
        choices=("schema", "xml", "yaml", "launch"),
        help="the format to write; launch: a ROS 2 launch file that starts the configuration after the optimal update",
    )
    parser.add_argument("env", metavar="ENV", nargs="?", help="environment file; leave it out for schema")
    launch = parser.add_argument_group("launch")
    launch.add_argument("--plan", metavar="FILE", help="a plan saved by `cfgplan solve --out FILE` (default: plan now)")
    launch.add_argument(
        "--only",
        choices=("nodes", "components"),
        help="write only the nodes, or only the containers with their components (default: both)",
    )
    include = "another launch file to include, such as one of drivers, as FILE or 'FILE NAME:=VALUE'; may be repeated"
    shared.add_several(launch, "--include", "FILE", include)
    launch.add_argument(
        "--host", metavar="NAME", help="write only the units of this host; needed if the file has hosts"
    )
    shared.add_what_if(parser, "only for `export launch`")
    shared.add_out(parser)
    parser.set_defaults(run=_export)


def _export(options: argparse.Namespace, screen: Screen) -> Exit:
    from cfgplan import api

    of_launch = options.plan or options.only or options.host or options.include or shared.asks_what_if(options)
    if options.what != "launch" and of_launch:
        raise InputError.of(
            "--plan, --only, --include, --host, --without, --with, --set and --observed are only for `export launch`",
            mend="write `cfgplan export launch ENV`",
        )
    if options.what == "schema":
        if options.env is not None:
            raise InputError.of("the schema is the same for all files", file=options.env, mend="leave the file out")
        shared.put(api.schema_text(), options.out, screen)
        return Exit.OK
    if options.env is None:
        raise InputError.of("no environment file is named", mend=f"write `cfgplan export {options.what} ENV`")
    if options.what == "launch":
        return _export_launch(options, screen)
    _refuse_ending(options.out, options.what)
    shared.put(api.converted(options.env, options.what), options.out, screen)
    return Exit.OK


def _export_launch(options: argparse.Namespace, screen: Screen) -> Exit:
    from cfgplan import __version__, api
    from cfgplan.ros.launch import IncludedLaunch, launch_text

    world = shared.load(options, screen)
    with screen.phase("plan"):
        if options.plan is None:
            problem, plan = api.solve(world)
        else:
            problem = api.match(world)
            plan = api.load_plan(world, problem, options.plan)
    if plan.change_set is None:
        words = shared.problem_words(options)
        screen.warn(f"there is no update to launch ({plan.status}): `cfgplan explain {words}` says why")
        return OF_STATUS[plan.status]
    about = [
        f"The configuration after the update of {Path(options.env).name} ({plan.status}), by cfgplan {__version__}.",
        "Edit that file and export it again: an export overwrites this one.",
    ]
    env = Path(options.env)
    folder = env if env.is_dir() else env.parent
    here = folder if options.out is None else Path(options.out).parent
    includes = [IncludedLaunch.read(each, str(here)) for each in options.include]
    try:
        text = launch_text(
            problem.after(plan),
            about,
            part=options.only or "all",
            host=options.host,
            folder=relpath(folder, here),
            includes=includes,
        )
    except InputError as error:
        raise InputError(fault if fault.file else replace(fault, file=options.env) for fault in error.faults) from None
    shared.put(text, options.out, screen)
    return Exit.OK
