"""Checks of transformations whose units are nodes, the same for ROS 1 and ROS 2."""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

from cfgplan.domain import Environment
from cfgplan.errors import Fault, InputError
from cfgplan.ros.sources import NodeSource, container_faults
from cfgplan.transformations import InputPort, OutputPort, Transformation

_TOPIC = re.compile(r"(/[A-Za-z]\w*)+", re.ASCII)


def check_names(transformation: Transformation, own_name: Callable[[InputPort | OutputPort], str]) -> None:
    """Raise InputError if two ports have the same name in the node's code."""
    ports: tuple[InputPort | OutputPort, ...] = (*transformation.inputs, *transformation.outputs)
    names = Counter(map(own_name, ports))
    twice = sorted(name for name, count in names.items() if count > 1)
    if twice:
        what = f"two ports are {twice[0]!r} to the node, which can't be led to two topics"
        raise InputError.of(f"{transformation.label}: {what}", mend="leave one of them out of the file")


def check_nodes(
    environment: Environment, file: str, node_source: Callable[[Transformation], NodeSource], ros: str
) -> None:
    """Raise InputError with all faults of an environment's transformations as nodes, and of its topics."""
    faults = list[Fault]()
    for transformation in environment.library:
        try:
            node_source(transformation)
        except InputError as error:
            faults += error.faults
    for label, topic in _named_topics(environment):
        if not _TOPIC.fullmatch(topic):
            mend = "use letters, digits and underscores between slashes, such as /front/image"
            what = f"{label}: `{topic}` can't be the name of a {ros} topic"
            faults += InputError.of(what, mend=mend).faults
    faults += container_faults(environment.library)
    if faults:
        raise InputError([replace(fault, file=fault.file or file) for fault in faults])


def _named_topics(environment: Environment) -> Iterator[tuple[str, str]]:
    """Yield (owner, topic) for the topics of targets, and for the topics of outputs outside of the run."""
    for target in environment.stream_targets:
        yield target.label, target.topic
    for transformation in environment.library:
        for output in transformation.outputs:
            if output.topic is not None:
                yield f"{transformation.label}/{output.name}", output.topic


def node_file(folder: Path, name: str) -> Path:
    """The executable file of a node, relative to `folder`. Raises InputError if it is missing or not executable."""
    path = (folder / name).resolve()
    if not path.is_file():
        mend = "files are relative to the environment file"
        raise InputError.of(f"there is no file {name}", file=str(path), mend=mend)
    if not os.access(path, os.X_OK):
        raise InputError.of("this node is not executable", file=str(path), mend=f"chmod +x {path.name}")
    return path
