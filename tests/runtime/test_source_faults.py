"""Faults of unit code are told before it runs, and only those that are certain: what is found is held against a run."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from itertools import count
from pathlib import Path

import pytest
from cfgplan_runtime.children.source_faults import source_fault
from cfgplan_runtime.children.unit_code import UnitCode
from cfgplan_runtime.outside.units import check_call
from hypothesis import given, settings
from hypothesis import strategies as st

from cfgplan.domain import InputPort, OutputPort, Transformation
from cfgplan.errors import InputError

OUT = (OutputPort("out", "Out"),)
GOOD = """\
class Detector:
    def __init__(self, threshold):
        self.threshold = threshold

    def __call__(self, image):
        return image


def camera():
    yield 1
"""


def transformation(source: str, *inputs: str, **params: object) -> Transformation:
    return Transformation("t", tuple(InputPort(name, "In") for name in inputs), OUT, source=source, params=params)


def told(folder: Path, of: Transformation) -> str:
    """The fault of a source as a text, its file relative to `folder`; "" if there is none."""
    fault = source_fault(of, folder)
    return "" if fault is None else str(fault).replace(f"{folder}/", "")


@pytest.mark.parametrize(
    ("code", "of", "says"),
    [
        (GOOD, transformation("units.py:Detector", "image", threshold=5), ""),
        (GOOD, transformation("units.py:camera"), ""),
        (
            GOOD,
            transformation("unit.py:camera"),
            "unit.py: there is no such file of unit code (did you mean `units.py`?)",
        ),
        (
            GOOD,
            transformation("units.py:Detektor", "image", threshold=5),
            "units.py: the file has no Detektor (did you mean `Detector`?)",
        ),
        (
            GOOD,
            transformation("units.py"),
            "`units.py` names no unit code (write package.module:Class or units.py:Class)",
        ),
        (
            GOOD,
            transformation("nosuchmodule:Detector"),
            "there is no module nosuchmodule (install it, or put nosuchmodule.py beside the environment)",
        ),
        (
            GOOD,
            transformation("units:Detector", "image", treshold=5),
            "units.py:2:9: Detector() takes no param `treshold` (did you mean `threshold`?)",
        ),
        (
            GOOD,
            transformation("units.py:Detector", "image"),
            "units.py:2:24: Detector() needs `threshold`, which `params` lacks",
        ),
        (
            GOOD,
            transformation("units.py:Detector", "img", threshold=5),
            "units.py:5:9: Detector.__call__ takes no input `img` (did you mean `image`?)",
        ),
        (
            GOOD,
            transformation("units.py:Detector", threshold=5),
            "units.py:5:24: Detector.__call__ needs `image`, and there is no such input",
        ),
        (
            GOOD,
            transformation("units.py:camera", "image"),
            "units.py:9:5: camera takes no input `image` (remove it there: the code takes none)",
        ),
        (
            "import nosuchmodule\n" + GOOD,
            transformation("units.py:camera"),
            "units.py:1:8: it imports nosuchmodule, which is not there",
        ),
        (
            "try:\n    import nosuchmodule\nexcept ImportError:\n    pass\n" + GOOD,
            transformation("units.py:camera"),
            "",
        ),
        ("import sys\nsys.path.append('/x')\nimport nosuchmodule\n" + GOOD, transformation("units.py:camera"), ""),
        ("from nosuchmodule import *\n" + GOOD, transformation("units.py:other"), ""),
        (
            "def camera(:\n",
            transformation("units.py:camera"),
            "units.py:1:12: SyntaxError: invalid syntax (correct it)",
        ),
        (
            "class Lamp:\n    pass\n",
            transformation("units.py:Lamp", "on"),
            "units.py:1:7: Lamp can't be called (give it a __call__ method)",
        ),
        (
            "class Lamp:\n    pass\n",
            transformation("units.py:Lamp"),
            "units.py:1:7: Lamp has no inputs, so it needs __iter__ or __call__ (give it a __call__ method)",
        ),
        (
            "def lamp(on, *, level):\n    return on\n",
            transformation("units.py:lamp", "on"),
            "units.py:1:17: lamp needs `level`, which is neither a param nor an input",
        ),
        (
            "def lamp(on):\n    box = object()\n    box.level = on\n    return box\n",
            transformation("units.py:lamp", "off"),
            "units.py:1:5: lamp takes no input `off`",
        ),
        (
            "x = 3\n",
            transformation("units.py:lamp"),
            "units.py: the file has no lamp (it has nothing that can be called)",
        ),
        (
            GOOD,
            transformation("program:./absent"),
            "absent: there is no file ./absent (files are relative to the environment file)",
        ),
        (GOOD, transformation("node:a/b"), ""),
    ],
)
def test_a_fault_is_told_with_its_line_and_its_mend(tmp_path: Path, code: str, of: Transformation, says: str) -> None:
    (tmp_path / "units.py").write_text(code)
    found = told(tmp_path, of)
    assert found.startswith(says) if says else not found


@pytest.mark.parametrize("source", ["program:./tool", "program:./none", "units.py:camera", "none.py:camera"])
def test_a_fault_is_the_same_from_wherever_its_folder_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, source: str
) -> None:
    """A run in the folder of its file told a program's fault twice, with two names of the file."""
    (tmp_path / "tool").write_text("#!/bin/sh\n")
    (tmp_path / "units.py").write_text("def camra(): pass\n")
    (tmp_path / "linked").symlink_to(tmp_path, target_is_directory=True)
    monkeypatch.chdir(tmp_path)
    whole = source_fault(transformation(source), tmp_path)
    assert whole is not None
    assert {source_fault(transformation(source), folder) for folder in (Path(), Path("linked"))} == {whole}


