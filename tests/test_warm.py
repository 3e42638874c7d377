"""A warm `cfgplan` is the command that a new process would be."""

from __future__ import annotations

import json
import os
import select
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import warm
import warm_cfgplan
from warm_python import WarmPython, warm_subprocess

MODELS = Path(__file__).parents[1] / "models"
LOST = MODELS / "nao" / "2-segmenter-lost.yaml"
PATIENCE_S = 60
pytestmark = pytest.mark.usefixtures("warm_cfgplan")
RUN = ("run", MODELS / "building" / "alarms-1-start.yaml", "--json", "--no-estimates")


def done(line: list[str], **more: object) -> tuple[int, bytes, bytes]:
    """The exit code of a command, and what it says, without its times."""
    said = subprocess.run(line, capture_output=True, timeout=PATIENCE_S, check=False, **more)  # type: ignore[call-overload]
    return said.returncode, said.stdout, b"".join(each for each in said.stderr.splitlines() if b"Time: " not in each)


@pytest.mark.parametrize("arguments", [("solve", LOST), ("solve", "nothere.yaml"), ("--help",), ("slove",)])
def test_a_warm_command_ends_and_says_what_a_cold_one_does(arguments: tuple[object, ...]) -> None:
    assert done(warm.command(*arguments)) == done(warm.cold_command(*arguments))


@pytest.fixture
def own_planner(tmp_path: Path) -> Callable[[str], tuple[list[str], dict[str, str]]]:
    """The command line that plans with this code, and its environment."""

    def planned(code: str) -> tuple[list[str], dict[str, str]]:
        (tmp_path / "own.py").write_text(f"import os, signal, sys\ndef plan(problem, **_):\n    {code}\n")
        where = os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")])
        return warm.command("solve", LOST, "--planner", "own:plan"), os.environ | {"PYTHONPATH": where, "TOLD": "é"}

    return planned


OwnPlanner = Callable[[str], tuple[list[str], dict[str, str]]]


def test_it_has_the_folder_the_environment_and_the_input_of_its_caller(own_planner: OwnPlanner, tmp_path: Path) -> None:
    line, environment = own_planner("open('told', 'w').write(os.environ['TOLD'] + sys.stdin.read())")
    done(line, cwd=tmp_path, env=environment, input=b" heard")
    assert (tmp_path / "told").read_text() == "é heard"


def test_it_ends_by_the_signal_that_ends_its_command(own_planner: OwnPlanner) -> None:
    line, environment = own_planner("os.kill(os.getpid(), signal.SIGKILL)")
    assert done(line, env=environment) == (-signal.SIGKILL, b"", b"")


