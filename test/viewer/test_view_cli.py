"""`fracture-collision view`: serves a page until Ctrl-C and exits cleanly; an error message where it cannot."""

from __future__ import annotations

import os
import re
import signal
import socket
import subprocess
import sys
import urllib.request
from pathlib import Path

import pytest
from click.testing import CliRunner
from stages.bag_of_records import write_bag
from worlds.small_run import small_run

from fracture_collision.cli.commands import main

GOLDEN = Path(__file__).parents[2] / "bags" / "pane"  # has no meshes


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("run") / "small"
    write_bag(folder, small_run())
    return folder


@pytest.mark.parametrize("order", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("which", ["small", "golden"])
def test_view_serves_until_it_is_stopped(bag: Path, which: str, order: signal.Signals) -> None:
    command = [sys.executable, "-u", "-m", "fracture_collision.cli", "view", GOLDEN if which == "golden" else bag,
               "--no-open"]  # fmt: skip
    running = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    try:
        said = ""
        while (found := re.search(r"http://127\.0\.0\.1:\d+", said)) is None:
            line = running.stdout.readline()
            assert line, said
            said += line
        with urllib.request.urlopen(found[0], timeout=30) as answer:
            assert answer.status == 200 and b"<html" in answer.read().lower()
        running.send_signal(order)
        said += running.communicate(timeout=60)[0]
    finally:
        running.kill()
    assert running.returncode == 0, said
    assert "ended" in said and "Traceback" not in said and "viser" not in said
    with pytest.raises(OSError):
        urllib.request.urlopen(found[0], timeout=5)


@pytest.mark.parametrize("order", ["INT", "TERM"])
def test_a_signal_right_after_start_up_ends_view_cleanly(
    bag: Path, tmp_path: Path, order: str
) -> None:
    browser = tmp_path / "browser"
    browser.write_text(f"#!/bin/sh\nkill -{order} $PPID\n")
    browser.chmod(0o755)
    done = subprocess.run(
        [sys.executable, "-m", "fracture_collision.cli", "view", bag, "--open"],
        env=os.environ | {"BROWSER": str(browser)}, capture_output=True, text=True, timeout=120.0,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    assert "ended" in done.stdout and "Traceback" not in done.stderr


def test_files_that_cannot_be_shown_are_rejected_with_an_explanation(bag: Path, tmp_path: Path) -> None:
    done = CliRunner().invoke(main, ["view", str(tmp_path), "--no-open"])
    assert done.exit_code == 2 and "neither an .mcap file nor a folder" in done.output.replace("\n", " ")
    done = CliRunner().invoke(main, ["view", str(bag), "--no-open", "--host", "192.0.2.1"])  # reserved (RFC 5737)
    assert done.exit_code == 1 and "cannot be served at 192.0.2.1" in done.output.replace("\n", " ")
    assert "Traceback" not in done.output
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = str(taken.getsockname()[1])
        done = CliRunner().invoke(main, ["view", str(bag), "--no-open", "--port", port])
        assert done.exit_code == 1 and f"cannot be served at 127.0.0.1, port {port}" in done.output.replace("\n", " ")
