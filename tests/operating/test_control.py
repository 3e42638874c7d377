"""The control socket, with a manager that only remembers what it was asked."""

from __future__ import annotations

import json
import os
import socket
import stat
import subprocess
import sys
from typing import Any

import pytest
from cfgplan_runtime.errors import ControlError, NoSuchRunError
from cfgplan_runtime.lifecycle import changes
from cfgplan_runtime.lifecycle.deliberation import Findings
from cfgplan_runtime.lifecycle.reports import Decision
from cfgplan_runtime.operating import control_server
from cfgplan_runtime.operating.control_client import Control, connect, connect_to
from cfgplan_runtime.operating.control_server import MOST_CLIENTS, MOST_WAITING_EVENTS, ControlServer
from cfgplan_runtime.operating.protocol import RefusedError
from cfgplan_runtime.streams.run_folder import RunFolder, control_address
from fake_manager import FORESEEN_IN, FakeManager
from operated_world import eventually

from cfgplan.domain import ChangeSet
from cfgplan.errors import Fault, InputError

ROBOT = """
individuals:
  piff: Robot
  paff: {classes: [Robot, Toy], relations: {hasColour: red}}
transformations:
  - {label: "camera(${Robot})", outputs: {image: Image}}
"""


def talk(folder: RunFolder, *lines: str) -> list[dict[str, Any]]:
    """Say lines by hand, as a shell script would, and read as many and the greeting."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as end:
        end.settimeout(60)
        end.connect(str(control_address(folder.path)))
        end.sendall(("\n".join(lines) + "\n").encode())
        with end.makefile("r") as file:
            return [json.loads(file.readline()) for _ in range(1 + len(lines))]


@pytest.mark.usefixtures("server")
def test_a_client_is_told_what_it_is_connected_to(run_folder: RunFolder) -> None:
    (greeting,) = talk(run_folder)
    assert greeting == {
        "cfgplan_control": 1,
        "run": run_folder.id,
        "environment": "/robots/env.yaml",
        "pid": os.getpid(),
        "name": None,
    }


@pytest.mark.usefixtures("server")
def test_what_is_added_while_connected_is_withdrawn_when_the_connection_ends(
    run_folder: RunFolder, manager: FakeManager
) -> None:
    params = {"name": "query", "text": "{}", "while_connected": True}
    kept = {"method": "add", "params": {"name": "kept", "text": "targets: []"}}
    talk(run_folder, json.dumps({"method": "add", "params": {**params, "text": "targets: []"}}), json.dumps(kept))
    eventually(lambda: any(isinstance(change, changes.Withdraw) for change in manager.requested))
    assert [change for change in manager.requested if isinstance(change, changes.Withdraw)] == [
        changes.Withdraw("query")
    ]


@pytest.mark.usefixtures("server")
def test_only_the_user_can_reach_the_socket(run_folder: RunFolder) -> None:
    assert stat.S_IMODE(control_address(run_folder.path).stat().st_mode) == 0o600
    assert stat.S_IMODE(run_folder.path.stat().st_mode) == 0o700


def test_the_state_is_plain_json(control: Control) -> None:
    state = control.call("state")
    assert [(target["label"], target["met"], target["stream"]) for target in state["targets"]] == [
        ("ball", True, "detector.1/ball"),
        ("goal", False, None),
    ]
    assert state["targets"][1]["reason"] == "nothing gives Goal"
    assert state["units"][1]["inputs"] == {"image": "camera.1/image"}
    assert state["units"][1]["topics"] == {"ball": ["/result"]}
    assert state["units"][1]["memory_bytes"] == 25 << 20
    assert state["horizon_left_s"] is None
    review = state["reviews"][0]
    assert review["perturbations"][0] == {
        "kind": "UnitGone", "unit": "detector.1", "transformation": "detector", "how": "died", "cause": "exited with 3",
        "host": None,
    }  # fmt: skip
    assert review["change_set"]["started"][0]["id"] == "detector.1"
    assert review["unmet"] == {"goal": "nothing gives Goal"}


@pytest.mark.parametrize(
    ("method", "params", "change"),
    [
        ("withdraw", {"name": "robot2"}, changes.Withdraw("robot2")),
        ("remove_target", {"label": "ball"}, changes.Remove(targets=("ball",))),
        ("remove_transformation", {"label": "camera"}, changes.Remove(transformations=("camera",))),
        ("remove_individual", {"name": "piff"}, changes.Remove(individuals=("piff",))),
        ("restore", {"name": "ball"}, changes.Restore(("ball",))),
        ("kill", {"unit": "camera.1"}, changes.KillUnit("camera.1")),
        ("lose_host", {"host": "nao1"}, changes.LoseHost("nao1", "told through the control socket")),
        ("regain_host", {"host": "nao1"}, changes.RegainHost("nao1")),
        ("fact", {"name": "visibility", "value": "1.5"}, changes.SetFact("visibility", "1.5")),
        ("review", {}, changes.ReviewNow("the control socket")),
    ],
)
def test_a_method_requests_its_change_and_tells_the_review(
    control: Control, manager: FakeManager, method: str, params: dict[str, Any], change: changes.Change
) -> None:
    reply = control.call(method, **params)
    assert manager.requested == [change]
    assert (reply["review"]["decision"], reply["is_waiting"]) == ("applied", False)


def test_a_plan_is_told_with_what_it_was_made_for(control: Control, manager: FakeManager) -> None:
    told = control.call("plan")
    assert told["plan"]["basis"] == {"unit": {"camera.1": "1234"}}
    assert told["plan"]["status"] == "unknown"
    assert told["says"] == "A review would now decide nothing: no time"
    assert told["unmet"] == {"goal": "nothing gives Goal"}
    assert [unit["id"] for unit in told["running"]] == ["camera.1"]
    manager.is_slow = True
    with pytest.raises(RefusedError, match="no plan was made in time"):
        control.call("plan", wait_s=0.01)
    assert manager.requested == []


def test_it_is_told_why_a_unit_runs(control: Control, manager: FakeManager) -> None:
    with pytest.raises(RefusedError, match="there is no plan to ask about: no time"):
        control.call("why", unit="camera.1")
    manager.foreseen = Findings(FORESEEN_IN, FORESEEN_IN, decision=Decision.KEPT, change_set=ChangeSet(), cost_us=0)
    assert control.call("why", unit="camera.1")["says"][0] == ("camera.1 serves target ball, feeds detector.1/image.")
    with pytest.raises(RefusedError, match=r"did you mean `camera\.1`"):
        control.call("why", unit="camera.2")
    assert manager.requested == []


def test_a_plan_to_carry_out_is_read_before_it_is_asked_for(control: Control, manager: FakeManager) -> None:
    plan = {"format_version": 1, "environment": "", "planner": "x", "status": "feasible", "horizon_s": 1, "bound_us": 0}
    changes_nothing = {**plan, "change_set": {}}
    for text, message in (
        ("[", "this is not JSON"),
        ("{}", "format_version"),
        (json.dumps(plan), "this plan has no update: it is feasible"),
        (json.dumps(changes_nothing), "this plan was not made for a run"),
    ):
        with pytest.raises(RefusedError) as refused:
            control.call("apply", text=text, name="plan.json")
        assert message in str(refused.value.faults[0])
        assert refused.value.faults[0].file == "plan.json"
    assert manager.requested == []
    basis = {"unit": {"camera.1": "1234"}}
    control.call("apply", text=json.dumps({**changes_nothing, "basis": basis}), name="plan.json")
    assert manager.requested == [changes.ApplyPlan(ChangeSet(), basis, "plan.json")]


def test_stop_is_asked_for_and_not_waited_for(control: Control, manager: FakeManager) -> None:
    assert control.call("stop") == {}
    assert manager.requested == [changes.Stop()]


@pytest.mark.parametrize("form", ["yaml", "json"])
def test_a_robot_registers_itself(control: Control, manager: FakeManager, form: str) -> None:
    import yaml

    text = ROBOT if form == "yaml" else json.dumps(yaml.safe_load(ROBOT))
    assert control.call("add", name="robot3", text=text)["name"] == "robot3"
    declared = manager.declared
    assert declared.name == "robot3"
    assert declared.document == {"transformations": [{"label": "camera(${Robot})", "outputs": {"image": "Image"}}]}
    assert declared.individuals == (
        changes.Individual("piff", ("Robot",)),
        changes.Individual("paff", ("Robot", "Toy"), (("hasColour", "red"),)),
    )


def test_an_addition_without_a_name_gets_one(control: Control, manager: FakeManager) -> None:
    assert control.call("add", text="targets: []")["name"] == manager.declared.name == "addition-1"


@pytest.mark.parametrize(
    ("text", "line", "message"),
    [
        ("transformations: [}", 1, "this is not YAML"),
        ("- 1", 1, "this declares nothing"),
        ("individuals: [piff]", 1, "not a mapping of individuals"),
        ("individuals:\n  piff: 3", 2, "neither a name nor a list"),
        ("individuals:\n  piff:\n    colour: red", 3, "an individual has no `colour`"),
        ("individuals:\n  piff: {relations: red}", 2, "not a mapping of relations"),
    ],
)
def test_a_bad_addition_is_refused_with_its_place(
    control: Control, manager: FakeManager, text: str, line: int, message: str
) -> None:
    with pytest.raises(RefusedError) as refused:
        control.call("add", name="robot3", text=text)
    (fault, *_) = refused.value.faults
    assert (refused.value.code, fault.file, fault.line) == ("refused", "robot3", line)
    assert message in fault.message
    assert fault.mend
    assert manager.requested == []


def test_what_the_manager_refuses_is_told_with_its_faults(control: Control, manager: FakeManager) -> None:
    manager.refuse = InputError([Fault("no unit 'ghost' runs", mend="did you mean `goal`?")])
    with pytest.raises(RefusedError) as refused:
        control.call("kill", unit="ghost")
    assert refused.value.faults == manager.refuse.faults
    assert refused.value.mend == "did you mean `goal`?"


def test_what_the_manager_finds_wrong_with_an_addition_is_told_with_its_place(
    control: Control, manager: FakeManager
) -> None:
    key = "transformations[0].outputs.image"
    manager.refuse = InputError([Fault("there is no class `Image`", "declared by robot3", 1, 1, key)])
    with pytest.raises(RefusedError) as refused:
        control.call("add", name="robot3", text=ROBOT)
    assert refused.value.faults == (Fault("there is no class `Image`", "robot3", 6, 50, key),)


def test_a_reply_does_not_wait_for_ever_for_the_review(control: Control, manager: FakeManager) -> None:
    manager.is_slow = True
    assert control.call("review", wait_s=0.01) == {"review": None, "is_waiting": True}


@pytest.mark.parametrize(
    ("line", "code"),
    [
        ("hello", "bad_request"),
        ("[]", "bad_request"),
        ('{"id": 7}', "bad_request"),
        ('{"method": 7}', "bad_request"),
        ('{"id": 7, "method": "dance"}', "unknown_method"),
        ('{"id": 7, "method": "state", "params": {"unit": "x"}}', "bad_params"),
        ('{"id": 7, "method": "state", "params": {"review": true}}', "bad_params"),
        ('{"id": 7, "method": "state", "params": {"review": 5}}', "refused"),
        ('{"id": 7, "method": "kill"}', "bad_params"),
        ('{"id": 7, "method": "kill", "params": {"unit": 7}}', "bad_params"),
        ('{"id": 7, "method": "review", "params": {"wait_s": "long"}}', "bad_params"),
        ('{"id": 7, "method": "review", "params": {"wait_s": 1e300}}', "bad_params"),
        ('{"id": 7, "method": "state", "version": 2}', "bad_version"),
    ],
)
@pytest.mark.usefixtures("server")
def test_a_bad_request_is_refused_and_the_next_is_answered(run_folder: RunFolder, line: str, code: str) -> None:
    _, refused, answered = talk(run_folder, line, '{"id": "next", "method": "state"}')
    assert refused["error"]["code"] == code
    assert refused["error"]["message"]
    assert answered["id"] == "next"
    assert answered["result"]["phase"] == "stable"


def test_a_bug_is_told_as_one_and_the_server_goes_on(run_folder: RunFolder) -> None:
    def buggy(_: object) -> dict[str, Any]:
        raise ZeroDivisionError("oh")

    with ControlServer(run_folder.path, {"buggy": buggy}, ""):
        _, first, second = talk(run_folder, *['{"method": "buggy"}'] * 2)
    assert first["error"]["code"] == second["error"]["code"] == "internal"


def test_subscribers_hear_every_event(server: ControlServer) -> None:
    with connect() as control:
        control.subscribe()
        for number in range(3):
            server.publish({"kind": "Test", "number": number})
        assert control.call("state")["phase"] == "stable"
        heard = [event["number"] for _, event in zip(range(3), control.events(), strict=False)]
    assert heard == [0, 1, 2]


def test_a_subscriber_that_does_not_listen_is_not_waited_for(server: ControlServer) -> None:
    published = 20 * MOST_WAITING_EVENTS
    with connect() as control:
        control.subscribe()
        for number in range(published):
            server.publish({"kind": "Test", "number": number, "text": "x" * 200})
        heard = dropped = 0
        for event in control.events():
            heard += 1
            dropped += event.get("dropped", 0)
            if dropped:
                break
    assert 0 < heard < published
    assert dropped <= published - MOST_WAITING_EVENTS


def test_a_client_that_goes_away_in_the_middle_harms_nobody(run_folder: RunFolder, control: Control) -> None:
    for text in (b"", b'{"id"', b'{"id": 1, "method": "state"}\n' * 100):
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as end:
            end.connect(str(control_address(run_folder.path)))
            end.sendall(text)
    assert control.call("state")["phase"] == "stable"


@pytest.mark.usefixtures("server")
def test_there_are_not_too_many_clients(run_folder: RunFolder) -> None:
    clients = [connect() for _ in range(MOST_CLIENTS)]
    with pytest.raises(ControlError, match="clients are connected already"):
        connect_to(run_folder.path)
    for client in clients:
        client.close()


@pytest.mark.usefixtures("server")
def test_an_idle_client_makes_room_for_another_and_one_that_listens_stays(
    run_folder: RunFolder, monkeypatch: pytest.MonkeyPatch
) -> None:
    with connect() as listening:
        listening.subscribe()
        idle = [connect() for _ in range(MOST_CLIENTS - 1)]
        idle[0].call("state")
        monkeypatch.setattr(control_server, "IDLE_S", 0.0)
        with connect_to(run_folder.path) as late:
            assert late.call("state")["phase"] == "stable"
        with pytest.raises(ControlError, match="has ended"):
            idle[1].call("state")
        assert idle[0].call("state")["phase"] == "stable"
        assert listening.call("state")["phase"] == "stable"
        for client in idle:
            client.close()


def test_closing_ends_the_clients_and_removes_the_socket(run_folder: RunFolder, server: ControlServer) -> None:
    with connect() as control:
        server.close()
        with pytest.raises(ControlError, match="has ended"):
            control.call("state")
    assert not control_address(run_folder.path).exists()


def test_who_steers_a_run_imports_nothing_that_plans_or_runs() -> None:
    client = "cfgplan.cli.run_picture, cfgplan_runtime.operating.control_client, cfgplan_runtime.fleet.reached"
    heavy = {"cfgplan.api", "cfgplan.formats.fields", "cfgplan_runtime.processes.process_backend", "pydantic", "numpy"}
    code = f"import sys, {client}; print(*{heavy} & sys.modules.keys())"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == ""


def test_without_a_run_there_is_nothing_to_control() -> None:
    with pytest.raises(NoSuchRunError, match="no run is live: start one"):
        connect()


@pytest.mark.usefixtures("server")
def test_the_run_must_be_named_where_there_are_several(run_folder: RunFolder) -> None:
    other = RunFolder()
    try:
        with ControlServer(other.path, {}, "/robots/other.yaml"):
            with pytest.raises(NoSuchRunError, match=rf"several runs .*other\.yaml, pid {os.getpid()}"):
                connect()
            with pytest.raises(NoSuchRunError, match=r"no run 'ghost' is live; live runs: .*env\.yaml"):
                connect("ghost")
            with connect(run_folder.id) as control:
                assert control.system.run == run_folder.id
    finally:
        other.close()