@pytest.fixture
def run(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> Iterator[subprocess.Popen[bytes]]:
    """A run that has begun."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path_factory.mktemp("r")))
    with subprocess.Popen(warm.command(*RUN), stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert b"Planned" in process.stdout.readline()
        assert b"Running" in process.stdout.readline()
        yield process
        process.kill()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_to_the_caller_is_one_to_the_command(number: int, run: subprocess.Popen[bytes]) -> None:
    run.send_signal(number)
    assert b"Observed" in run.communicate(timeout=PATIENCE_S)[0]
    assert run.returncode == 0


def test_a_killed_caller_takes_its_command_along(run: subprocess.Popen[bytes]) -> None:
    run.kill()
    assert run.stdout is not None
    assert b"Observed" not in run.stdout.read(), "it is read until each process of the command has ended"


def test_a_caller_ends_after_the_process_that_answers_it(tmp_path: Path) -> None:
    """A test that looks for processes after its command finds none of the command's."""
    path = str(tmp_path / "socket")
    with socket.socket(socket.AF_UNIX) as server, subprocess.Popen(["cat"], stdin=subprocess.PIPE) as answering:
        server.bind(path)
        server.listen()
        with subprocess.Popen([sys.executable, "-I", "-S", warm_cfgplan.__file__, path]) as caller:
            call, _ = server.accept()
            with call:
                call.sendall(b"".join(number.to_bytes(4, "big") for number in (0, answering.pid)))
                assert call.recv(1 << 20)
                with pytest.raises(subprocess.TimeoutExpired):
                    caller.wait(0.5)
            assert answering.stdin is not None
            answering.stdin.close()
            assert caller.wait(PATIENCE_S) == 0


def test_a_warm_python_is_a_child_of_its_caller_with_its_environment_folder_and_descriptors(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As one is that `subprocess` starts; its code has its arguments, and its parent knows how it has ended."""
    code = (
        "import json, os, sys; told = os.fdopen(int(sys.argv[1]), 'w');"
        "json.dump([sys.argv, os.getppid(), os.getpgrp() == os.getpid(), os.environ['SAID'], os.getcwd()], told);"
        "told.close(); sys.exit(5)"
    )
    monkeypatch.setenv("SAID", "so")
    monkeypatch.chdir(tmp_path)
    said = []
    for started_with in (subprocess, warm_subprocess("json")):
        ours, theirs = os.pipe()
        child = started_with.Popen(
            [sys.executable, "-c", code, str(theirs)], pass_fds=[theirs], stdin=subprocess.DEVNULL, process_group=0
        )
        os.close(theirs)
        with os.fdopen(ours) as told:
            said.append(json.loads(told.read()))
        assert child.wait(PATIENCE_S) == 5
        assert said[-1][0].pop() == str(theirs)
    assert said == [[["-c"], os.getpid(), True, "so", str(tmp_path)]] * 2


def test_a_warm_python_has_the_environment_and_folder_that_are_named_and_speaks_into_pipes(tmp_path: Path) -> None:
    code = "import os, sys; print(sys.argv[1], os.environ['SAID'], os.getcwd()); sys.exit('wrong')"
    as_asked: dict[str, Any] = {"env": {**os.environ, "SAID": "so"}, "cwd": tmp_path, "stdin": subprocess.DEVNULL}
    for started_with in (subprocess, warm_subprocess("json")):
        line = [sys.executable, "-c", code, "heard"]
        with started_with.Popen(line, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **as_asked) as child:
            assert child.communicate(timeout=PATIENCE_S) == (f"heard so {tmp_path}\n", "wrong\n")
        assert child.returncode == 1


def test_a_warm_node_ends_with_the_process_that_started_it() -> None:
    code = (
        "import sys, time; from warm_python import warm_python; child = warm_python(sys.executable, '').start("
        "[sys.executable, '-c', 'import time; time.sleep(600)'], dies_with_us=True);"
        "print(child.pid, flush=True); time.sleep(600)"
    )
    found = {**os.environ, "PYTHONPATH": str(Path(warm.__file__).parent)}
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, env=found) as process:
        assert process.stdout is not None
        node = os.pidfd_open(int(process.stdout.readline()))
        process.kill()
    assert select.select([node], [], [], PATIENCE_S)[0]
    os.close(node)


def test_a_cold_python_starts_where_the_system_refuses_to_fork_a_sibling(tmp_path: Path) -> None:
    (tmp_path / "beside.py").write_text("CODE = 3")
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with ours, theirs:
        theirs.send(b"-1")
        child = WarmPython(ours, [str(tmp_path)]).start([sys.executable, "-c", "import beside; exit(beside.CODE)"])
    assert isinstance(child, subprocess.Popen)
    assert child.wait(60) == 3


def test_a_warm_python_that_is_killed_is_known_to_be() -> None:
    line = [sys.executable, "-c", "import time; time.sleep(600)"]
    child = warm_subprocess("json").Popen(line, start_new_session=True)
    with pytest.raises(subprocess.TimeoutExpired):
        child.wait(0.1)
    assert os.getsid(child.pid) == child.pid
    child.kill()
    assert child.wait(PATIENCE_S) == -signal.SIGKILL
