"""Reading a recording of `cfgplan run --record`: its topics, their values as they were, and its attachments."""

from __future__ import annotations

import errno
import json
import os
from base64 import b64decode
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cfgplan.errors import InputError
from cfgplan.extras import needed
from cfgplan_runtime.operating.messages import ENCODINGS

if TYPE_CHECKING:
    from mcap.reader import McapReader

OWN_TOPICS = "/cfgplan/"
"""Begins the topics of a run's own events and reviews, which are no streams."""
ENVIRONMENT, ONTOLOGY = "environment.yaml", "ontology.ofn"
"""The attachments with the recorded run's environment and ontology."""
_MCAP_MAGIC = b"\x89MCAP0\r\n"
"""The first and the last bytes of a recording."""
_MEND = "a recording of `cfgplan run --record` is needed"
_RECOVER = "save what can be read: `mcap recover FILE` (https://mcap.dev/guides/cli)"


@dataclass(frozen=True, slots=True)
class RecordedTopic:
    """A topic of a recording: how many messages it has, and the times of the first and the last (ns since 1970)."""

    name: str
    count: int
    first_ns: int
    last_ns: int


@dataclass(frozen=True)
class Recorded:
    """The topics and attachments of a recording by name; an attachment is its bytes."""

    path: Path
    topics: Mapping[str, RecordedTopic]
    attached: Mapping[str, bytes]

    @property
    def begin_ns(self) -> int:
        """The time of the first message of a topic."""
        return min((topic.first_ns for topic in self.topics.values()), default=0)

    @property
    def end_ns(self) -> int:
        """The time of the last."""
        return max((topic.last_ns for topic in self.topics.values()), default=0)


def recorded(path: Path) -> Recorded:
    """Read the topics and attachments of a recording. Raises InputError for an unreadable file, or a foreign one."""
    topics: dict[str, RecordedTopic] = {}
    images: set[str] = set()
    with _opened(path) as reader:
        attached = {one.name: one.data for one in reader.iter_attachments()}
        for _, channel, message in reader.iter_messages():
            if channel.topic.startswith(OWN_TOPICS):
                continue
            if channel.message_encoding != "json":
                said = f"{channel.topic} has messages in {channel.message_encoding}, not in JSON"
                raise InputError.of(said, file=str(path), mend=_MEND)
            known = topics.get(channel.topic)
            at_ns = message.log_time
            topics[channel.topic] = (
                RecordedTopic(channel.topic, 1, at_ns, at_ns)
                if known is None
                else RecordedTopic(
                    channel.topic, known.count + 1, min(known.first_ns, at_ns), max(known.last_ns, at_ns)
                )
            )
            if known is None:
                images |= set(_named_images(json.loads(message.data)))
    return Recorded(path, {name: one for name, one in sorted(topics.items()) if name not in images}, attached)


def values(path: Path, topic: str, after_ns: int = -1) -> Iterator[tuple[int, Any]]:
    """The values of a topic with their times (ns since 1970), those after `after_ns`, in the order of their times."""
    images: dict[str, Any] = {}
    with _opened(path) as reader:
        names = [name for name in _topics_of(reader) if name == topic or name.startswith(f"{topic}/")]
        for schema, channel, message in reader.iter_messages(topics=names, starting_at=max(0, after_ns + 1)):
            body = json.loads(message.data)
            if channel.topic != topic:
                images[channel.topic] = _image(body)
            else:
                yield message.log_time, _value(body, schema.name if schema else "", _form(schema), images)


def _topics_of(reader: McapReader) -> list[str]:
    summary = reader.get_summary()
    if summary is not None:
        return sorted({channel.topic for channel in summary.channels.values()})
    return sorted({channel.topic for _, channel, _ in reader.iter_messages()})


def _form(schema: Any) -> Mapping[str, Any]:
    found: Mapping[str, Any] = json.loads(schema.data) if schema is not None and schema.data else {}
    return found


