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
from stages.typed_command import call

GOLDEN = Path(__file__).parents[2] / "bags" / "pane"  # has no meshes


def test_view_serves_until_it_is_stopped() -> None:
    command = [sys.executable, "-u", "-m", "fracture_collision.cli", "view", GOLDEN, "--no-open"]
    running = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    try:
        said = ""
        while (found := re.search(r"http://127\.0\.0\.1:\d+", said)) is None:
            line = running.stdout.readline()
            assert line, said
            said += line
        with urllib.request.urlopen(found[0], timeout=30) as answer:
            assert answer.status == 200 and b"<html" in answer.read().lower()
        running.send_signal(signal.SIGINT)
        said += running.communicate(timeout=60)[0]
    finally:
        running.kill()
    assert running.returncode == 0, said
    assert "ended" in said and "Traceback" not in said and "viser" not in said
    with pytest.raises(OSError):
        urllib.request.urlopen(found[0], timeout=5)


def test_a_signal_right_after_start_up_ends_view_cleanly(small_bag: Path, tmp_path: Path) -> None:
    browser = tmp_path / "browser"
    browser.write_text("#!/bin/sh\nkill -TERM $PPID\n")
    browser.chmod(0o755)
    done = subprocess.run(
        [sys.executable, "-m", "fracture_collision.cli", "view", small_bag, "--open"],
        env=os.environ | {"BROWSER": str(browser)}, capture_output=True, text=True, timeout=120.0,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    assert "ended" in done.stdout and "Traceback" not in done.stderr


def test_files_that_cannot_be_shown_are_rejected_with_an_explanation(small_bag: Path, tmp_path: Path) -> None:
    done = call("view", tmp_path, "--no-open")
    assert done.status == 2 and "neither an .mcap file nor a folder" in done.text
    done = call("view", small_bag, "--no-open", "--host", "192.0.2.1")  # reserved (RFC 5737)
    assert done.status == 1 and "cannot be served at 192.0.2.1" in done.text
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        done = call("view", small_bag, "--no-open", "--port", port)
        assert done.status == 1 and f"cannot be served at 127.0.0.1, port {port}" in done.text
