"""Values of streams as the page shows them: a number, a text, an image of bounded size."""

from __future__ import annotations

import json
import struct
import zlib
from base64 import b64encode
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

from cfgplan_runtime.operating.messages import SMALLEST_SIDE, compressed_kind
from cfgplan_runtime.operating.protocol import Record

if TYPE_CHECKING:
    from numpy.typing import NDArray

MOST_CHARACTERS = 4_000
LARGEST_SIDE = 320
"""The most pixels of an image's width or height; of a larger one, every second, third ... pixel is shown."""
LARGEST_IMAGE = 500_000
"""The most bytes of a JPEG or PNG image that is shown."""
_MOST_NUMBERS, _MOST_IMAGES, _MOST_ITEMS = 8, 2, 64


def shown(value: Any) -> Record:
    """Return `numbers` (by name; "" for the value itself), `text`, and `images` (data URLs by name) of a value."""
    pixels = _pixels(value) if isinstance(value, Mapping) else None
    parts = value if isinstance(value, Mapping) and pixels is None else {"": value if pixels is None else pixels}
    images: dict[str, str] = {}
    numbers: dict[str, float] = {}
    for name, part in parts.items():
        number = _number(part)
        if number is not None and len(numbers) < _MOST_NUMBERS:
            numbers[str(name)] = number
        elif number is None and len(images) < _MOST_IMAGES and (url := _image(part)) is not None:
            images[str(name)] = url
    plain = _plain(value)
    text = plain if isinstance(plain, str) else json.dumps(plain, ensure_ascii=False, indent=1)
    if len(text) > MOST_CHARACTERS:
        text = f"{text[:MOST_CHARACTERS]}\n... {len(text) - MOST_CHARACTERS} more characters"
    return {"numbers": numbers, "text": text, "images": images}


_ENCODINGS = {
    "mono8": ("u1", 1),
    "rgb8": ("u1", 3),
    "bgr8": ("u1", 3),
    "rgba8": ("u1", 4),
    "bgra8": ("u1", 4),
    "8UC1": ("u1", 1),
    "8UC3": ("u1", 3),
    "mono16": ("u2", 1),
    "16UC1": ("u2", 1),
    "32FC1": ("f4", 1),
}
"""The pixels of ROS images by their encoding: numpy's type, and the number of channels."""


def _pixels(message: Mapping[Any, Any]) -> NDArray[Any] | bytes | None:
    """Return the pixels of a message such as sensor_msgs/Image (height x width, or height x width x channels), or the
    bytes of a compressed one. None for anything else.
    """
    import numpy

    data: Any = message.get("data")
    if not _is_array(data) or data.dtype != numpy.uint8:
        return None
    if isinstance(message.get("format"), str):
        return bytes(data)
    kind, channels = _ENCODINGS.get(str(message.get("encoding")), ("", 0))
    height, width, step = (message.get(name) for name in ("height", "width", "step"))
    if not (kind and isinstance(height, int) and isinstance(width, int) and isinstance(step, int)):
        return None
    pixel = numpy.dtype(kind).newbyteorder(">" if message.get("is_bigendian") else "<")
    used = width * channels * pixel.itemsize
    if not 0 < used <= step or data.size < height * step or height < 1:
        return None
    rows = numpy.ascontiguousarray(data[: height * step].reshape(height, step)[:, :used]).view(pixel)
    image = rows.astype(pixel.newbyteorder("=")).reshape((height, width, channels)[: 2 if channels == 1 else 3])
    order = [2, 1, 0, 3][:channels] if str(message["encoding"]).startswith("bgr") else None
    return image if order is None else numpy.ascontiguousarray(image[..., order])


def _number(value: Any) -> float | None:
    if isinstance(value, bool | int | float):
        number = float(value)
    elif _is_array(value) and value.size == 1 and value.dtype.kind in "biuf":
        number = float(value.reshape(-1)[0])
    else:
        return None
    return number if number - number == 0 else None


def _image(value: Any) -> str | None:
    """An image as a data URL; None if the value is no image, or one that is too large."""
    if isinstance(value, bytes):
        kind = compressed_kind(value)
        return None if kind is None or len(value) > LARGEST_IMAGE else _url(kind, value)
    if not _is_array(value) or value.ndim not in (2, 3) or min(value.shape[:2]) < SMALLEST_SIDE:
        return None
    channels = 1 if value.ndim == 2 else value.shape[2]
    if channels not in _COLOURS or value.dtype.kind not in "buf":
        return None
    step = -(-max(value.shape[:2]) // LARGEST_SIDE)
    return _url("png", _png(_bytes_of(value[::step, ::step]), channels))


def _bytes_of(pixels: NDArray[Any]) -> NDArray[Any]:
    """Return pixels as uint8. Pixels of other types are scaled from their least to their greatest value."""
    import numpy

    if pixels.dtype == numpy.uint8:
        return pixels
    known = numpy.nan_to_num(pixels.astype(numpy.float64), posinf=0.0, neginf=0.0)
    least, most = float(known.min()), float(known.max())
    return ((known - least) * (255.0 / (most - least or 1.0))).astype(numpy.uint8)


_COLOURS = {1: 0, 3: 2, 4: 6}
"""PNG's colour type by number of channels."""


def _png(pixels: NDArray[Any], channels: int) -> bytes:
    """A PNG file of uint8 pixels. Reference: the PNG specification, third edition, sections 5 and 11.2."""
    import numpy

    height, width = pixels.shape[:2]
    rows = numpy.zeros((height, 1 + width * channels), numpy.uint8)  # each row begins with its filter: none
    rows[:, 1:] = pixels.reshape(height, -1)
    header = struct.pack(">IIBBBBB", width, height, 8, _COLOURS[channels], 0, 0, 0)
    chunks = ((b"IHDR", header), (b"IDAT", zlib.compress(rows.tobytes(), 1)), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data)) for kind, data in chunks
    )


def _url(kind: str, data: bytes) -> str:
    return f"data:image/{kind};base64,{b64encode(data).decode('ascii')}"


def _plain(value: Any) -> Any:
    """A value as JSON can say it, cut to the first items of each part."""
    match value:
        case None | bool() | int() | float() | str():
            return value
        case bytes():
            kind = compressed_kind(value)
            return f"{kind.upper()} image of {len(value)} bytes" if kind else f"{len(value)} bytes"
        case Mapping():
            return dict(_first(((str(key), _plain(item)) for key, item in value.items()), ("...", "more")))
        case list() | tuple():
            return list(_first(map(_plain, value), "..."))
    if _is_array(value):
        what = f"{value.dtype} {' x '.join(map(str, value.shape))}"
        return value.tolist() if 0 < value.size <= _MOST_ITEMS and value.dtype.kind in "biuf" else what
    return str(value)


def _first(items: Iterator[Any], rest: Any) -> Iterator[Any]:
    for count, item in enumerate(items):
        if count == _MOST_ITEMS:
            yield rest
            return
        yield item


def _is_array(value: Any) -> bool:
    return hasattr(value, "dtype") and hasattr(value, "shape")
