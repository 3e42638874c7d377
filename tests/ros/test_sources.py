"""How `source` names a node of ROS."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import cfgplan
from cfgplan.errors import InputError
from cfgplan.ros.sources import NodeSource

MANUAL = Path(__file__).parents[2] / "cfgplan" / "manual" / "ros.md"
READ = {
    "node:topic_tools/throttle messages in 5.0 out": NodeSource(
        "node", "topic_tools", "throttle", ("messages", "in", "5.0", "out")
    ),
    "node:./ball.py --name 'a b'": NodeSource("node", "", "./ball.py", ("--name", "a b")),
    "nodelet:image_proc/crop_decimate": NodeSource("nodelet", "image_proc", "crop_decimate"),
    "nodelet:image_proc/rectify@eyes": NodeSource("nodelet", "image_proc", "rectify", group="eyes"),
    "component:image_proc/image_proc::RectifyNode@eyes": NodeSource(
        "component", "image_proc", "image_proc::RectifyNode", group="eyes"
    ),
    "external:/stereo/left": NodeSource("external", "", "/stereo/left"),
}


@pytest.mark.parametrize("text", READ)
def test_a_source_names_a_node_and_is_written_as_it_was_read(text: str) -> None:
    assert NodeSource.read(text) == READ[text]
    assert str(READ[text]) == text


@pytest.mark.parametrize("text", [None, "units.py:Camera", "package.module:Camera", "node:Camera", "a/node.py:Camera"])
def test_unit_code_in_python_names_no_node(text: str | None) -> None:
    assert NodeSource.read(text) is None


@pytest.mark.parametrize(
    "text", ["node:a/", "nodelet:a/B@", "nodelet:/B", "external:a/b", "external:/a b", "node:a/b 'c"]
)
def test_a_source_that_names_half_a_node_is_refused_with_a_mend(text: str) -> None:
    with pytest.raises(InputError):
        NodeSource.read(text)


def test_the_manuals_example_names_nodes_that_can_be_read(tmp_path: Path) -> None:
    file = tmp_path / "ros.yaml"
    examples = re.findall(r"```yaml\n(.*?)```", MANUAL.read_text(), re.DOTALL)
    file.write_text(next(example for example in examples if "nodelet:" in example))
    library = cfgplan.load(file).environment.transformation
    assert NodeSource.read(library["camera"].source) == NodeSource("node", "usb_cam", "usb_cam_node")
    assert library["rectify"].input["info"].remap == "camera_info"
