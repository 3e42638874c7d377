"""Received values for people and for machines."""

from __future__ import annotations

from typing import Any

_LONGEST_LINE = 160
_MOST_NUMBERS = 1000


def readable(value: Any) -> str:
    """A value on one line; of large arrays only what they are, of long texts only the beginning."""
    text = repr(_summed_up(value))
    return text if len(text) <= _LONGEST_LINE else f"{text[: _LONGEST_LINE - 3]}..."


def plain(value: Any) -> Any:
    """A value as JSON can say it: bytes by their length, arrays with their numbers if these are not too many."""
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list):
        return [plain(item) for item in value]
    if isinstance(value, bytes):
        return {"bytes": len(value)}
    if _is_array(value):
        array: dict[str, Any] = {"dtype": str(value.dtype), "shape": list(value.shape)}
        if value.size <= _MOST_NUMBERS and value.dtype.kind in "biuf":
            array["data"] = value.tolist()
        return array
    return value if isinstance(value, str | int | float | bool | None) else str(value)


class _Words:
    """Text that stands for itself inside of a printed value."""

    def __init__(self, text: str) -> None:
        self._text = text

    def __repr__(self) -> str:
        return self._text


def _summed_up(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _summed_up(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_summed_up(item) for item in value]
    if isinstance(value, bytes) and len(value) > _LONGEST_LINE:
        return _Words(f"<{len(value):,} bytes>")
    if _is_array(value):
        if value.size <= 8:
            return _Words(f"array({value.tolist()}, {value.dtype})")
        return _Words(f"<array of {' x '.join(map(str, value.shape))} {value.dtype}>")
    return value


def _is_array(value: Any) -> bool:
    return hasattr(value, "dtype") and hasattr(value, "shape")
