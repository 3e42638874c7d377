"""The world of a play: its folder, its files, and what is true in it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import yaml

from cfgplan.errors import InputError
from cfgplan_runtime.children.unit_code import find_source
from cfgplan_runtime.lifecycle.changes import Declare, Individual

NAMES = ("nao",)
_NEEDS = {"cv2": "OpenCV", "jinja2": "Jinja2"}
_HERE = Path(__file__).parent
_PLACES = (_HERE / "worlds", _HERE.parents[2] / "models")
"""In an installed package, and in a clone of the repository."""


@dataclass(frozen=True)
class Stage:
    """The folder of a world."""

    folder: Path

    @property
    def environment_file(self) -> Path:
        """The environment that the play begins with."""
        return self.folder / "0-target-only.yaml"

    def code(self, source: str) -> Callable[..., Any]:
        """Code of the world, such as `units.py:BottomCam`."""
        return find_source(source, self.folder)

    def robot(self, name: str) -> Declare:
        """What a robot declares when it registers: itself, and the pipeline that it can run."""
        text = (self.folder / "pipeline.yaml").read_text(encoding="utf-8").replace("${NAO}", name)
        return Declare(name, _transformations(text), (Individual(name, ("NAO",)),))

    def offer(self, name: str, stage: str) -> Declare:
        """Transformations of a stage's file that are nobody's in particular."""
        return Declare(name, _transformations((self.folder / f"{stage}.yaml").read_text(encoding="utf-8")))


def open_stage(name: str) -> Stage:
    """The world of that name. Raises InputError if it, or what it needs, is not installed."""
    missing = [title for module, title in _NEEDS.items() if find_spec(module) is None]
    if missing:
        raise InputError.of(f"the demo needs {' and '.join(missing)}", mend="pip install 'cfgplan[demo]'")
    for place in _PLACES:
        if (place / name / "units.py").is_file():
            return Stage(place / name)
    raise InputError.of(
        f"the world {name!r} is neither in the installed package nor in a clone around it",
        mend="install cfgplan from its repository, or from a wheel that holds models/",
    )


def _transformations(text: str) -> dict[str, object]:
    return {"transformations": yaml.safe_load(text)["transformations"]}
