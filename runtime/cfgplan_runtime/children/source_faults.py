"""Faults of unit code before it runs: files, names, imports and signatures, read as text and never imported.

Only certain faults are told. A class that is decorated, inherits from elsewhere or makes its methods at run time may
take anything; `unit_code` says how code is found and called when it runs.
"""

from __future__ import annotations

import ast
import importlib
import importlib.util
import sys
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import lru_cache
from importlib.machinery import PathFinder
from pathlib import Path

from cfgplan.errors import Fault, InputError, did_you_mean
from cfgplan.file_content import content_of
from cfgplan.ros.sources import NodeSource
from cfgplan.summary import some
from cfgplan.transformations import Transformation
from cfgplan_runtime.children.program_source import ProgramSource

_FORM = "write package.module:Class or units.py:Class"
_MOST_NAMED = 6
_OWN = "cfgplan_runtime."
"""The prefix of the modules with cfgplan's own unit code."""
_Definition = ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef
_DYNAMIC = frozenset({"__getattr__", "exec", "eval", "globals", "setattr", "vars", "locals"})
"""Names by which a module may define others at run time."""


def source_fault(transformation: Transformation, folder: Path) -> Fault | None:
    """The fault that keeps units of a transformation from being started; None if none is found.

    The fault's file is that of the code, where it has one. `folder` is what files are relative to.
    """
    return fault_of(lambda: _check(transformation, folder), folder)


def fault_of(check: Callable[[], object], folder: Path) -> Fault | None:
    """The first fault that a check raises, with its file relative to the folder; None without one."""
    try:
        check()
    except InputError as error:
        fault = error.faults[0]
        if fault.file is None:
            return fault
        file = Path(fault.file)  # programs and nodes tell their own with all of its path
        base = next((base for base in (folder, folder.resolve()) if file.is_relative_to(base)), None)
        return fault if base is None else replace(fault, file=str(file.relative_to(base)))
    return None


def _check(transformation: Transformation, folder: Path) -> None:
    """Raise InputError."""
    source = transformation.source
    if source is None or NodeSource.read(source) is not None:
        return
    program = ProgramSource.read(source)
    if program is not None:
        program.file(folder)
    else:
        _check_python(transformation, source, folder)


def code_path(source: str | None, folder: Path) -> Path | None:
    """The file whose change may mend a fault of a source, there or not; None if there is none."""
    try:
        if source is None or NodeSource.read(source) is not None:
            return None
        program = ProgramSource.read(source)
    except InputError:
        return None
    if program is not None:
        return folder / program.name if "/" in program.name else None
    place = source.rpartition(":")[0]
    return folder / place if place.endswith(".py") else _module_file(place, folder)


def _check_python(transformation: Transformation, source: str, folder: Path) -> None:
    """Raise InputError."""
    place, colon, name = source.rpartition(":")
    if not (colon and place and name):
        raise InputError.of(f"`{source}` names no unit code", mend=_FORM)
    if place.endswith(".py"):
        path: Path | None = folder / place
        if not (folder / place).is_file():
            raise InputError.of("there is no such file of unit code", file=str(path), mend=_beside(place, folder))
    else:
        path = _module_file(place, folder)
        top = place.partition(".")[0]
        if path is None and not _is_importable(top, [folder]):
            raise InputError.of(f"there is no module {top}", mend=f"install it, or put {top}.py beside the environment")
    if path is None:
        return
    if place.startswith(_OWN):
        _check_own(transformation, place, name)
    module = _read(path, _stamp(path))
    _check_imports(module, [path.parent, folder])
    definition = module.named(name.partition(".")[0])
    if definition is not None and "." not in name and not module.is_dynamic:
        _Unit(transformation, module, name).check(definition)


