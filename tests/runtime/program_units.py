"""Transformations whose units are the program of running_program.py."""

from __future__ import annotations

import sys
from dataclasses import replace

from world import worker

from cfgplan.domain import OutputPort, RunOptions, Transformation
from cfgplan.transformations import ProgramFormat

USUAL = RunOptions()


def command(deed: str, form: ProgramFormat) -> str:
    return f"program:{sys.executable} running_program.py {deed!r} {form}"


def program(
    form: ProgramFormat,
    deed: str = "same",
    *,
    label: str = "work",
    run: RunOptions = USUAL,
    **params: object,
) -> Transformation:
    made = worker(label, **params)
    run = replace(run, format=form)
    return Transformation(label, made.inputs, made.outputs, source=command(deed, form), params=made.params, run=run)


def provider(form: ProgramFormat, deed: str, *, rate_hz: float | None = None, **params: object) -> Transformation:
    run = RunOptions(rate_hz=rate_hz, format=form)
    return Transformation("give", outputs=(OutputPort("n", "N"),), source=command(deed, form), params=params, run=run)
