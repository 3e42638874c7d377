"""Start of the helper: `PYTHON main.py SOCKET PARENT NODE`, by a Python that has rclpy."""

from __future__ import annotations

import socket
import sys
from pathlib import Path
from types import ModuleType

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = tuple(f"cfgplan_runtime{room}" for room in ("", ".streams", ".nodes", ".ros2", ".ros2.host"))


def adopt_packages() -> None:
    """Have modules of these packages found here, without what the packages themselves import."""
    sys.path[:] = [path for path in sys.path if Path(path or ".").resolve() != Path(__file__).resolve().parent]
    for name in PACKAGES:
        package = sys.modules[name] = ModuleType(name)
        package.__path__ = [str(ROOT.joinpath(*name.split(".")[1:]))]


def main(number: str, parent: str, node: str) -> None:
    """Serve the process at the other end of the socket until it closes that or ends."""
    adopt_packages()
    from cfgplan_runtime.ros2.host.attendance import Attendance
    from cfgplan_runtime.ros2.host.components import Components
    from cfgplan_runtime.ros2.host.graph import GraphLook
    from cfgplan_runtime.ros2.host.host import Host, die_with_parent
    from cfgplan_runtime.ros2.host.relays import Relays
    from cfgplan_runtime.ros2.host.topics import Topics

    die_with_parent(int(parent))
    host = Host(socket.socket(fileno=int(number)), node)
    Attendance(host, Relays(host))
    Components(host)
    GraphLook(host)
    Topics(host)
    host.run()
    host.close()


if __name__ == "__main__":
    main(*sys.argv[1:])
