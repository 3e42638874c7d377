"""No two classes, types or constants of one room have the same name, no two modules of tests, and no two files."""

from __future__ import annotations

import ast
from collections import Counter, defaultdict
from pathlib import Path

ROOT = Path(__file__).parent.parent
ALLOWED = {"__all__", "__getattr__", "__dir__"}
"""What Python asks each package for."""
STARTED = {"talking.py"}
"""Units that tests start as processes: no test imports them."""


def test_no_two_classes_types_or_constants_of_a_room_have_one_name() -> None:
    homes = defaultdict(list)
    for top in ("cfgplan", "runtime/cfgplan_runtime"):
        for path in sorted((ROOT / top).rglob("*.py")):
            room = (*path.relative_to(ROOT / top).parts[:-1], "")[0]
            for name in _names(ast.parse(path.read_text(encoding="utf-8"))):
                homes[top, room, name].append(path.relative_to(ROOT).as_posix())
    double = {key: files for key, files in homes.items() if len(files) > 1}
    assert {name: files for (_, _, name), files in double.items() if name not in ALLOWED} == {}


def test_no_two_modules_of_tests_have_one_name() -> None:
    """pytest imports them without their folder: of two that have one name, the second one can't be collected."""
    files = [path for path in (ROOT / "tests").rglob("*.py") if path.name != "conftest.py"]
    names = Counter(path.stem for path in files if path.name not in STARTED)
    assert [name for name, number in names.items() if number > 1] == []


def test_no_two_files_differ_only_in_the_case_of_letters() -> None:
    """On macOS, a clone would have only one of them."""
    tops = ("cfgplan", "runtime", "models", "experiments", "tests")
    names = Counter(path.as_posix().lower() for top in tops for path in (ROOT / top).rglob("*"))
    assert [name for name, number in names.items() if number > 1] == []


def _names(module: ast.Module) -> list[str]:
    """Those of the module's classes and of what it assigns, but for type variables, which belong to their functions."""
    assigned = [node for part in module.body if isinstance(part, ast.Assign | ast.AnnAssign) for node in _targets(part)]
    return [
        *(part.name for part in module.body if isinstance(part, ast.ClassDef)),
        *(node.id for target in assigned for node in ast.walk(target) if isinstance(node, ast.Name)),
    ]


def _targets(part: ast.Assign | ast.AnnAssign) -> list[ast.expr]:
    if isinstance(part.value, ast.Call) and ast.unparse(part.value.func) == "TypeVar":
        return []
    return part.targets if isinstance(part, ast.Assign) else [part.target]
