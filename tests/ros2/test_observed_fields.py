"""`check` names fields of `observe` that a message type does not have."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from cfgplan.cli import main

sys.path.append(str(Path(__file__).parents[1] / "operating"))
NODES = Path(__file__).parents[1] / "ros2real" / "talking.py"


@pytest.mark.parametrize(
    ("field", "cause"),
    [
        ("pose.covariance.0", ""),
        ("pose.variance", "geometry_msgs/msg/PoseWithCovariance has no field `variance`; it has pose, covariance"),
        ("pose.covariance.36", "`pose.covariance` has several values: name one by its number, from 0 to 35"),
        ("header", "`header` is not a number; name one of its fields: stamp, frame_id"),
    ],
)
def test_a_field_that_the_message_type_does_not_have_is_named_with_its_place(
    field: str, cause: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from observed_nodes import write_finders

    env = write_finders(tmp_path, NODES, field)
    assert main(["check", str(env)]) == 0
    said = " ".join(capsys.readouterr().err.split())
    if cause:
        assert f"{env}:13:9: sonar/p can't report its error in field `{field}`: {cause}" in said
        assert "correct `observe`" in said
    else:
        assert "sonar/p" not in said


@pytest.mark.parametrize(
    ("kind", "told"),
    [
        ("std_srvs/srv/Trigger", "calls of std_srvs/srv/Trigger are not observed"),
        ("own_msgs/msg/Fix", "own_msgs/msg/Fix has no field `error`; it has variance"),
        ("unknown_msgs/msg/Fix", ""),
        ("no type", ""),
    ],
)
def test_types_of_the_folder_are_known_and_unknown_ones_are_left_alone(
    kind: str, told: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from observed_nodes import write_finders

    (tmp_path / "own_msgs" / "msg").mkdir(parents=True)
    (tmp_path / "own_msgs" / "msg" / "Fix.msg").write_text("float64 variance\n")
    env = write_finders(tmp_path, NODES, "error")
    env.write_text(env.read_text().replace("geometry_msgs/PoseWithCovarianceStamped", kind))
    assert main(["check", str(env)]) == 0
    said = " ".join(capsys.readouterr().err.split())
    assert told in said
    assert ("can't report" in said) == bool(told)
