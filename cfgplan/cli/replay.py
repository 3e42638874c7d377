"""`cfgplan replay`: the topics of a recording as sources, alone or for the units of an environment."""

from __future__ import annotations

import argparse
import re
import shlex
import tempfile
import time
from collections.abc import Iterable, Mapping
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from cfgplan.cli import options as shared
from cfgplan.cli.exits import Exit
from cfgplan.cli.screen import Screen, counted
from cfgplan.domain import OutputPort, Target, Transformation
from cfgplan.errors import Fault, InputError, did_you_mean
from cfgplan.summary import some

if TYPE_CHECKING:
    from cfgplan_runtime.operating.recorded import Recorded

    from cfgplan.api import World
    from cfgplan.planning import Problem

_REPLAY_EXAMPLE = """\
example:
  cfgplan replay run.mcap                           # plays its topics, for `cfgplan listen`
  cfgplan replay run.mcap detector.yaml --speed 4   # its topics feed the units of detector.yaml
  cfgplan replay run.mcap --out recorded.yaml       # sources to include, or for `cfgplan ctl add`
  cfgplan replay run.mcap --extract again           # the run's environment: plan it, run it again

Exit codes: those of `cfgplan run`."""
_BEGINS_S = 3.0
"""Seconds that sources are given to start before the recording begins."""
_LABOR_US, _UPKEEP_US = 1_000, 100


def add_to(parser: argparse.ArgumentParser) -> None:
    parser.epilog = _REPLAY_EXAMPLE
    parser.add_argument("path", metavar="FILE", help="recording made by `cfgplan run --record` (MCAP)")
    fed = "environment whose units get the recorded topics as inputs (default: only play the topics)"
    parser.add_argument("env", metavar="ENV", nargs="?", help=fed)
    parser.add_argument(
        "--speed", type=shared.positive, default=1.0, metavar="X", help="play X times as fast as recorded (default: 1)"
    )
    parser.add_argument("--loop", action="store_true", help="start again at the end of the recording")
    shared.add_several(parser, "--topic", "TOPIC", "play only this topic; may be repeated (default: all topics)")
    written = parser.add_mutually_exclusive_group()
    part = "run nothing; write the topics as sources into a file that an environment can include"
    written.add_argument("--out", type=shared.out_file, metavar="FILE", help=part)
    again = "run nothing; write the environment and ontology of the recorded run into this folder"
    written.add_argument("--extract", type=Path, metavar="FOLDER", help=again)
    shared.add_span(parser)
    parser.add_argument(
        "--name",
        type=shared.run_name,
        metavar="NAME",
        help="name of the run, for `cfgplan ctl --name NAME` and `cfgplan listen --run NAME`",
    )
    parser.add_argument("--dry-run", action="store_true", help="show what would be started, and start nothing")
    parser.add_argument("--record", metavar="FILE", help="record the targets' streams and all events into FILE (MCAP)")
    parser.add_argument("--plain", action="store_true", help="print one line for each event, instead of the live view")
    shared.add_json(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace, screen: Screen) -> Exit:
    from cfgplan_runtime.operating.recorded import recorded

    from cfgplan import api

    of_run = {
        "--for": options.span is not None,
        "--name": options.name,
        "--dry-run": options.dry_run,
        "--record": options.record,
        "--plain": options.plain,
    }
    if options.out:
        shared.refuse_beside("--out", of_run)
    if options.extract is not None:
        of_sources = {
            "ENV": options.env,
            "--speed": options.speed != 1,
            "--loop": options.loop,
            "--topic": options.topic,
        }
        shared.refuse_beside("--extract", of_run | of_sources)
    with screen.phase("read"):
        found = recorded(Path(options.path))
    if options.extract is not None:
        return _extract(found, options.extract, screen)
    if not found.topics:
        raise InputError.of(
            "nothing was recorded on any topic", file=options.path, mend="record a run that lasts longer"
        )
    for topic in options.topic:
        if topic not in found.topics:
            mend = did_you_mean(topic, found.topics, f"it has {', '.join(found.topics)}")
            raise InputError.of(f"the recording has no topic {topic!r}", file=options.path, mend=mend)
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="cfgplan-replay-")))
        before = _recorded_world(found, folder)
        env = None if options.env is None else api.load(options.env)
        targets = _targets(found, options.topic, env or before)
        sources = tuple(_source(found, target, options) for target in targets)
        if env:
            _tell_untagged(found, options, targets, screen)
            _tell_untaken(_fed(env, sources), sources, options.env, screen)
        if options.out:
            return _write_part(sources, options, screen)
        sources = _beginning(sources, time.time_ns() + int(_BEGINS_S * 1e9))
        played = _fed(env, sources) if env else _alone(before, sources, targets)
        path = _write_world(played, env or before, folder)
        screen.note(f"Playing {counted(len(sources), 'topic')} of {found.path.name}.")
        return _play(path, found, options, screen)