def _check_own(transformation: Transformation, place: str, name: str) -> None:
    """Raise InputError if cfgplan's own unit code does not accept the params. It may be imported before a run."""
    try:
        module = importlib.import_module(place)
    except ImportError as error:
        mend = "name unit code, such as cfgplan_runtime.mqtt:Subscriber"
        raise InputError.of(f"{place} can't be imported: {error}", mend=mend) from None
    check = getattr(getattr(module, name, None), "check_params", None)
    if check is not None:
        check(transformation.params)


def _beside(place: str, folder: Path) -> str:
    there = sorted(path.name for path in folder.glob("*.py"))
    return did_you_mean(place, there) or "files are relative to the environment file"


@dataclass(frozen=True)
class _Module:
    """A parsed file of unit code."""

    path: Path
    tree: ast.Module
    names: frozenset[str]
    """Every name that a statement outside of functions and classes binds."""
    is_dynamic: bool
    """Whether it may define other names at run time."""
    lines: tuple[str, ...] = ()

    def fault(self, message: str, node: ast.AST | None, mend: str | None = None) -> InputError:
        line = getattr(node, "lineno", None)
        return InputError([Fault(message, str(self.path), line, self._column(node), mend=mend)])

    def _column(self, node: ast.AST | None) -> int | None:
        """The column, from 1, of a node; for a function or class, the column of its name."""
        number, offset = getattr(node, "lineno", 0), getattr(node, "col_offset", 0)
        if not 0 < number <= len(self.lines):
            return None
        line = self.lines[number - 1]
        column = len(line.encode()[:offset].decode(errors="replace"))
        if isinstance(node, _Definition):
            column = max(column, line.find(node.name, column + len("def")))
        return column + 1

    def named(self, name: str) -> _Definition | None:
        """The one definition of a name; None if it is made in another way. Raises InputError if there is none."""
        if name not in self.names and not self.is_dynamic:
            callables = [one.name for one in self.tree.body if isinstance(one, _Definition)]
            there = some(callables, _MOST_NAMED) if callables else "nothing that can be called"
            raise self.fault(f"the file has no {name}", None, did_you_mean(name, callables, f"it has {there}"))
        found = [one for one in self.tree.body if isinstance(one, _Definition) and one.name == name]
        others = [one for one in _bound(self.tree.body) if one == name]
        return found[0] if len(found) == len(others) == 1 and not found[0].decorator_list else None


def _read(path: Path, stamp: tuple[int, int] | None) -> _Module:
    """Raise InputError for a file that is not Python."""
    parsed = _parsed(path, stamp)
    if isinstance(parsed, Fault):
        raise InputError([parsed])
    return parsed


@lru_cache(maxsize=512)
def _parsed(path: Path, stamp: tuple[int, int] | None) -> _Module | Fault:  # noqa: ARG001
    try:
        data = content_of(path)
        tree = ast.parse(data, str(path))
    except SyntaxError as error:
        return Fault(f"{type(error).__name__}: {error.msg}", str(path), error.lineno, error.offset, mend="correct it")
    except OSError as error:
        return Fault(f"can't be read: {error.strerror}", str(path), mend="see its permissions")
    except (ValueError, RecursionError, MemoryError) as error:
        return Fault(f"can't be parsed: {error}", str(path), mend="correct it")
    names = frozenset(_bound(tree.body))
    lines = tuple(data.decode(errors="replace").splitlines())
    return _Module(path, tree, names, bool(_DYNAMIC & names) or _is_dynamic(tree, names), lines)


def _stamp(path: Path) -> tuple[int, int] | None:
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_mtime_ns, found.st_size


def _bound(statements: Iterable[ast.stmt]) -> Iterator[str]:
    """The names that statements bind, each as often as they do; not those inside functions and classes."""
    for statement in statements:
        if isinstance(statement, _Definition):
            yield statement.name
            continue
        todo: list[ast.AST] = [statement]
        while todo:
            node = todo.pop()
            if isinstance(node, _Definition):
                yield node.name
                continue
            if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
                yield node.id
            elif isinstance(node, ast.alias):
                yield node.asname or node.name.partition(".")[0]
            elif isinstance(node, ast.ExceptHandler | ast.MatchAs | ast.MatchStar) and node.name:
                yield node.name
            todo += ast.iter_child_nodes(node)


