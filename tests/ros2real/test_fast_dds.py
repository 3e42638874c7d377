"""Each process of a run has a participant number of its own, and shared memory goes with its owner."""

from __future__ import annotations

import fcntl
import os
import re
import socket
import threading
import time
from itertools import pairwise
from pathlib import Path

import pytest
from cfgplan_runtime.ros2.fast_dds import FastDdsProfiles, clean_memory


def number_in(profile: str) -> int:
    found = re.search(r"<participantID>(\d+)<", Path(profile).read_text())
    assert found is not None
    return int(found[1])


def test_numbers_of_participants_are_counted_up_past_those_that_are_taken(tmp_path: Path) -> None:
    profiles = FastDdsProfiles(tmp_path, {"ROS_DOMAIN_ID": "97"})
    first = number_in(profiles.environment("a")["FASTDDS_DEFAULT_PROFILES_FILE"])
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("", 7410 + 250 * 97 + 2 * (first + 1)))
        second = number_in(profiles.environment("b")["FASTRTPS_DEFAULT_PROFILES_FILE"])
    assert second == first + 2


def test_numbers_begin_again_when_all_were_used_once(tmp_path: Path) -> None:
    profiles = FastDdsProfiles(tmp_path, {"ROS_DOMAIN_ID": "97"})
    numbers = [number_in(profiles.environment("a")["FASTDDS_DEFAULT_PROFILES_FILE"]) for _ in range(150)]
    assert len(set(numbers)) == len(range(10, 120))
    assert all(one != other for one, other in pairwise(numbers))


@pytest.mark.parametrize(
    "environment",
    [{"FASTRTPS_DEFAULT_PROFILES_FILE": "/my.xml"}, {"RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp"}],
    ids=["own profile", "another middleware"],
)
def test_what_the_user_has_chosen_stays(tmp_path: Path, environment: dict[str, str]) -> None:
    assert not FastDdsProfiles(tmp_path, environment).environment("a")


def test_a_warning_about_the_variables_of_the_profiles_is_no_news_unless_they_are_the_users(tmp_path: Path) -> None:
    line = (
        "[WARN] [1795888441.8] [rmw_fastrtps_shared_cpp]: FASTRTPS_DEFAULT_PROFILES_FILE value is used for participant"
        " configuration, but it is deprecated and will no longer be supported. Use FASTDDS_DEFAULT_PROFILES_FILE"
    )
    assert FastDdsProfiles(tmp_path, {}).causes(line)
    assert not FastDdsProfiles(tmp_path, {}).causes("another line")
    assert not FastDdsProfiles(tmp_path, {"FASTRTPS_DEFAULT_PROFILES_FILE": "/my.xml"}).causes(line)


def test_a_process_of_several_participants_has_no_number(tmp_path: Path) -> None:
    file = FastDdsProfiles(tmp_path, {}).environment("a", has_number=False)["FASTDDS_DEFAULT_PROFILES_FILE"]
    assert "participantID" not in Path(file).read_text()


def test_only_memory_without_a_living_owner_is_removed(tmp_path: Path) -> None:
    names = ["fastrtps_port7411", "fastrtps_ab12", "fastrtps_port7413"]
    for name in [*names, "sem.fastrtps_port7411_mutex", "fastrtps_port7411_el", "fastrtps_ab12_el", "other"]:
        (tmp_path / name).touch()
    for path in tmp_path.iterdir():
        os.utime(path, (time.time() - 60, time.time() - 60))
    (tmp_path / "fastrtps_new").touch()
    with (tmp_path / "fastrtps_ab12_el").open("rb+") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        clean_memory(tmp_path)
        left = {path.name for path in tmp_path.iterdir()}
    assert left == {"fastrtps_ab12", "fastrtps_ab12_el", "fastrtps_new", "other"}


def test_memory_may_vanish_while_others_look_at_it(tmp_path: Path) -> None:
    """Several runs clean at once."""
    done = threading.Event()

    def churn() -> None:
        while not done.is_set():
            for number in range(20):
                (tmp_path / f"fastrtps_{number}_el").touch()
                (tmp_path / f"fastrtps_{number}_el").unlink()

    others = threading.Thread(target=churn)
    others.start()
    try:
        for _ in range(300):
            clean_memory(tmp_path)
    finally:
        done.set()
        others.join()