def _recorded_world(found: Recorded, folder: Path) -> World | None:
    """The environment of the recorded run, without its code; None if the recording has none."""
    from cfgplan_runtime.operating.recorded import ENVIRONMENT

    from cfgplan import api

    if ENVIRONMENT not in found.attached:
        return None
    inside = folder / "recorded"
    inside.mkdir()
    _write_attached(found, inside)
    return api.load(inside / ENVIRONMENT)


def _write_attached(found: Recorded, folder: Path) -> None:
    from cfgplan_runtime.operating.recorded import ENVIRONMENT, ONTOLOGY

    for name in (ENVIRONMENT, ONTOLOGY):
        if name in found.attached:
            (folder / name).write_bytes(found.attached[name])


def _extract(found: Recorded, folder: Path, screen: Screen) -> Exit:
    from cfgplan_runtime.operating.recorded import ENVIRONMENT

    if ENVIRONMENT not in found.attached:
        mend = "record the run with this version of cfgplan"
        raise InputError.of("the recording does not hold its run's environment", file=str(found.path), mend=mend)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if (folder / ENVIRONMENT).exists():
            raise InputError.of("the file exists already", file=str(folder / ENVIRONMENT), mend="name another folder")
        _write_attached(found, folder)
    except OSError as error:
        raise InputError.unwritable(error, str(folder)) from None
    file = folder / ENVIRONMENT
    named = shlex.quote(str(file))
    screen.note(f"Wrote {file}. Next: `cfgplan solve {named}`, or `cfgplan run {named}`.")
    return Exit.OK


def _targets(found: Recorded, wanted: list[str], world: World | None) -> list[Target]:
    """A target for each recorded topic, with the tag that an environment gives it, or else one named as the topic."""
    known: Mapping[str, Target] = {} if world is None else {one.topic: one for one in world.environment.stream_targets}
    targets = []
    for topic in found.topics:
        if wanted and topic not in wanted:
            continue
        target = known.get(topic)
        if target is None and world is not None and not world.ontology.is_open:
            if wanted:
                mend = "leave ENV out, or add a target of this topic to it: its tag says what the stream is"
                raise InputError.of(f"no target of the environment has the topic {topic!r}", mend=mend)
            continue
        tag = (re.sub(r"\W+", "_", topic).strip("_") or "topic") if target is None else target.tag
        targets.append(Target(topic if target is None else target.label, tag, topic))
    if not targets:
        topics = ", ".join(found.topics)
        mend = "its tag says what the stream is; or leave ENV out"
        raise InputError.of(f"no target of the environment has one of the recorded topics ({topics})", mend=mend)
    return targets


def _source(found: Recorded, target: Target, options: argparse.Namespace) -> Transformation:
    params: dict[str, object] = {"file": str(found.path.resolve()), "topic": target.topic}
    params |= {"speed": options.speed} if options.speed != 1 else {}
    params |= {"loop": True} if options.loop else {}
    return Transformation(
        f"recorded({target.topic})",
        outputs=(OutputPort("value", target.tag),),
        labor_us=_LABOR_US,
        upkeep_us=_UPKEEP_US,
        source="cfgplan_runtime.replay:Source",
        params=params,
    )


def _beginning(sources: tuple[Transformation, ...], begin_ns: int) -> tuple[Transformation, ...]:
    """The sources with one beginning, so that they stay in step."""
    return tuple(replace(source, params={**source.params, "begin_ns": begin_ns}) for source in sources)


def _fed(world: World, sources: tuple[Transformation, ...]) -> World:
    """Add the sources to an environment."""
    environment = world.environment
    return replace(world, environment=replace(environment, units=(), library=(*environment.library, *sources)))


def _tell_untagged(found: Recorded, options: argparse.Namespace, targets: list[Target], screen: Screen) -> None:
    """Warn of recorded topics that are not played, since no target of the environment gives them a tag."""
    played = {target.topic for target in targets}
    without = [topic for topic in options.topic or found.topics if topic not in played]
    if without:
        mend = "add targets with these topics and with the tags of their streams"
        screen.warn_of(Fault(f"{some(without)} can't be played: no target of {options.env} has the topic", mend=mend))


