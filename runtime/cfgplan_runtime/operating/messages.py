"""Values as messages of a recording: JSON with its JSON Schema, images in the forms that Foxglove shows.

Reference: the well-known schemas foxglove.RawImage, foxglove.CompressedImage and foxglove.Log, JSON encoding.
"""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy
    from numpy.typing import NDArray

SMALLEST_SIDE = 16
"""An array with at least this many rows and columns is an image; a smaller one is a matrix."""
MOST_NUMBERS = 1024
"""An array of more numbers than this is recorded as the base64 of its bytes."""


def _form(title: str, **properties: Mapping[str, Any]) -> dict[str, Any]:
    return {"type": "object", "title": title, "properties": properties}


_TEXT_FORM = {"type": "string"}
_COUNT = {"type": "integer", "minimum": 0}
_BYTES = {"type": "string", "contentEncoding": "base64"}
_TIMESTAMP = _form("time", sec=_COUNT, nsec=_COUNT)
_COMPRESSED_IMAGE = _form(
    "foxglove.CompressedImage", timestamp=_TIMESTAMP, frame_id=_TEXT_FORM, data=_BYTES, format=_TEXT_FORM
)
_RAW_IMAGE = _form(
    "foxglove.RawImage",
    timestamp=_TIMESTAMP,
    frame_id=_TEXT_FORM,
    width=_COUNT,
    height=_COUNT,
    encoding=_TEXT_FORM,
    step=_COUNT,
    data=_BYTES,
)
_LOG = _form(
    "foxglove.Log",
    timestamp=_TIMESTAMP,
    level=_COUNT,
    message=_TEXT_FORM,
    name=_TEXT_FORM,
    file=_TEXT_FORM,
    line=_COUNT,
)
ENCODINGS = {
    ("u1", None): "mono8",
    ("u1", 3): "rgb8",
    ("u1", 4): "rgba8",
    ("u2", None): "16UC1",
    ("f4", None): "32FC1",
}
"""Foxglove's name of a pixel encoding, by numpy type and number of channels (None: two dimensions)."""
_MAGIC = {b"\xff\xd8\xff": "jpeg", b"\x89PNG\r\n\x1a\n": "png"}


@dataclass(frozen=True, slots=True)
class Message:
    """A recorded message of a topic: a JSON object, and its schema."""

    topic: str
    schema_name: str
    schema: Mapping[str, Any]
    body: Mapping[str, Any]


def messages(topic: str, value: Any, time_ns: int) -> Iterator[Message]:
    """The messages that record a value: one, and one on `topic/key` for each image that a mapping holds.

    A value that is neither an image nor a mapping is recorded as `{"value": ...}`.
    """
    image = _image(topic, value, time_ns)
    if image is not None:
        yield image
        return
    if not isinstance(value, Mapping):
        value = {"value": value}
    rest = {}
    for key, item in value.items():
        image = _image(f"{topic}/{key}", item, time_ns)
        if image is None:
            rest[key] = item
        else:
            rest[key] = {"topic": image.topic}
            yield image
    body, schema = _described(rest)
    yield Message(topic, f"cfgplan{topic.replace('/', '.')}", schema, body)


def log_message(topic: str, level: int, name: str, text: str, time_ns: int) -> Message:
    """A line of a log; level 2 is information, 3 a warning, 4 an error."""
    body = {"timestamp": _time(time_ns), "level": level, "message": text, "name": name, "file": "", "line": 0}
    return Message(topic, "foxglove.Log", _LOG, body)


def record_message(topic: str, record: Mapping[str, Any], schema: Mapping[str, Any]) -> Message:
    """A record of the run, under its schema."""
    return Message(topic, f"cfgplan.{topic.rpartition('/')[2].capitalize()}", schema, record)


def compressed_kind(data: bytes) -> str | None:
    """The form of a compressed image, `jpeg` or `png`; None for other bytes."""
    return next((kind for magic, kind in _MAGIC.items() if data.startswith(magic)), None)


def _image(topic: str, value: Any, time_ns: int) -> Message | None:
    if isinstance(value, bytes):
        kind = compressed_kind(value)
        if kind is None:
            return None
        body = {"timestamp": _time(time_ns), "frame_id": topic, "data": _base64(value), "format": kind}
        return Message(topic, "foxglove.CompressedImage", _COMPRESSED_IMAGE, body)
    if not _is_array(value) or value.ndim not in (2, 3) or min(value.shape[:2]) < SMALLEST_SIDE:
        return None
    encoding = ENCODINGS.get((value.dtype.str[1:], value.shape[2] if value.ndim == 3 else None))
    if encoding is None:
        return None
    height, width = value.shape[:2]
    body = {"timestamp": _time(time_ns), "frame_id": topic, "width": width, "height": height, "encoding": encoding}
    rows = _little_endian(value)
    body |= {"step": rows.nbytes // height, "data": _base64(rows.tobytes())}
    return Message(topic, "foxglove.RawImage", _RAW_IMAGE, body)


def _described(value: Any) -> tuple[Any, dict[str, Any]]:
    """A value as JSON can say it, and the JSON Schema of that."""
    match value:
        case None:
            return None, {"type": "null"}
        case bool():
            return value, {"type": "boolean"}
        case int() | float():
            return value, {"type": "number"}
        case str():
            return value, {"type": "string"}
        case bytes():
            return _base64(value), _BYTES
        case Mapping():
            said = {str(key): _described(item) for key, item in value.items()}
            properties = {key: schema for key, (_, schema) in said.items()}
            return {key: item for key, (item, _) in said.items()}, {"type": "object", "properties": properties}
        case list() | tuple():
            if all(type(item) in (int, float) for item in value):
                return value, {"type": "array", "items": {"type": "number"}}
            parts = [_described(item) for item in value]
            schemas = [schema for _, schema in parts]
            same = bool(schemas) and all(schema == schemas[0] for schema in schemas)
            return [item for item, _ in parts], {"type": "array", **({"items": schemas[0]} if same else {})}
    if _is_array(value):
        return _described_array(value)
    return str(value), {"type": "string"}


def _described_array(array: NDArray[Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    shape = {"type": "array", "items": {"type": "number"}}
    properties: dict[str, Any] = {"dtype": {"type": "string"}, "shape": shape}
    body: dict[str, Any] = {"dtype": str(array.dtype), "shape": list(array.shape)}
    if array.size <= MOST_NUMBERS and array.dtype.kind in "biuf":
        body["data"] = array.reshape(-1).tolist()
        properties["data"] = {"type": "array", "items": {"type": "boolean" if array.dtype.kind == "b" else "number"}}
    else:
        body["data"] = _base64(_little_endian(array).tobytes())
        properties["data"] = _BYTES
    return body, {"type": "object", "properties": properties}


def _little_endian(array: NDArray[Any]) -> NDArray[Any]:
    dtype: numpy.dtype[Any] = array.dtype.newbyteorder("<")
    return array.astype(dtype, copy=False)


def _is_array(value: Any) -> bool:
    return hasattr(value, "dtype") and hasattr(value, "shape")


def _base64(data: bytes) -> str:
    return b64encode(data).decode("ascii")


def _time(time_ns: int) -> dict[str, int]:
    return {"sec": time_ns // 1_000_000_000, "nsec": time_ns % 1_000_000_000}
