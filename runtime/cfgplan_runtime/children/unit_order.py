"""The order that makes a child a unit of a transformation."""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec

from cfgplan_runtime.children.messages import UnitOrder

if TYPE_CHECKING:
    from pathlib import Path

    from cfgplan.domain import Transformation

SIGN_NS = 1_000_000_000
"""Nanoseconds between two signs of life of a unit that works."""
_IDLE_SIGN_NS = 4_000_000_000
"""The most nanoseconds between two signs of life of an idle unit."""


def order_digest(transformation: Transformation) -> str:
    """The digest of the order that starts a unit of a transformation, the same for each unit."""
    import hashlib

    order = msgspec.json.encode(unit_order("", transformation, None), order="deterministic")
    return hashlib.sha256(order).hexdigest()


def digest_of(path: Path) -> str | None:
    """The SHA-256 of a source file; None if it can't be read."""
    import hashlib

    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError:
        return None


def unit_order(unit: str, transformation: Transformation, state: bytes | None) -> UnitOrder:
    """The order for a unit of a transformation. Its code folder and clock are those of the computer that starts it."""
    run = transformation.run
    return UnitOrder(
        unit=unit,
        source=transformation.source or "",
        params=dict(transformation.params),
        inputs=[port.name for port in transformation.inputs],
        outputs=[port.name for port in transformation.outputs],
        optional=[port.name for port in transformation.inputs if port.optional],
        services=[port.name for port in transformation.inputs if port.service],
        counts={port.name: port.count for port in transformation.inputs if port.count != 1},
        start=run.start,
        tolerance_ns=run.tolerance_us * 1000,
        period_ns=None if run.rate_hz is None else round(1e9 / run.rate_hz),
        queue=run.queue,
        blocks=run.blocks,
        state_name=transformation.state_name,
        state=state,
        qualities={
            port.name: {stated.attribute: stated.of_stream for stated in port.quality}
            for port in transformation.outputs
            if port.quality
        },
        format=run.format,
        idle_sign_ns=_idle_sign_ns(run.hang_us),
        memory_bytes=None if run.memory_mb is None else run.memory_mb << 20,
        stop_us=run.stop_us,
    )


def _idle_sign_ns(hang_us: int | None) -> int:
    """The time between two signs of life of an idle unit: at most a third of the silence after which it is killed."""
    return _IDLE_SIGN_NS if not hang_us else min(_IDLE_SIGN_NS, max(SIGN_NS, hang_us * 1000 // 3))
