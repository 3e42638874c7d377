"""Substitutions such as `$(arg ...)` and `$(find ...)` in launch files of ROS 1."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from cfgplan.extras import needed

_SUBSTITUTION = re.compile(r"\$\(([^()]*)\)")
_EVAL = re.compile(r"\$\(eval (.*)\)", re.DOTALL)
_INSTALLED = ("/opt/ros/*/share/*", "/usr/share/*")
_DEEPEST = 6
_UNCRAWLED = ("CATKIN_IGNORE", "COLCON_IGNORE", ".git")


class SubstitutionError(Exception):
    """A substitution that can't be evaluated; the message says why."""


class PackageMissingError(SubstitutionError):
    """A package that is not on this computer."""


@dataclass(frozen=True)
class Substitutions:
    """The substitutions of a launch file, given its arguments."""

    file: Path
    arguments: Mapping[str, str]

    def text(self, text: str) -> str:
        """Return a text with its substitutions replaced. Raises SubstitutionError."""
        whole = _EVAL.fullmatch(text.strip())
        if whole:
            return str(self._evaluated(whole[1]))
        return _SUBSTITUTION.sub(lambda found: self._meant(found[1]), text)

    def _meant(self, inner: str) -> str:
        word, *rest = inner.split()
        match (word, rest) if inner.strip() else ("", []):
            case ("arg", [name]):
                return self._argument(name)
            case ("env", [name]):
                return variable(name)
            case ("optenv", [name, *default]):
                return os.environ.get(name, " ".join(default))
            case ("find", [package]):
                return str(self._package(package))
            case ("anon", [name]):
                return name
            case ("dirname", []):
                return str(self.file.parent)
        raise SubstitutionError(f"`$({inner})` is not a substitution of launch files")

    def _argument(self, name: str) -> str:
        if name not in self.arguments:
            raise SubstitutionError(f"the argument `{name}` has no value")
        return self.arguments[name]

    def _package(self, name: str) -> Path:
        found = package_folder(name, self.file)
        if found is None:
            raise PackageMissingError(f"the package `{name}` is not found")
        return found

    def _evaluated(self, expression: str) -> object:
        functions: dict[str, Callable[..., object]] = {
            "arg": lambda name: valued(self._argument(name)),
            "find": lambda name: str(self._package(name)),
            "dirname": lambda: str(self.file.parent),
        }
        return evaluated(expression, {name: valued(text) for name, text in self.arguments.items()}, functions)


def evaluated(
    expression: str, names: Mapping[str, object], functions: Mapping[str, Callable[..., object]] | None = None
) -> object:
    """The value of an expression of `$(eval ...)`, which can use these names. Raises SubstitutionError."""
    needed("launch files with `$(eval ...)`", "simpleeval")
    from simpleeval import EvalWithCompoundTypes, InvalidExpression

    known: dict[str, Any] = {
        **{name: each for name, each in vars(math).items() if callable(each) and not name.startswith("_")},
        "int": int,
        "float": float,
        "str": str,
        "env": variable,
        "optenv": os.environ.get,
        "anon": str,
        **(functions or {}),
    }
    constants = {"true": True, "false": False, "True": True, "False": False, "pi": math.pi, "e": math.e}
    try:
        return EvalWithCompoundTypes(functions=known, names={**names, **constants}).eval(expression)
    except (InvalidExpression, SyntaxError, TypeError, ValueError, ArithmeticError, LookupError) as error:
        raise SubstitutionError(f"`{expression}` can't be evaluated: {error}") from None


def valued(text: str) -> object:
    """Return the value of a text of no declared type, as launch files read it: a number, true or false, or the text."""
    try:
        if "." in text:
            return float(text)
        if "_" not in text:
            return int(text)
    except ValueError:
        pass
    return {"true": True, "false": False}.get(text.lower(), text)


def variable(name: str) -> str:
    """The value of an environment variable. Raises SubstitutionError if it is not set."""
    if name not in os.environ:
        raise SubstitutionError(f"the environment variable `{name}` is not set")
    return os.environ[name]


def package_folder(name: str, near: Path) -> Path | None:
    """The folder of a package: where the environment says, in the workspace of the file `near`, or installed."""
    own = next((folder for folder in near.resolve().parents if (folder / "package.xml").is_file()), None)
    workspace = [own.parent] if own is not None else []
    for root in [*_roots("ROS_PACKAGE_PATH"), *workspace, *_roots("AMENT_PREFIX_PATH"), *_roots("COLCON_PREFIX_PATH")]:
        if name in _packages(root):
            return _packages(root)[name]
    for pattern in _INSTALLED:
        for manifest in sorted(Path("/").glob(f"{pattern[1:-1]}{name}/package.xml")):
            return manifest.parent
    return None


def _roots(variable: str) -> list[Path]:
    return [Path(root) for root in os.environ.get(variable, "").split(os.pathsep) if root]


@cache
def _packages(root: Path) -> Mapping[str, Path]:
    """Return the packages below a folder, by name; the first one of each name."""
    found: dict[str, Path] = {}
    for folder in _package_folders(root, _DEEPEST):
        found.setdefault(_name_in(folder / "package.xml") or folder.name, folder)
    return found


def _package_folders(folder: Path, depth: int) -> Iterator[Path]:
    if (folder / "package.xml").is_file():
        yield folder
        return
    if depth and not any((folder / mark).exists() for mark in _UNCRAWLED[:2]):
        try:
            inside = sorted(each for each in folder.iterdir() if each.is_dir() and each.name not in _UNCRAWLED)
        except OSError:
            return
        for each in inside:
            yield from _package_folders(each, depth - 1)


def _name_in(manifest: Path) -> str | None:
    """The name that a package.xml says."""
    try:
        return (ElementTree.parse(manifest).getroot().findtext("name") or "").strip() or None
    except (ElementTree.ParseError, OSError):
        return None
