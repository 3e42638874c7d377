"""Definitions of messages: those of a ROS 2 distribution, and the `.msg` files of one's own."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable, Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cfgplan.errors import InputError, did_you_mean
from cfgplan.extras import needed
from cfgplan.onward import reached
from cfgplan.ros.types import MessageType
from cfgplan_runtime.nodes.message_layout import Kind, Layout, Several, kind_of
from cfgplan_runtime.nodes.message_values import FILLER
from cfgplan_runtime.ros2.message_form import MessageForm

if TYPE_CHECKING:
    from rosbags.interfaces.typing import Typesdict
    from rosbags.typesys.store import Typestore

USUAL_DISTRIBUTION = "jazzy"
"""The distribution of definitions if neither a parameter nor ROS_DISTRO names one."""
NO_HASH = "TypeHashNotSupported"
"""The value for a type's hash in distributions without hashes."""
_WITHOUT_HASHES = ("humble",)


class Definitions:
    """Definitions of messages: those in `files`, which may be folders, those of a distribution, and installed ones.

    A type that is in none of them is looked for as PACKAGE/msg/NAME.msg in `folder`, to which `files` are relative.
    Without a `folder`, the working folder and the folders that Python imports from are searched. Raises InputError.
    """

    def __init__(self, distribution: str | None = None, files: Sequence[str] = (), folder: Path | None = None) -> None:
        needed("ROS 2 topics", "rosbags")
        self._places = [*map(Path, ("", *sys.path))] if folder is None else [folder]
        self.distribution = distribution or os.environ.get("ROS_DISTRO") or USUAL_DISTRIBUTION
        self._store = _store_of(self.distribution)
        self._own = dict(_own_files(_found(file, self._places) for file in files))
        for name in self._own:
            self._store.fielddefs.pop(name, None)
            self._store.types.pop(name, None)

    def form(self, type: MessageType) -> MessageForm:  # noqa: A002
        """The form of a type's messages. Raises InputError if it, or a type in it, is not known or not supported."""
        self._learn(type.ros2, [])
        for name in reached([type.ros2], lambda name: _types_in(self._store.fielddefs[name][1])):
            constants, fields = self._store.fielddefs[name]
            self._store.fielddefs[name] = (constants, [(each, _without_char(what)) for each, what in fields])
        type_hash = NO_HASH if self.distribution in _WITHOUT_HASHES else self._store.hash_rihs01(type.ros2)
        return MessageForm(type, type_hash, self._store)

    def layout(self, type: MessageType) -> Layout:  # noqa: A002
        """Return the layout of a type's messages. Raises InputError if it, or a type in it, is not known."""
        self._learn(type.ros2, [])
        return self._layout(type.ros2)

    def _layout(self, name: str) -> Layout:
        fields = self._store.fielddefs[name][1]
        return Layout(name, {field: self._kind(what) for field, what in fields if field != FILLER})

    def _kind(self, what: Any) -> Kind:
        from rosbags.interfaces import Nodetype

        if what[0] == Nodetype.NAME:
            return self._layout(what[1])
        if what[0] == Nodetype.BASE:
            return kind_of(what[1][0], self._layout)
        inner, size = what[1]
        return Several(self._kind(inner), size if what[0] == Nodetype.ARRAY else None)

    def _learn(self, name: str, path: list[str]) -> None:
        """Register a type and the types of its fields."""
        if name not in self._store.fielddefs:
            self._store.register(self._read(name, path))
        for other in _types_in(self._store.fielddefs[name][1]):
            if other not in path:
                self._learn(other, [*path, name])

    def _read(self, name: str, path: Sequence[str]) -> Typesdict:
        from rosbags.typesys import get_types_from_msg

        if path and name.endswith("/wstring"):
            raise InputError.of(f"{path[-1]} has texts of wide characters (wstring), which can't be read or written")
        file = self._own.get(name) or _installed(name, self._places)
        if file is None:
            wanted = f"no definition of {name}, which {path[-1]} has, is known" if path else f"{name} is not known"
            mend = f"put its definition into {_file_of(name)} here, or start in a terminal where ROS is set up"
            raise InputError.of(wanted, mend=did_you_mean(name, self._alike(name), mend))
        try:
            return get_types_from_msg(file.read_text(encoding="utf-8"), name)
        except OSError as error:
            raise InputError.of(f"can't be read: {error.strerror}", file=str(file)) from None
        except Exception as error:
            # The parser raises errors of its own, and any others at input that it does not foresee.
            raise InputError.of(f"this is not a message definition: {error}", file=str(file)) from None

    def _alike(self, name: str) -> list[str]:
        """The known types of the same package."""
        package = name.partition("/")[0]
        return [other for other in self._store.fielddefs if other.partition("/")[0] == package]


def _store_of(distribution: str) -> Typestore:
    from rosbags.typesys import Stores, get_typestore

    known = {store.value.removeprefix("ros2_"): store for store in Stores if store.value.startswith("ros2_")}
    if distribution not in known:
        mend = did_you_mean(distribution, known, f"there is {', '.join(known)}")
        raise InputError.of(f"no definitions of a ROS 2 distribution `{distribution}` are known", mend=mend)
    return get_typestore(known[distribution])


def _own_files(paths: Iterable[Path]) -> Iterator[tuple[str, Path]]:
    """The types that files define, and folders with such files at any depth: package/msg/Name.msg, package/Name.msg."""
    for path in paths:
        inside = [path] if path.is_file() else sorted(path.rglob("*.msg"))
        if not inside:
            raise InputError.of("there is no .msg file in this folder", file=str(path))
        for file in inside:
            folder = file.resolve().parent
            package = folder.parent.name if folder.name == "msg" else folder.name
            yield f"{package}/msg/{file.stem}", file


def _found(given: str, places: Iterable[Path]) -> Path:
    for place in places:
        if (place / given).exists():
            return place / given
    raise InputError.of("there is no such file or folder of message definitions", file=given)


def _file_of(name: str) -> Path:
    package, kind, stem = name.split("/")
    return Path(package, kind, f"{stem}.msg")


def _installed(name: str, places: Iterable[Path]) -> Path | None:
    """The file of a type in one of these places, or in the packages of a ROS 2 that is set up in this terminal."""
    prefixes = filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep))
    files = (place / _file_of(name) for place in (*places, *(Path(prefix, "share") for prefix in prefixes)))
    return next((file for file in files if file.is_file()), None)


def _types_in(fields: Iterable[tuple[str, Any]]) -> Iterator[str]:
    for _, (kind, what) in fields:
        inner = what[0] if kind in _several() else (kind, what)
        if isinstance(inner[1], str):
            yield inner[1]


def _without_char(field: Any) -> Any:
    """A field with `uint8` in place of `char`: ROS 2 takes them for the same, also in hashes."""
    kind, what = field
    if kind in _several():
        inner, size = what
        return (kind, (_without_char(inner), size))
    return (kind, ("uint8", what[1])) if what[0] == "char" else field


@cache
def _several() -> tuple[Any, ...]:
    from rosbags.interfaces import Nodetype

    return Nodetype.ARRAY, Nodetype.SEQUENCE
