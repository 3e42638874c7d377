"""The values of messages that the relay passes on for taps."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from cfgplan.errors import InputError
from cfgplan.ros.types import MessageType
from cfgplan_runtime.errors import EncodingError


class TappedValues:
    """Decodes messages of any type. Definitions of one's own are looked for in `folder`."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._decoders: dict[str, Callable[[bytes], object]] = {}

    def of(self, kind: str, data: bytes) -> object:
        """Return the value of a message in CDR, or a text that says why it can't be shown."""
        try:
            if kind not in self._decoders:
                self._decoders[kind] = self._decoder(kind)
            return self._decoders[kind](data)
        except EncodingError as error:
            return f"{len(data)} bytes of {kind}: {error}"

    def _decoder(self, kind: str) -> Callable[[bytes], object]:
        from cfgplan_runtime.ros2.definitions import Definitions  # imports numpy, which few runs of nodes need

        try:
            return Definitions(folder=self._folder).form(MessageType.read(kind)).decode
        except InputError as error:
            why = "; ".join(f"{one.message} ({one.mend})" if one.mend else one.message for one in error.faults)
            return lambda data: f"{len(data)} bytes of {kind}: {why}"
