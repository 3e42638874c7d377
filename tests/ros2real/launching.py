"""Reads launch files by the real `launch`: `ROS_PYTHON launching.py FILE` launches one until SIGINT."""

from __future__ import annotations

import sys

from launch import LaunchDescription, LaunchService
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import AnyLaunchDescriptionSource


def main(file: str) -> int:
    """Launch a file. Returns 0 if everything in it has started and ended well."""
    service = LaunchService(argv=[])
    included = IncludeLaunchDescription(AnyLaunchDescriptionSource(file))
    service.include_launch_description(LaunchDescription([included]))
    return int(service.run())


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