def _value(body: Mapping[str, Any], kind: str, form: Mapping[str, Any], images: Mapping[str, Any]) -> Any:
    """A value as unit code had given it."""
    if kind.startswith("foxglove."):
        return _image(body)
    properties = form.get("properties", {})
    said = {
        key: images[item["topic"]]
        if isinstance(item, dict) and item.keys() == {"topic"} and item["topic"] in images
        else _plain(item, properties.get(key, {}))
        for key, item in body.items()
    }
    return said["value"] if said.keys() == {"value"} else said


def _named_images(body: Any) -> Iterator[str]:
    """The topics on which images of a mapping stand."""
    for item in body.values() if isinstance(body, dict) else ():
        if isinstance(item, dict) and item.keys() == {"topic"} and isinstance(item["topic"], str):
            yield item["topic"]


def _plain(value: Any, form: Mapping[str, Any]) -> Any:
    match value:
        case str() if form.get("contentEncoding") == "base64":
            return b64decode(value)
        case {"dtype": str(dtype), "shape": list(shape), "data": data}:
            return _array(dtype, shape, data)
        case dict():
            properties = form.get("properties", {})
            return {key: _plain(item, properties.get(key, {})) for key, item in value.items()}
        case list():
            return [_plain(item, form.get("items", {})) for item in value]
    return value


def _array(dtype: str, shape: list[int], data: Any) -> Any:
    import numpy

    if isinstance(data, str):
        little = numpy.dtype(dtype).newbyteorder("<")
        return numpy.frombuffer(b64decode(data), little).reshape(shape).astype(dtype)
    return numpy.array(data, dtype).reshape(shape)


def _image(body: Mapping[str, Any]) -> Any:
    """The array of a raw image, or the bytes of a compressed one."""
    data = b64decode(body["data"])
    if "encoding" not in body:
        return data
    import numpy

    kind, channels = next(key for key, name in ENCODINGS.items() if name == body["encoding"])
    shape = (body["height"], body["width"], *(() if channels is None else (channels,)))
    return numpy.frombuffer(data, numpy.dtype(f"<{kind}")).reshape(shape).copy()


@contextmanager
def _opened(path: Path) -> Iterator[McapReader]:
    """Open a recording. Raises InputError if the file is none, or a damaged one."""
    needed("recordings", "mcap")
    from mcap.reader import make_reader

    if not os.path.lexists(path):  # also for a name that no file can have
        raise InputError.of("there is no such file", file=str(path), mend="check the path")
    if path.exists() and not path.is_file():
        found = "a folder" if path.is_dir() else "a pipe or a device"
        raise InputError.of(f"this is {found}, not a file", file=str(path), mend=_MEND)
    try:
        with path.open("rb") as file:
            if file.read(len(_MCAP_MAGIC)) != _MCAP_MAGIC:
                raise InputError.of("this is not a recording", file=str(path), mend=_MEND)
            file.seek(0)
            yield make_reader(file, validate_crcs=True)
    except InputError:
        raise
    except Exception as error:  # mcap checks little: a damaged file raises whatever its bytes lead to
        if isinstance(error, OSError) and error.errno != errno.EINVAL:  # EINVAL: it seeks to a place before the file
            raise InputError.of(f"can't be read: {error.strerror}", file=str(path)) from None
        if _has_end(path):
            said, mend = f"this recording is damaged ({type(error).__name__})", f"use another copy, or {_RECOVER}"
        else:
            said = "this recording has no end: its run still writes it, or was killed, or the file was cut"
            mend = f"wait for the end of the run, or {_RECOVER}"
        raise InputError.of(said, file=str(path), mend=mend) from None


def _has_end(path: Path) -> bool:
    with path.open("rb") as file:
        file.seek(max(0, path.stat().st_size - len(_MCAP_MAGIC)))
        return file.read() == _MCAP_MAGIC