def _tell_untaken(world: World, sources: tuple[Transformation, ...], env: str, screen: Screen) -> None:
    """Warn of recorded topics that no unit uses in the plan of a replay, and of sources that were not recorded."""
    from cfgplan_runtime.lifecycle.policy import Policy

    from cfgplan import api

    problem, plan = api.solve(world, time_limit_s=Policy().time_limit_s)
    if plan.change_set is None:
        return  # the run says why
    played = {source.label: str(source.params["topic"]) for source in sources}
    started = plan.change_set.started
    of_unit = {unit.id: unit.transformation for unit in started}
    takes = [one.stream.unit for unit in started if unit.transformation not in played for one in unit.subscriptions]
    taken = {of_unit[unit] for unit in takes}
    untaken = [topic for label, topic in played.items() if label not in taken]
    if not untaken:
        return
    if len(untaken) < len(played):
        screen.note(f"No unit of {env} uses {some(untaken)}: only listeners receive it.")
        return
    message = f"no unit of {env} uses a recorded topic: only listeners receive {some(untaken)}"
    screen.warn_of(Fault(message, mend=_mend_of_untaken(problem, sources, env)))


def _mend_of_untaken(problem: Problem, sources: tuple[Transformation, ...], env: str) -> str:
    """Return the remedy if no unit uses a recorded topic: play fewer topics, or record the outputs of the sources."""
    own = [one for one in problem.environment.library if one not in sources]
    demanded = {port.tag for one in own for port in one.inputs}

    def fed_by(offered: Iterable[Transformation]) -> set[str]:
        tags = {port.tag for one in offered for port in one.outputs}
        return {tag for tag in demanded for given in tags if problem.similarity.holds(given, tag)}

    if usable := [str(source.params["topic"]) for source in sources if fed_by([source])]:
        play = " ".join(f"--topic {topic}" for topic in usable)
        return f"the recording has the results too, so no unit computes them; to compute them again, play only {play}"
    live = [one for one in own if not one.inputs and fed_by([one])]
    if not live:
        return f"`cfgplan match {shlex.quote(str(env))}` shows which outputs may feed which inputs"
    tag = next(port.tag for port in live[0].outputs if fed_by([replace(live[0], outputs=(port,))]))
    names = some(one.label for one in live)
    return f"{names} was not recorded; give it a target and record again: {{label: input, topic: /input, tag: {tag}}}"


def _alone(before: World | None, sources: tuple[Transformation, ...], targets: list[Target]) -> World:
    """The sources, and nothing but their topics wanted."""
    from cfgplan.api import World
    from cfgplan.domain import Environment
    from cfgplan.matching import Ontology

    environment = Environment(library=sources, targets=tuple(targets))
    if before is None:
        return World(environment, Ontology(is_open=True), 3600)
    return World(environment, before.ontology, before.horizon_s, file=before.file)


def _write_world(world: World, of: World | None, folder: Path) -> Path:
    """Write an environment file; unit code is that of the file `of`."""
    from cfgplan_runtime.operating.recorded import ENVIRONMENT
    from cfgplan_runtime.operating.recorded_world import world_files

    code = folder
    if of is not None and of.file is not None:
        path = of.file.path.resolve()
        code = path if path.is_dir() else path.parent
    for name, text in world_files(world, code):
        (folder / name).write_text(text, encoding="utf-8")
    return folder / ENVIRONMENT


def _write_part(sources: tuple[Transformation, ...], options: argparse.Namespace, screen: Screen) -> Exit:
    from cfgplan.domain import Environment
    from cfgplan.formats.dump import dump_yaml, plain_environment

    plain = plain_environment(Environment(library=sources), horizon_s=3600)
    shared.put(dump_yaml({"transformations": plain["transformations"]}), options.out, screen)
    return Exit.OK


def _play(path: Path, found: Recorded, options: argparse.Namespace, screen: Screen) -> Exit:
    """Run the environment until the recording is over, or as long as was asked for."""
    from cfgplan.cli import run as run_verb

    span_s = (found.end_ns - found.begin_ns) / 1e9 / options.speed
    lasts_s = options.span if options.span is not None else None if options.loop else span_s + 2 * _BEGINS_S
    words = [str(path), "--no-estimates"]
    words += [] if lasts_s is None else ["--for", f"{lasts_s:.3f}s"]
    words += [f"--{word.replace('_', '-')}" for word in ("plain", "json", "dry_run") if getattr(options, word)]
    for word in ("name", "record"):
        words += [f"--{word}", value] if (value := getattr(options, word)) is not None else []
    parser = argparse.ArgumentParser()
    run_verb.add_to(parser)
    return run_verb.run(parser.parse_args(words), screen)