def test_no_code_is_run(tmp_path: Path) -> None:
    (tmp_path / "loud").mkdir()
    (tmp_path / "loud" / "__init__.py").write_text("raise RuntimeError('was imported')\n")
    (tmp_path / "loud" / "units.py").write_text("raise RuntimeError('was run')\n" + GOOD)
    assert told(tmp_path, transformation("loud.units:camera")) == ""
    assert told(tmp_path, transformation("loud.units:lamp")).startswith("loud/units.py: the file has no lamp")


NAMES = ("a", "b", "c")
NUMBERS = count()


@dataclass(frozen=True)
class Code:
    """Unit code, and what is said of it in a file."""

    text: str
    params: tuple[str, ...]
    inputs: tuple[str, ...]
    is_plain: bool
    """Whether nothing hides what it takes."""


@st.composite
def signatures(draw: st.DrawFn, first: str) -> str:
    parts = [first] if first else []
    plain, named = draw(st.lists(st.sampled_from(NAMES), unique=True, max_size=3)), []
    if draw(st.booleans()):
        plain, named = plain[:1], plain[1:]
    defaults = draw(st.integers(0, len(plain)))
    parts += [name if at < len(plain) - defaults else f"{name}=0" for at, name in enumerate(plain)]
    if named:
        parts += ["*", *(f"{name}{draw(st.sampled_from(['', '=0']))}" for name in named)]
    if draw(st.booleans()):
        parts.append("**more")
    return ", ".join(parts)


@st.composite
def codes(draw: st.DrawFn) -> Code:
    some = st.lists(st.sampled_from(NAMES), unique=True, max_size=2).map(tuple)
    params, inputs = draw(some), draw(some)
    hides = draw(st.sampled_from(["", "", "", "decorated", "inherits", "assigned", "changed"]))
    mark = "@(lambda it: it)\n" if hides == "decorated" else ""
    if draw(st.booleans()):
        text = f"{mark}def Unit({draw(signatures(''))}):\n    return None\n"
    else:
        methods = draw(
            st.lists(st.sampled_from(["__init__", "__call__", "__iter__", "other"]), unique=True, min_size=1)
        )
        takes = {name: "self" if name == "__iter__" else draw(signatures("self")) for name in methods}
        gives = {"__iter__": "iter(())"}
        body = "".join(f"    def {name}({takes[name]}):\n        return {gives.get(name)}\n" for name in methods)
        inherited = draw(st.sampled_from(["", "(object)", "(Base)"])) if hides != "inherits" else "(dict)"
        base = f"class Base:\n    def __call__({draw(signatures('self'))}):\n        return None\n"
        text = f"{base}{mark}class Unit{inherited}:\n{body}"
    if hides == "assigned":
        text += "Unit = Unit\n"
    if hides == "changed":
        text += "Unit.level = 3\n"
    return Code(text, params, inputs, not hides)


def fails(code: Code, folder: Path, file: str) -> bool:
    """Whether units of this code really can't be made, or can't do their first step."""
    params = dict.fromkeys(code.params, 1)
    try:
        made = UnitCode(f"{file}:Unit", params, ("out",), folder=str(folder), is_source=not code.inputs)
        if code.inputs:
            list(made.step(dict.fromkeys(code.inputs, 1)))
        else:
            next(made.produce())
    except StopIteration:
        return False
    except Exception:
        return True
    return False


@settings(max_examples=300, deadline=None)
@given(code=codes())
def test_what_is_found_fails_and_what_fails_is_found_unless_it_is_hidden(
    code: Code, tmp_path_factory: pytest.TempPathFactory
) -> None:
    folder = tmp_path_factory.getbasetemp()
    file = f"drawn_{next(NUMBERS)}.py"
    (folder / file).write_text(code.text)
    found = told(folder, transformation(f"{file}:Unit", *code.inputs, **dict.fromkeys(code.params, 1)))
    is_broken = fails(code, folder, file)
    assert is_broken or not found, (code.text, found)
    assert found or not is_broken or not code.is_plain, code.text


