"""The values of messages of ROS 1."""

from __future__ import annotations

from collections.abc import Callable

from cfgplan.errors import InputError
from cfgplan.extras import needed
from cfgplan_runtime.errors import EncodingError


class MessageDecoders:
    """Decodes messages by the definitions that their publishers give."""

    def __init__(self) -> None:
        self._decoders: dict[tuple[str, str], Callable[[bytes], object]] = {}

    def value(self, kind: str, definition: str, data: bytes) -> object:
        """Return the value of a serialised message. Raises EncodingError, or InputError without rosbags."""
        key = kind, definition
        try:
            if key not in self._decoders:
                self._decoders[key] = _decoder(kind, definition)
            return self._decoders[key](data)
        except InputError:
            raise
        except Exception as error:
            # rosbags raises errors of its own, and any others at input that it does not foresee.
            raise EncodingError(f"{len(data)} bytes of {kind} that can't be read: {error}") from None

    def shown(self, kind: str, definition: str, data: bytes) -> object:
        """Return the value of a serialised message, or a text that says why it can't be shown."""
        try:
            return self.value(kind, definition, data)
        except InputError as error:
            return f"{len(data)} bytes of {kind}: {error}"
        except EncodingError as error:
            return str(error)


def check_decoders() -> None:
    """Raise InputError, which names the extra, if what decoding needs is not installed."""
    needed("values of ROS 1 messages", "rosbags")


def _decoder(kind: str, definition: str) -> Callable[[bytes], object]:
    """Return what decodes messages of a type. Raises InputError without rosbags, or errors of its parser."""
    check_decoders()
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    from cfgplan_runtime.nodes.message_values import MessageValues

    store = get_typestore(Stores.EMPTY)
    package, _, name = kind.partition("/")
    full = f"{package}/msg/{name}"
    store.register(get_types_from_msg(definition, full))
    change = MessageValues(store).change(full)
    return lambda data: change(store.deserialize_ros1(data, full))
