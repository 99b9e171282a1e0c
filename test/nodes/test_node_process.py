"""Nodes as child processes: scheduling priority, and what is left of one that could not write."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from stages.page_client import wait_until

from fracture_collision.process.full_disk import REMEDY, STATUS
from fracture_collision.ros.processes.node_process import NodeProcess, free_domain_id


@pytest.mark.parametrize("niceness", [0, 5])
def test_a_node_has_the_given_niceness(tmp_path: Path, niceness: int) -> None:
    own = os.getpriority(os.PRIO_PROCESS, 0)
    node = NodeProcess("recorder_node", {"folder": str(tmp_path / "bag")}, free_domain_id(), tmp_path / "log",
                       niceness=niceness)  # fmt: skip
    try:
        assert os.getpriority(os.PRIO_PROCESS, node.pid) == min(own + niceness, 19)
        of_session = Path(f"/proc/{node.pid}/autogroup")  # Linux only; empty without autogroup scheduling
        words = of_session.read_text().split() if of_session.is_file() else []
        if words and os.access(of_session, os.W_OK):
            assert words[-1] == str(niceness)
    finally:
        node.stop()


def test_a_node_whose_disk_is_full_says_so(tmp_path: Path) -> None:
    """Without a traceback; Linux's /dev/full rejects all that is written to it."""
    node = NodeProcess("collision_node", {"timing_file": "/dev/full"}, free_domain_id(), tmp_path / "log")
    try:
        wait_until(lambda: "ready" in node.log_text())
    finally:
        assert node.stop() == STATUS
    assert f"collision_node: No space left on device; {REMEDY}" in node.log_text()
    assert "Traceback" not in node.log_text()
    assert node.last_words().startswith(f"collision_node ended with status {STATUS} (the disk is full; {REMEDY})")
