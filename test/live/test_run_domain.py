"""The ROS domain of a run: a second run in it is rejected at its start, with the process that has it and a remedy."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from click.testing import CliRunner
from stages.page_client import wait_until

from fracture_collision.cli.commands import main
from fracture_collision.ros.processes.node_process import NodeProcess, free_domain_id
from fracture_collision.ros.runs.run_domain import DomainTaken, processes_in, run_domain

REMEDY = "End that run, or set ROS_DOMAIN_ID to another number"


@pytest.fixture
def given(monkeypatch: pytest.MonkeyPatch) -> int:
    """A free domain, as the user's choice."""
    domain_id = free_domain_id()
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain_id))
    return domain_id


def test_a_domain_has_one_run_at_a_time(given: int) -> None:
    with run_domain() as domain_id:
        assert domain_id == given
        with pytest.raises(DomainTaken, match=rf"domain {given} is taken by .*process {os.getpid()}\). {REMEDY}"):
            run_domain(default=0).__enter__()
    with run_domain() as domain_id:
        assert domain_id == given


def test_a_free_domain_is_chosen_where_none_is_given(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("ROS_DOMAIN_ID", raising=False)
    default = free_domain_id()
    with run_domain(default) as first, run_domain(default) as second, run_domain() as third:
        assert first == default and len({first, second, third}) == 3


@pytest.mark.parametrize(("node", "is_of_a_run"), [("collision_node", True), ("recorder_node", False)])
def test_a_domain_with_nodes_of_a_run_is_taken(node: str, is_of_a_run: bool, given: int, tmp_path: Path) -> None:
    parameters = {} if is_of_a_run else {"folder": str(tmp_path / "bag")}
    process = NodeProcess(node, parameters, given, tmp_path / "log")
    try:
        wait_until(lambda: process.pid in processes_in(given))
        if is_of_a_run:
            with pytest.raises(DomainTaken, match=rf"taken by {node} \(process {process.pid}\)"):
                run_domain().__enter__()
        else:
            with run_domain() as domain_id:
                assert domain_id == given
    finally:
        process.stop()


@pytest.mark.parametrize("words", [["smash", "--scene", "pane"], ["play", "--scene", "pane", "--no-open"]])
def test_a_second_run_or_a_domain_that_is_no_number_is_rejected_at_the_start(
    words: list[str], given: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    words = [*words, "--out", str(tmp_path / "out")]
    with run_domain():
        done = CliRunner().invoke(main, words)
    assert done.exit_code == 1 and f"domain {given} is taken by" in done.output and REMEDY in done.output
    monkeypatch.setenv("ROS_DOMAIN_ID", "seven")
    done = CliRunner().invoke(main, words)
    assert done.exit_code == 1 and "ROS_DOMAIN_ID is 'seven', not a number; set it to one of" in done.output
    assert not (tmp_path / "out").exists()
