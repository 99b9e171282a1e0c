"""The examples as a user runs them: beside a real service or with a mesh file."""

from __future__ import annotations

import re
import runpy
import signal
import subprocess
import sys
from contextlib import redirect_stdout, suppress
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image
from stages.ros_stage import StageWithClients

from fracture_collision.geometry.generators import ball
from fracture_collision.ros.processes.node_process import loopback_environment

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
PATIENCE = 120.0  # [s]


def test_the_subscriber_in_the_documents_is_the_example() -> None:
    code = (EXAMPLES / "deepest_contact.py").read_text().split('"""\n\n', 1)[1]
    assert code in (EXAMPLES.parent / "docs" / "ros.md").read_text()


def ended(listener: subprocess.Popen[str], order: signal.Signals) -> str:
    """What it wrote to stderr; with faulthandler, one that hangs prints its stack on SIGABRT."""
    listener.send_signal(order)
    try:
        return listener.communicate(timeout=PATIENCE)[1]
    except subprocess.TimeoutExpired:
        listener.send_signal(signal.SIGABRT)
        return listener.communicate(timeout=PATIENCE)[1]


def test_the_example_with_an_own_body_breaks_it_and_the_subscriber_ends_by_a_signal(
    stage: StageWithClients, tmp_path: Path
) -> None:
    environment, heard = loopback_environment(stage.domain_id), tmp_path / "heard.txt"
    orders, listeners = (signal.SIGINT, signal.SIGTERM), []
    try:
        with heard.open("w") as stream:
            for _ in orders:
                listeners.append(
                    subprocess.Popen(
                        [sys.executable, EXAMPLES / "deepest_contact.py"], stdout=stream, stderr=subprocess.PIPE,
                        env=environment | {"PYTHONFAULTHANDLER": "1"}, text=True,
                    )
                )  # fmt: skip
        service, client = stage.served()
        client.spin_until(lambda: client.node.count_subscribers("contact_constraints") == 3, "the listeners")
        command = [sys.executable, str(EXAMPLES / "break_your_own.py")]

        def run_until_heard() -> subprocess.CompletedProcess[str]:
            """Runs the example, again if the listener misses a step: the service may not have discovered it yet."""
            for _ in range(5):
                done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=PATIENCE)
                assert done.returncode == 0, done.stderr + service.log_text()
                # not two lines: the example asks again after two seconds, so a slow service answers a step twice
                with suppress(AssertionError):
                    client.spin_until(
                        lambda: {"1", "2"} <= gaps_by_step(heard.read_text()).keys(), "both steps", patience=10.0
                    )
                    return done
            raise AssertionError(f"the listener printed only {heard.read_text()!r}")

        done = run_until_heard()
        for order, listener in zip(orders, listeners, strict=True):
            said = ended(listener, order)
            assert listener.returncode == 0 and "Traceback" not in said, said
    finally:
        for listener in listeners:
            listener.kill()
    assert "refused" not in service.log_text()
    steps = re.split(r"step \d+, after (\d) fractures:", done.stdout)[1:]
    assert steps[0::2] == ["0", "0", "1"]
    in_the_air, on_the_floor, broken = (
        {(a, b): (int(count), float(gap))
         for a, b, count, gap in re.findall(r"fragments (\d) and (\d): (\d+) contacts, the deepest gap (\S+) mm", text)}
        for text in steps[1::2]
    )  # fmt: skip
    assert in_the_air == {}
    assert on_the_floor.keys() == {("1", "2")} and abs(on_the_floor["1", "2"][1]) < 0.01
    assert broken.keys() == {("2", "3"), ("2", "4"), ("3", "4")}
    assert [round(gap, 3) for _, gap in broken.values()] == [-2.0, -2.0, -1.0]
    gaps = gaps_by_step(heard.read_text())
    assert gaps.keys() == {"1", "2"} and abs(gaps["2"] + 2.0) < 0.01


def gaps_by_step(printed: str) -> dict[str, float]:
    """Gap of the deepest contact [mm] of each step that the listener printed."""
    return {step: float(gap) for step, gap in re.findall(r"step (\d): fragments \d and \d, gap (\S+) mm", printed)}


EXAMPLE = EXAMPLES / "break_a_mesh.py"


def pairs_of(*arguments: Path) -> dict[tuple[int, int], tuple[int, float, float]]:
    """For each pair printed the number of its contacts, their deepest gap and the bound [mm]."""
    with redirect_stdout(StringIO()) as printed, pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", [str(EXAMPLE), *map(str, arguments)])
        runpy.run_path(str(EXAMPLE), run_name="__main__")
    row = r"fragments (\d+) and (\d+): (\d+) contacts, deepest gap (\S+) mm; unlisted to (\S+) mm"
    return {
        (int(a), int(b)): (int(count), float(gap), float(bound))
        for a, b, count, gap, bound in re.findall(row, printed.getvalue())
    }


def assert_broken(pairs: dict[tuple[int, int], tuple[int, float, float]]) -> None:
    with_floor = {pair: found for pair, found in pairs.items() if pair[0] == 2}
    between = {pair: found for pair, found in pairs.items() if pair[0] != 2}
    assert min(gap for _, gap, _ in with_floor.values()) == pytest.approx(-1.0, abs=0.01)
    assert len(between) >= 7 and all(count >= 3 for count, _, _ in between.values())
    assert all(abs(gap) < 1e-3 and bound < 1e-3 for _, gap, bound in between.values())


def test_it_breaks_the_mesh_of_the_package_tetrahedra_and_a_surface(tmp_path: Path) -> None:
    assert_broken(pairs_of())
    mesh = ball(50.0, 10.0)
    np.savez(tmp_path / "ball.npz", vertices=mesh.vertices, tetrahedra=mesh.tetrahedra)
    assert_broken(pairs_of(tmp_path / "ball.npz"))
    trimesh.creation.torus(0.5, 0.2).export(tmp_path / "ring.stl")
    assert_broken(pairs_of(tmp_path / "ring.stl"))


def test_a_depth_camera_sees_a_mesh_burst(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    trimesh.creation.icosphere(3, 0.5).export(tmp_path / "ball.stl")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["depth_camera.py", "ball.stl"])
    with redirect_stdout(StringIO()) as printed:
        runpy.run_path(str(EXAMPLES / "depth_camera.py"), run_name="__main__")
    figures = re.fullmatch(r"depth.png: (\d+) of (\d+) fragments, (\S+) m .*\n", printed.getvalue())
    seen, there, nearest = figures.groups()
    assert 4 <= int(seen) <= int(there) and 0.2 < float(nearest) < 0.4
    with Image.open("depth.png") as picture:
        assert picture.size == (320, 240) and len(picture.convert("RGB").getcolors(1 << 20)) > 100
