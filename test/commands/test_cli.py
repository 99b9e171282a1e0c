"""The command line: three processes over DDS write a bag, pictures and a report, and leave nothing else behind.

With `smash --mesh` the scene is made from the user's mesh.
"""

from __future__ import annotations

import json
import signal
import time
from pathlib import Path

import numpy as np
import pytest
import trimesh
import yaml
from rosbags.highlevel import AnyReader
from stages.drawn_file import colours_of
from stages.typed_command import begun, call, run
from worlds.scene_of_length import scene_of_length

from fracture_collision.bag.reader import read_messages, topic_digest
from fracture_collision.cli.smash import _filled, _own_scene
from fracture_collision.geometry.generators import TetGeometry, ball
from fracture_collision.lockstep import Lockstep
from fracture_collision.simulation.scene.scene import load_scene
from fracture_collision.simulation.scene.scene_changes import own_body_scene
from fracture_collision.world import Settings

SCENE = "pane"
STEPS = 60


def nodes_of(out: Path) -> list[str]:
    """Command lines of all node processes on this machine that write into `out`."""
    found = []
    for process in Path("/proc").glob("[0-9]*"):
        try:
            words = (process / "cmdline").read_bytes().decode().replace("\0", " ")
        except (OSError, UnicodeDecodeError):
            continue
        if f"{out}/" in words and "fracture_collision.ros" in words:
            found.append(words)
    return found


def write_earlier_run(out: Path) -> None:
    """Writes all outputs that an earlier run may have left in `out`, and an unrelated file."""
    for folder in ("bag", "logs"):
        (out / folder).mkdir(parents=True)
        (out / folder / "earlier").write_text("earlier")
    for file in ("report.json", "times.png", "film_strip.png", "scene.yaml", "mesh.npz", "notes"):
        (out / file).write_text("earlier")


def await_a_step(out: Path) -> None:
    """Waits until the run into `out` gets answers: its recorder has written more than 100 kB."""
    deadline = time.monotonic() + 120.0
    while not any(file.stat().st_size > 100_000 for file in out.glob(".new-*/bag/*.mcap")):
        assert time.monotonic() < deadline
        time.sleep(0.05)


@pytest.fixture(scope="module")
def smashed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    out = tmp_path_factory.mktemp("first") / "out"
    done = run("smash", "--scene", SCENE, "--out", out)
    assert done.returncode == 0, done.stdout + done.stderr
    return out, done.stdout


def test_every_step_is_answered_and_reported(smashed: tuple[Path, str]) -> None:
    out, said = smashed
    report = json.loads((out / "report.json").read_text())
    assert report["step"] == list(range(STEPS))
    lists = [value for value in report.values() if isinstance(value, list)]
    assert len(lists) >= 14 and all(len(each) == STEPS for each in lists)
    assert report["messages"]["/contact_constraints"] == STEPS
    assert report["messages"]["/fracture_events"] >= 1
    assert report["living_fragments"] >= 4 and report["triangles"] > 1000
    assert sum(value > 0 for value in report["update_ms"]) >= 1
    assert max(report["contacts"]) > 0 and min(report["collision_ms"]) > 0 and min(report["ros_ms"]) > 0
    for words in ("collision detection", "contact solver", "ROS", "triangles"):
        assert words in said
    assert colours_of(out / "film_strip.png") > 50 and colours_of(out / "times.png") > 50
    assert nodes_of(out) == []


def test_bag_opens_in_rosbags_with_all_topics(smashed: tuple[Path, str]) -> None:
    out, _ = smashed
    with AnyReader([out / "bag"]) as reader:
        assert set(reader.topics) == {
            "/bodies", "/fracture_events", "/fragment_states", "/contact_constraints", "/fragments", "/fragment_meshes",
            "/diagnostics",
        }  # fmt: skip
        messages: dict[str, list] = {}
        for connection, time_, data in reader.messages():
            messages.setdefault(connection.topic, []).append((time_, reader.deserialize(data, connection.msgtype)))
    stated = {message.step: message for _, message in messages["/fragment_states"]}
    answered = {message.step: message for _, message in messages["/contact_constraints"]}
    assert sorted(stated) == sorted(answered) == list(range(STEPS))
    for step, (time_, message) in zip(range(STEPS), messages["/contact_constraints"], strict=True):
        assert (message.step, time_) == (step, step * 2_500_000)
        assert message.header == stated[step].header and message.fracture_sequence == stated[step].fracture_sequence
    last = messages["/fragments"][-1][1]
    assert set(stated[STEPS - 1].fragment_ids) == set(last.fragment_ids) - {1}, "static bodies are left out"
    assert set(last.fragment_ids) <= {message.fragment_id for _, message in messages["/fragment_meshes"]}
    # once a second: so short a run may have none
    assert all(each.status[0].name == "fracture_collision: answers" for _, each in messages.get("/diagnostics", []))


