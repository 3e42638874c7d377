"""Finds the Python that has rclpy: seldom cfgplan's own."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from cfgplan.errors import InputError

VARIABLE = "CFGPLAN_ROS_PYTHON"
_EXTENSION = re.compile(r"_rclpy_pybind11\.cpython-(\d)(\d+)-")
_CODE = "import rclpy, sys; print(sys.executable)"
_IMPORT_S = 20.0
"""Seconds that a Python may take to import rclpy."""
_MEND = (
    "source /opt/ros/DISTRO/setup.bash before; or activate an environment of RoboStack; or make one by `python3 -m venv"
    " ros && ros/bin/pip install ros-jazzy-rclpy ros-jazzy-rmw-fastrtps-cpp`, and name ros/bin/python by --ros-python"
)


@dataclass(frozen=True)
class RosPython:
    """A Python that has rclpy, and the environment of its processes."""

    program: str
    environment: Mapping[str, str]


def ros_python(named: str | None = None, *, is_known: bool = False) -> RosPython:
    """The first Python that can import rclpy. Raises InputError if the one that is named can't, or none can.

    In order: `named`, $CFGPLAN_ROS_PYTHON, the version that rclpy on PYTHONPATH is built for, `python3` of PATH.
    The one that is named is not tried if it `is_known` that it can.
    """
    said = named or os.environ.get(VARIABLE)
    if said and is_known:
        return RosPython(said, environment_for(said))
    causes = []
    for program in [said] if said else _candidates():
        found = RosPython(program, environment_for(program))
        cause = _why_not(found)
        if cause is None:
            return found
        causes.append(f"{program}: {cause}")
    if said:
        mend = "name a Python that `import rclpy` works in"
        raise InputError.of(f"{'--ros-python' if named else VARIABLE}: {causes[0]}", mend=mend)
    looked = f" ({'; '.join(causes)})" if causes else ""
    raise InputError.of(f"no Python with rclpy is found{looked}", mend=_MEND)


def environment_for(program: str) -> Mapping[str, str]:
    """This process's environment without cfgplan's own venv, and with the program's folder first in PATH."""
    inherited = {name: value for name, value in os.environ.items() if name not in ("VIRTUAL_ENV", "PYTHONHOME")}
    folders = [one for one in os.environ.get("PATH", os.defpath).split(os.pathsep) if not _is_ours(one)]
    folder = str(Path(program).absolute().parent) if os.sep in program else ""
    if folder and folder not in folders:
        folders.insert(0, folder)
    return {**inherited, "PATH": os.pathsep.join(folders), "PYTHONUNBUFFERED": "1"}


def _is_ours(folder: str) -> bool:
    """Whether a folder of PATH is that of cfgplan's own Python, if this is a venv."""
    return sys.prefix != sys.base_prefix and Path(folder) == Path(sys.executable).parent


def _candidates() -> Iterator[str]:
    seen = set[str]()
    for folder in os.environ.get("PYTHONPATH", "").split(os.pathsep):
        for extension in sorted(Path(folder, "rclpy").glob("_rclpy_pybind11.cpython-*.so")) if folder else ():
            version = _EXTENSION.match(extension.name)
            if version is not None:
                seen.add(f"/usr/bin/python{version[1]}.{version[2]}")
    yield from sorted(seen)
    path = environment_for("")["PATH"]
    of_path = shutil.which("python3", path=path)
    if of_path is not None and of_path not in seen:
        yield of_path


def _why_not(python: RosPython) -> str | None:
    """Why a Python can't import rclpy; None if it can."""
    try:
        tried = subprocess.run(
            [python.program, "-c", _CODE],
            env=dict(python.environment),
            capture_output=True,
            text=True,
            errors="replace",
            check=False,
            timeout=_IMPORT_S,
        )
    except OSError as error:
        return error.strerror or str(error)
    except subprocess.TimeoutExpired:
        return f"imports rclpy for longer than {_IMPORT_S:g} s"
    return (tried.stderr.strip().rpartition("\n")[2] or "fails") if tried.returncode else None