BROKER = "localhost:1883"


@pytest.mark.parametrize(
    ("source", "params", "says"),
    [
        ("mqtt:Subscriber", {"broker": BROKER, "topic": "house/+"}, ""),
        ("mqtt:Subscriber", {"broker": BROKER, "tpic": "t"}, "MQTT has no parameter `tpic` (did you mean `topic`?)"),
        ("mqtt:Subscriber", {"broker": BROKER}, "`params` has no `topic` (add it to `params`)"),
        ("mqtt:Subscriber", {"broker": BROKER, "topic": 5}, "`topic` must be a text, but is 5 (put quotes around it)"),
        ("mqtt:Subscriber", {}, "`params` has no `broker` and no `topic`"),
        ("mqtt:Subscriber", {"broker": BROKER, "topic": "a", "payload": "float"}, "`float` is not a form of payload"),
        ("mqtt:Subscriber", {"broker": BROKER, "topic": "a/#/b"}, "`a/#/b` is not a topic filter"),
        ("mqtt:Subscriber", {"broker": "a:b:c", "topic": "a"}, "`a:b:c` is not the address of a broker"),
        ("mqtt:Subscriber", {"broker": BROKER, "topic": "a", "qos": 3}, "`3` is not a quality of service of MQTT"),
        ("mqtt:Subscriber", {"broker": BROKER, "topic": "a", "password": "x"}, "can't hold a password"),
        ("mqtt:Publisher", {"broker": BROKER, "topic": "a", "retian": True}, "did you mean `retain`?"),
        ("mqtt:Publisher", {"broker": BROKER, "topic": "a/+"}, "`a/+` is not a topic to publish on"),
        ("zenoh:Subscriber", {"key_expr": "a", "with_kye": True}, "did you mean `with_key`?"),
        ("zenoh:Publisher", {}, "`params` has no `key_expr`"),
        ("zenoh:Publisher", {"key_expr": "a"}, "a Zenoh session needs an endpoint"),
        ("zenoh:Publisher", {"key_expr": "a/*", "listen": "tcp/[::]:1"}, "`a/*` can't be published to"),
        (
            "zenoh:Publisher",
            {"key_expr": "a", "listen": "tcp/[::]:1", "when_full": "wait"},
            "`when_full` can't be `wait`",
        ),
        ("zenoh:Publisher", {"key_expr": "a", "listen": "tcp/[::]:1"}, ""),
        ("http:Poller", {"url": "http://a", "payloda": "text"}, "did you mean `payload`?"),
        ("mqtt:Subscriber", {"broker": BROKER, "topic": "a", "keepalive": 0}, "`0` can't be a keepalive"),
        ("mqtt:Subscriber", {"broker": BROKER, "topic": "a", "keepalive": "5s"}, "`5s` can't be a keepalive"),
        ("mqtt:Publisher", {"broker": BROKER, "topic": "a", "will": {"topic": "a/#"}}, "`will` has no topic"),
        ("mqtt:Subscriber", {"broker": "mqtt://[::1]", "topic": "a"}, ""),
        ("http:Poller", {"url": "http://["}, "`http://[` is not the URL of a resource"),
        ("http:Poller", {"url": "http://a:b"}, "`http://a:b` is not the URL of a resource"),
        ("http:Poller", {"url": "http://a", "payload": "text", "token_env": "T"}, ""),
    ],
)
def test_params_of_ready_made_units_are_checked_before_they_start(
    tmp_path: Path, source: str, params: dict[str, object], says: str
) -> None:
    inputs = ("x",) if source.endswith("Publisher") else ()
    fault = told(tmp_path, transformation(f"cfgplan_runtime.{source}", *inputs, **params))
    assert says in fault
    assert bool(fault) == bool(says)


def test_a_module_of_cfgplan_that_can_not_be_imported_here_is_a_fault(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "rclpy", None)
    monkeypatch.delitem(sys.modules, "cfgplan_runtime.ros2.host.qos", raising=False)
    fault = told(tmp_path, transformation("cfgplan_runtime.ros2.host.qos:Profile"))
    assert "cfgplan_runtime.ros2.host.qos can't be imported" in fault


def test_a_text_that_has_a_default_may_be_left_out_of_the_params() -> None:
    def connect(broker: str, name: str = "usual") -> None:
        """Stands for the constructor of unit code."""

    check_call(connect, "MQTT", [], {"broker": "b"})
    with pytest.raises(InputError, match="`name` must be a text, but is 5"):
        check_call(connect, "MQTT", [], {"broker": "b", "name": 5})