def _is_dynamic(tree: ast.Module, names: Collection[str]) -> bool:
    """Whether code may define other names, change where modules come from (`sys`, `importlib`, `site`), or change
    the classes of its `names`.
    """
    for node in ast.walk(tree):
        if isinstance(node, ast.Name) and node.id in _DYNAMIC:
            return True
        if isinstance(node, ast.ImportFrom) and any(alias.name == "*" for alias in node.names):
            return True
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            if node.value.id == "sys" and node.attr in ("path", "modules", "meta_path", "path_hooks"):
                return True
            if isinstance(node.ctx, ast.Store) and node.value.id in names:
                return True
        if isinstance(node, ast.Import) and any(alias.name.startswith(("importlib", "site")) for alias in node.names):
            return True
    return False


def _check_imports(module: _Module, folders: Sequence[Path]) -> None:
    """Raise InputError for a module that is imported whatever happens, and is not there."""
    if module.is_dynamic:
        return
    for statement in module.tree.body:
        names: list[tuple[str, ast.AST]] = []
        if isinstance(statement, ast.Import):
            names = [(alias.name, alias) for alias in statement.names]
        elif isinstance(statement, ast.ImportFrom) and statement.module and not statement.level:
            names = [(statement.module, statement)]
        for name, at in names:
            top = name.partition(".")[0]
            if not _is_importable(top, folders):
                mend = "install it into the Python that runs cfgplan, or correct its name"
                raise module.fault(f"it imports {top}, which is not there", at, mend)


def _is_importable(top: str, folders: Sequence[Path]) -> bool:
    """Whether a module without dots in its name can be found; nothing is imported."""
    if top in sys.stdlib_module_names or top in sys.modules:
        return True
    if PathFinder.find_spec(top, [str(folder.resolve()) for folder in folders]) is not None:
        return True
    with suppress(ValueError):
        return importlib.util.find_spec(top) is not None
    return True


def _module_file(name: str, folder: Path) -> Path | None:
    """The Python file of a module, found without importing its packages; None if it can't be told."""
    places: list[str] | None = [str(folder.resolve()), *sys.path]
    spec = None
    for part in name.split("."):
        if places is None:
            return None
        spec = PathFinder.find_spec(part, places)
        if spec is None:
            return None
        places = None if spec.submodule_search_locations is None else list(spec.submodule_search_locations)
    path = Path(spec.origin) if spec is not None and spec.origin is not None else None
    return path if path is not None and path.suffix == ".py" else None


@dataclass(frozen=True)
class _Signature:
    """The arguments that a function takes by name."""

    takes: frozenset[str]
    needs: Mapping[str, ast.AST]
    """With where each is written."""
    takes_any: bool

    @classmethod
    def of(cls, arguments: ast.arguments, *, is_method: bool) -> _Signature:
        plain = [*arguments.posonlyargs, *arguments.args]
        first = 1 if is_method and plain else 0
        filled = len(plain) - len(arguments.defaults)
        needed = plain[first:filled]
        needed += [
            one for one, default in zip(arguments.kwonlyargs, arguments.kw_defaults, strict=True) if default is None
        ]
        by_name = [*arguments.args, *arguments.kwonlyargs]
        taken = {one.arg for one in by_name} - {one.arg for one in plain[:first]}
        return cls(frozenset(taken), {one.arg: one for one in needed}, arguments.kwarg is not None)


_NOTHING = _Signature(frozenset(), {}, takes_any=False)


