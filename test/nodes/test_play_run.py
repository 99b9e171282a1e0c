"""Files left by `play`: the logs of the last run that started; a run that fails to start leaves none."""

from __future__ import annotations

import socket
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from click.testing import CliRunner
from stages.page_client import page_client, wait_until
from stages.ros_client import ServiceClient
from websockets.exceptions import InvalidStatus

from fracture_collision.cli.commands import main
from fracture_collision.ros.processes.node_process import free_domain_id
from fracture_collision.ros.runs.play_run import PlayFailed, played

NODES = ("collision_node.log", "live_simulator_node.log", "page_node.log")


@pytest.fixture
def out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with an earlier run's logs and a recording; sets a free domain."""
    monkeypatch.setenv("ROS_DOMAIN_ID", str(free_domain_id()))
    for file in ("logs/page_node.log", "logs/other.log", "bag_1/bag_1_0.mcap"):
        (tmp_path / file).parent.mkdir(exist_ok=True)
        (tmp_path / file).write_text("earlier")
    return tmp_path


def contents(out: Path) -> dict[str, str]:
    return {str(file.relative_to(out)): file.read_text() for file in out.rglob("*") if file.is_file()}


def test_a_missing_scene_is_reported_before_nodes_start(out: Path) -> None:
    before = contents(out)
    done = CliRunner().invoke(main, ["play", "--scene", "no_such_scene", "--no-open", "--out", str(out)])
    assert done.exit_code == 2 and "no scene 'no_such_scene'" in done.output
    assert contents(out) == before


def test_nodes_that_do_not_start_keep_the_earlier_logs(out: Path) -> None:
    before = contents(out)
    nobodys = "192.0.2.1"  # RFC 5737
    words = rf"(?s)page_node ended with status 1.*cannot be served at {nobodys}"
    with pytest.raises(PlayFailed, match=words), played("pane", -1, out, nobodys, 0):
        pass
    assert contents(out) == before


def test_a_page_records_below_out_and_a_foreign_page_does_nothing(out: Path, tmp_path: Path) -> None:
    secret = tmp_path.parent / "passwords"
    secret.write_text("hunter2\n")
    with played("pane", -1, out, "127.0.0.1", 0) as run:
        assert {log.name for log in (out / "logs").iterdir()} == {*NODES}, "of this run"
        port = urlsplit(run.address).port
        for origin in ("http://evil.example", f"http://localhost:{port + 1}", f"http://evil.example:{port}"):
            with pytest.raises(InvalidStatus, match="403"), page_client(run.address, origin=origin):
                pass
            rebound = socket.create_connection(("127.0.0.1", port))
            with pytest.raises(InvalidStatus, match="403"), page_client(origin, sock=rebound, origin=origin):
                pass
        with page_client(run.address, origin=run.address) as own:
            own.set("scene", str(secret))
            own.set("record", True)
            wait_until(lambda: (out / "bag_2" / "metadata.yaml").exists())
            own.set("record", False)
            wait_until(lambda: any("is complete" in notice for notice in own.notices))
            assert not any("hunter2" in notice for notice in own.notices)
        run.check()
        assert all(node.log.exists() for node in run.nodes)
    assert {each.name for each in out.iterdir()} == {"logs", "bag_1", "bag_2", "bag_2.log"}
    logs = [(out / "logs" / log).read_text() for log in NODES]
    assert not any("hunter2" in log or log.startswith("earlier") for log in logs)


@pytest.mark.slow
def test_the_service_looks_ahead_by_a_step_of_the_scene_that_is_played(out: Path) -> None:
    with played("pane", -1, out, "127.0.0.1", 0) as run:
        ears = ServiceClient(run.domain_id)
        try:
            assert ears.parameters("lookahead", "method") == [0.0025, "exact"]
            with page_client(run.address, origin=run.address) as own:
                own.set("scene", "drop_bunnies")
                wait_until(lambda: ears.parameters("lookahead", "method") == [0.005, "exact"])
        finally:
            ears.close()
        run.check()