@pytest.mark.slow
def test_two_runs_are_the_same_byte_for_byte_but_for_their_ids(smashed: tuple[Path, str], tmp_path: Path) -> None:
    first, _ = smashed
    write_earlier_run(tmp_path / "out")
    done = run("smash", "--scene", SCENE, "--out", tmp_path / "out")
    assert done.returncode == 0, done.stdout + done.stderr
    left = {each.name for each in (tmp_path / "out").iterdir()}
    assert left == {"bag", "logs", "report.json", "times.png", "film_strip.png", "notes"}
    assert not (tmp_path / "out" / "bag" / "earlier").exists()
    assert json.loads((tmp_path / "out" / "report.json").read_text())["scene"] == SCENE
    for topic in ("/bodies", "/fracture_events", "/fragment_states", "/contact_constraints"):
        assert any(True for _ in read_messages(first / "bag", [topic]))
        assert topic_digest(first / "bag", topic) == topic_digest(tmp_path / "out" / "bag", topic)


def test_an_interrupted_command_leaves_no_process(tmp_path: Path) -> None:
    long_scene = scene_of_length(SCENE, 600.0, tmp_path)
    out = tmp_path / "out"
    with begun(tmp_path, "smash", "--scene", long_scene, "--out", out) as process:
        logs = ".new-*/logs/collision_node.log"
        process.until(lambda: any("begins" in log.read_text() for log in out.glob(logs)))
        assert len(nodes_of(out)) == 3
        await_a_step(out)
        process.stop(signal.SIGINT)
    assert nodes_of(out) == []
    assert "all nodes have ended" in process.text
    assert {each.name for each in out.iterdir()} == {"bag", "logs"}
    assert next(read_messages(out / "bag", ["/fragment_states"])) is not None


def files_of(out: Path) -> list[tuple[str, str]]:
    return sorted((str(file), file.read_text()) for file in out.rglob("*") if file.is_file())


@pytest.mark.parametrize(
    ("words", "domain", "said", "status"),
    [
        (("--scene", "no_such_scene"), "", "no_such_scene", 2),
        (("--scene", "palte"), "", "did you mean plates? `fracture-collision scenes` lists all", 2),
        (("--scene", "reference_sphere:nope"), "", "no variant", 2),
        (("--mesh", "nowhere.obj"), "", "nowhere.obj", 2),
        (("--scene", SCENE), "9999", "ended with status", 1),  # no ports exist for this domain: no node reaches a step
    ],
)
def test_a_run_that_cannot_start_changes_nothing(
    words: tuple[str, ...], domain: str, said: str, status: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", domain)
    new, old = tmp_path / "new", tmp_path / "old"
    write_earlier_run(old)
    before = files_of(old)
    for out in (new, old):
        done = call("smash", *words, "--out", out)
        assert done.status == status and said in done.text
        assert nodes_of(out) == []
    assert not new.exists() and files_of(old) == before


def scene_of(mesh: TetGeometry, folder: Path) -> Path:
    np.savez(folder / "mesh.npz", vertices=mesh.vertices, tetrahedra=mesh.tetrahedra)
    (folder / "scene.yaml").write_text(yaml.safe_dump(own_body_scene(Path("mesh.npz"), mesh)))
    return folder / "scene.yaml"


@pytest.mark.parametrize("radius", [0.02, 0.15, 2.0])
def test_meshes_of_any_size_fall_and_break(tmp_path: Path, radius: float) -> None:
    scene = load_scene(scene_of(ball(radius, radius / 5.0), tmp_path))
    fragments = []
    with Lockstep(scene, Settings(threads=1)) as lockstep:
        while not lockstep.simulation.finished and max(fragments, default=1) < 5:
            fragments.append(lockstep.step().report.fragments)
    assert fragments[0] <= 2 and max(fragments) >= 5


def test_a_surface_is_filled(tmp_path: Path) -> None:
    file = tmp_path / "ring.obj"
    trimesh.creation.torus(0.5, 0.2).export(file)
    scene = load_scene(_own_scene(_filled(file, 0.4), tmp_path / "out", tmp_path))
    body = scene.bodies[1]
    assert np.ptp(body.shape.mesh.vertices, axis=0).max() == pytest.approx(0.4, rel=0.02)
    assert len(body.shape.mesh.vertices) > 100


def test_a_scene_written_by_smash_can_be_run_again(tmp_path: Path) -> None:
    """Even though the new run replaces the earlier run's outputs."""
    old, new = tmp_path / "old", tmp_path / "new"
    old.mkdir()
    new.mkdir()
    scene_of(ball(0.1, 0.05), old)
    copied = _own_scene(None, old, new)
    assert copied == new / "scene.yaml"
    for file in old.iterdir():
        file.unlink()
    assert len(load_scene(copied).bodies) == 3


def test_a_mesh_with_holes_is_rejected_with_an_explanation(tmp_path: Path) -> None:
    file = tmp_path / "open.obj"
    box = trimesh.creation.box((1.0, 1.0, 1.0))
    trimesh.Trimesh(box.vertices, box.faces[2:], process=False).export(file)
    done = call("smash", "--mesh", file, "--out", tmp_path / "out")
    assert done.status == 2 and "edges with only one face: the surface has holes, the first between (" in done.text
    assert not (tmp_path / "out").exists()
