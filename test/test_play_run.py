"""What `play` leaves of itself: logs of the run that started last, and nothing of one that did not start."""

from __future__ import annotations

from pathlib import Path

import pytest
from click.testing import CliRunner

from fracture_collision.cli.commands import main
from fracture_collision.ros.node_process import free_domain_id
from fracture_collision.ros.play_run import PlayFailed, played

NODES = ("collision_node.log", "live_simulator_node.log", "page_node.log")


@pytest.fixture
def out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """With logs of an earlier run and a recording, in a domain of its own."""
    monkeypatch.setenv("ROS_DOMAIN_ID", str(free_domain_id()))
    for file in ("logs/page_node.log", "logs/other.log", "bag_1/bag_1_0.mcap"):
        (tmp_path / file).parent.mkdir(exist_ok=True)
        (tmp_path / file).write_text("earlier")
    return tmp_path


def contents(out: Path) -> dict[str, str]:
    return {str(file.relative_to(out)): file.read_text() for file in out.rglob("*") if file.is_file()}


def test_a_scene_that_is_not_there_is_told_before_anything_starts(out: Path) -> None:
    before = contents(out)
    done = CliRunner().invoke(main, ["play", "--scene", "no_such_scene", "--no-open", "--out", str(out)])
    assert done.exit_code == 1 and "no scene 'no_such_scene'" in done.output
    assert contents(out) == before


def test_nodes_that_do_not_come_leave_the_earlier_logs(out: Path) -> None:
    before = contents(out)
    nobodys = "192.0.2.1"  # RFC 5737
    words = rf"(?s)page_node ended with status 1.*cannot be served at {nobodys}"
    with pytest.raises(PlayFailed, match=words), played("pane", -1, out, nobodys, 0):
        pass
    assert contents(out) == before


def test_a_run_has_logs_of_its_own_alone(out: Path) -> None:
    with played("pane", -1, out, "127.0.0.1", 0) as run:
        assert {log.name for log in (out / "logs").iterdir()} == {*NODES}
        run.check()
        assert all(node.log.exists() for node in run.nodes)
    assert all("earlier" not in (out / "logs" / log).read_text() for log in NODES)
    assert {each.name for each in out.iterdir()} == {"logs", "bag_1"}
