"""Values as bytes: msgpack, with numpy arrays as raw buffers beside it.

A payload is a 4-byte length, that many bytes of msgpack, padding, then the arrays' bytes. The arrays
of a decoded value are writable views of the received bytes; nothing is unpickled.
"""

from __future__ import annotations

import re
import struct
import sys
from typing import Any

import msgspec

from cfgplan_runtime.errors import EncodingError
from cfgplan_runtime.streams.element import Buffer

_PAYLOAD_HEAD = struct.Struct("<I")
_ARRAY = 1
_ALIGNMENT = 16
_PLAIN = re.compile(r"[<>|=]?[biufcmMSUV]\d{1,9}(\[\w{1,9}\])?")
"""The types of arrays, as numpy writes them; it would parse others as Python."""


class PayloadEncoder:
    """Turns values into payloads; one per thread."""

    def __init__(self) -> None:
        self._arrays: list[Buffer] = []
        self._size = 0
        self._encoder = msgspec.msgpack.Encoder(enc_hook=self._foreign)

    def encode(self, value: object) -> list[Buffer]:
        """The parts of the payload of `value`; they share the memory of its arrays.

        Raises EncodingError for anything but msgpack types and numpy arrays of plain numbers.
        """
        self._arrays, self._size = [], 0
        try:
            body = self._encoder.encode(value)
        except (TypeError, ValueError, OverflowError, RecursionError, msgspec.MsgspecError) as error:
            raise EncodingError(f"a value of type {type(value).__name__} can't be sent: {error}") from None
        if not self._arrays:
            return [_PAYLOAD_HEAD.pack(len(body)) + body]
        head = _PAYLOAD_HEAD.pack(len(body)) + body
        return [head + bytes(-len(head) % _ALIGNMENT), *self._arrays]

    def _foreign(self, value: Any) -> object:
        numpy = sys.modules.get("numpy")
        if numpy is not None and isinstance(value, numpy.ndarray):
            if value.dtype.hasobject or value.dtype.names is not None or value.dtype.subdtype is not None:
                raise TypeError(f"an array of {value.dtype} has no plain bytes")
            if (ma := sys.modules.get("numpy.ma")) is not None and isinstance(value, ma.MaskedArray):
                raise TypeError("a masked array would lose its mask: send value.filled(...), and value.mask beside it")
            solid = numpy.ascontiguousarray(value)
            meta = msgspec.msgpack.encode((value.dtype.str, value.shape, self._size))
            self._append(solid.view(numpy.uint8).reshape(-1).data if solid.size else b"")
            return msgspec.msgpack.Ext(_ARRAY, meta)
        if numpy is not None and isinstance(value, numpy.generic):
            return value.item()
        mend = "send numbers, texts, bytes, lists, mappings or numpy arrays"
        raise TypeError(f"{type(value).__name__} is neither a msgpack type nor a numpy array; {mend}")

    def _append(self, data: Buffer) -> None:
        self._arrays.append(data)
        padding = -len(data) % _ALIGNMENT
        if padding:
            self._arrays.append(bytes(padding))
        self._size += len(data) + padding


def decode(payload: Buffer) -> Any:
    """The value of a payload; its arrays are views of it. Raises EncodingError if it is no payload."""
    try:
        (length,) = _PAYLOAD_HEAD.unpack_from(payload)
        end = _PAYLOAD_HEAD.size + length
        view = memoryview(bytearray(payload) if isinstance(payload, bytes) and end < len(payload) else payload)
        body, arrays = view[_PAYLOAD_HEAD.size : end], view[end + -end % _ALIGNMENT :]
        return msgspec.msgpack.Decoder(ext_hook=lambda code, data: _array(code, data, arrays)).decode(body)
    except (struct.error, ValueError, TypeError, RecursionError, msgspec.MsgspecError) as error:
        raise EncodingError(f"a received value can't be read: {error}") from None


def _array(code: int, meta: memoryview, arrays: memoryview) -> Any:
    if code != _ARRAY:
        raise ValueError(f"extension {code} is unknown")
    import numpy

    kind, shape, offset = msgspec.msgpack.decode(meta, type=tuple[str, list[int], int])
    if not _PLAIN.fullmatch(kind) or min(shape, default=0) < 0:
        raise ValueError(f"there is no array of type {kind} and shape {shape}")
    dtype = numpy.dtype(kind)
    count = 1
    for length in shape:
        count *= length
    if not count:
        return numpy.empty(shape, dtype)
    return numpy.frombuffer(arrays, dtype, count, offset).reshape(shape)
