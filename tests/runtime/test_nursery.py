"""The modules that the process that forks units imports for them."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path

import pytest
from cfgplan_runtime.processes.nursery import imports_packages
from cfgplan_runtime.processes.process_backend import NURSERY_HELPER, ProcessBackend
from cfgplan_runtime.supervision.events import Event, HelperAlive, UnitPrinted, UnitReady
from watching import StartRuntime, seen
from world import PATIENCE_S, eventually, source, start, unit


@pytest.mark.parametrize(
    ("code", "may_need_numpy"),
    [
        ("import os, sys as system\nfrom collections.abc import Iterator\nimport xml.dom", False),
        ("from cfgplan_runtime import At\nimport cfgplan", False),
        ("import numpy as np", True),
        ("import os, numpy", True),
        ("from numpy.linalg import norm", True),
        ("def made():\n    import cv2.aruco\n", True),
        ("from . import beside", True),
        ("import beside", True),
        ("import deeper", True),
        ("import itself", False),
        ("'''\nNothing is known of numpy, import aside.\n'''\nnumpy = 1", False),
    ],
)
@pytest.mark.parametrize("place", ["itself.py", "inner/itself.py", "itself", "inner.itself"])
def test_numpy_may_be_needed_by_code_that_imports_an_installed_package_itself_or_by_a_file_beside_it(
    tmp_path: Path, code: str, may_need_numpy: bool, place: str
) -> None:
    inner = tmp_path / "inner"
    inner.mkdir()
    (tmp_path / "beside.py").write_text("import json\nimport scipy\n")
    (inner / "deeper.py").write_text("import beside\n")
    (tmp_path / "deeper.py").write_text("import beside\n")
    path = tmp_path / (place if place.endswith(".py") else f"{place.replace('.', '/')}.py")
    path.write_text(code)
    assert imports_packages(f"{place}:Unit", str(tmp_path)) == may_need_numpy


@pytest.mark.parametrize(
    ("given", "may_need_numpy"),
    [
        ("program:./mask", False),
        ("cfgplan_runtime.mqtt:Subscriber", False),
        ("absent.py:Unit", False),
        ("abs\0ent.py:Unit", False),
        ("abs\0ent:Unit", True),
        ("package.of.others:Unit", True),
    ],
)
def test_programs_and_units_of_the_product_need_no_numpy(tmp_path: Path, given: str, may_need_numpy: bool) -> None:
    assert imports_packages(given, str(tmp_path)) == may_need_numpy


def test_numpy_is_imported_before_the_first_unit_that_may_need_it_and_shared_with_all_later_ones(
    run_units: StartRuntime,
) -> None:
    runtime = run_units(source("say", "has_numpy"), source("draw", "image_units.py:draw"))
    for number, label in enumerate(("say", "draw", "say")):
        runtime.apply(start(unit(f"{label}.{number}")))
        eventually(lambda number=number: len(seen(runtime, UnitPrinted)) > number)
    first, _, last = (event.line for event in seen(runtime, UnitPrinted))
    assert (first, last) == ("False", "True")


def test_a_nursery_that_imports_numpy_for_a_unit_may_be_silent_for_as_long_as_at_its_start() -> None:
    told = list[Event]()

    def patience_s(of: Sequence[Event]) -> list[float]:
        return [event.patience_s for event in of if isinstance(event, HelperAlive) and event.helper == NURSERY_HELPER]

    def is_ready() -> bool:
        told.extend(backend.wait(PATIENCE_S))
        return any(isinstance(event, UnitReady) for event in told)

    with closing(ProcessBackend(folder=Path(__file__).parent)) as backend:
        backend.warm_up()
        (at_the_start,) = patience_s(backend.wait(0.0))
        while (usual := patience_s(backend.wait(PATIENCE_S))[-1]) == at_the_start:
            pass
        backend.start("draw.1", source("draw", "image_units.py:draw"), None, None)
        eventually(is_ready)
        assert at_the_start in patience_s(told)
        assert patience_s(told)[-1] == usual


def test_a_numpy_that_can_not_be_imported_is_tried_once() -> None:
    code = (
        "import sys; sys.modules['numpy'] = None\n"
        "from cfgplan_runtime.processes.nursery import NUMPY, Shared\n"
        "shared = Shared(())\n"
        "before = shared.lacks_numpy\n"
        "shared.add(NUMPY)\n"
        "print(before, shared.lacks_numpy)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "True False\n"