@dataclass(frozen=True)
class _Unit:
    """A transformation held against the code of its units. All methods raise InputError for a fault that is certain."""

    transformation: Transformation
    module: _Module
    name: str

    def check(self, definition: _Definition) -> None:
        params, inputs = [*self.transformation.params], [port.name for port in self.transformation.inputs]
        if isinstance(definition, ast.ClassDef):
            self._check_class(definition, params, inputs)
            return
        signature = _Signature.of(definition.args, is_method=False)
        self._check_names(signature, params, f"{self.name} takes no param `{{}}`", definition)
        self._check_names(signature, inputs, f"{self.name} takes no input `{{}}`", definition)
        lacking = f"{self.name} needs `{{}}`, which is neither a param nor an input"
        self._check_needs(signature, [*params, *inputs], lacking)

    def _check_class(self, definition: ast.ClassDef, params: Sequence[str], inputs: Sequence[str]) -> None:
        if self._is_unknown(definition):
            return
        made = self._method(definition, "__init__")
        if made is not None:
            signature = _NOTHING if made is _ABSENT else _Signature.of(made.args, is_method=True)
            at = definition if made is _ABSENT else made
            self._check_names(signature, params, f"{self.name}() takes no param `{{}}`", at)
            self._check_needs(signature, params, f"{self.name}() needs `{{}}`, which `params` lacks")
        if not inputs and self._method(definition, "__iter__") is not _ABSENT:
            return
        called = self._method(definition, "__call__")
        if called is _ABSENT:
            what = "has no inputs, so it needs __iter__ or __call__" if not inputs else "can't be called"
            raise self.module.fault(f"{self.name} {what}", definition, "give it a __call__ method")
        if called is not None:
            signature = _Signature.of(called.args, is_method=True)
            self._check_names(signature, inputs, f"{self.name}.__call__ takes no input `{{}}`", called)
            lacking = f"{self.name}.__call__ needs `{{}}`, and there is no such input"
            self._check_needs(signature, inputs, lacking)

    def _check_names(self, signature: _Signature, names: Collection[str], message: str, at: ast.AST) -> None:
        for name in names:
            if name not in signature.takes and not signature.takes_any:
                taken = sorted(signature.takes)
                there = f"it takes {some(taken, _MOST_NAMED)}" if taken else "remove it there: the code takes none"
                raise self.module.fault(message.format(name), at, did_you_mean(name, taken, there))

    def _check_needs(self, signature: _Signature, names: Collection[str], message: str) -> None:
        for name, at in signature.needs.items():
            if name not in names:
                mend = did_you_mean(name, names, "name it in the file, or give it a default")
                raise self.module.fault(message.format(name), at, mend)

    def _is_unknown(self, definition: ast.ClassDef) -> bool:
        """Whether more than its own body and those of plain classes of the module says what a class can do."""
        return any(base is None for base in self._line(definition))

    def _line(self, definition: ast.ClassDef, depth: int = 0) -> Iterator[ast.ClassDef | None]:
        """The class and those that it inherits from, in this module; None for one that is not known."""
        yield definition
        names = set(_bound(definition.body))
        if definition.keywords or definition.decorator_list or "__new__" in names or depth > _MOST_NAMED:
            yield None
        for base in definition.bases:
            if isinstance(base, ast.Name) and base.id == "object":
                continue
            with suppress(InputError):
                found = self.module.named(base.id) if isinstance(base, ast.Name) else None
                if isinstance(found, ast.ClassDef):
                    yield from self._line(found, depth + 1)
                    continue
            yield None

    def _method(self, definition: ast.ClassDef, name: str) -> ast.FunctionDef | None:
        """A method by its definition, `_ABSENT` if there is none; None if it is made in another way."""
        for one in self._line(definition):
            if one is not None and name in _bound(one.body):
                found = [each for each in one.body if isinstance(each, ast.FunctionDef) and each.name == name]
                times = sum(bound == name for bound in _bound(one.body))
                return found[0] if len(found) == times == 1 and not found[0].decorator_list else None
        return _ABSENT


_ABSENT = next(one for one in ast.parse("def absent(): ...").body if isinstance(one, ast.FunctionDef))
"""Stands for a method that there is not."""
