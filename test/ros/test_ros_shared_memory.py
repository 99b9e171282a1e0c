"""Segments of killed nodes in shared memory are removed, and no others."""

from __future__ import annotations

import fcntl
import os
import time
from pathlib import Path

from fracture_collision.ros.processes.shared_memory import YOUNG, dead_segments, remove_dead_segments

OLD = 2.0 * YOUNG


def made(folder: Path, *names: str, age: float = OLD) -> list[str]:
    for name in names:
        (folder / name).write_bytes(bytes(64))
        os.utime(folder / name, (time.time() - age,) * 2)
    return list(names)


def files(folder: Path) -> set[str]:
    return {file.name for file in folder.iterdir()}


def test_segments_of_dead_participants_are_removed(tmp_path: Path) -> None:
    made(tmp_path, "fastrtps_00ff00ff00ff00ff", "fastrtps_00ff00ff00ff00ff_el")
    made(tmp_path, "fastrtps_3333333333333333_el")  # its segment is gone already
    stays = made(tmp_path, "fastrtps_1111111111111111", "fastrtps_1111111111111111_el", "fastrtps_port7415_el")
    stays += made(tmp_path, "fastrtps_of_somebody_el", "fastrtps_", "other_el", "fastrtps_port7415")
    stays += made(tmp_path, "fastrtps_2222222222222222", "fastrtps_2222222222222222_el", age=0.0)
    dead = {tmp_path / "fastrtps_00ff00ff00ff00ff", tmp_path / "fastrtps_3333333333333333"}
    with (tmp_path / stays[1]).open("rb") as lock:  # as its participant holds it
        fcntl.flock(lock, fcntl.LOCK_SH)
        assert dead_segments(tmp_path) == dead
        remove_dead_segments(tmp_path)
        assert files(tmp_path) == set(stays) and dead_segments(tmp_path) == set()
    assert dead_segments(tmp_path) == {tmp_path / stays[0]}
    remove_dead_segments(tmp_path / "nowhere")
