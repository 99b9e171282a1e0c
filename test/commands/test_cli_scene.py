"""`fracture-collision scene`: report, CSV, pictures, tables with the paper's; clear messages if stopped or misused."""

from __future__ import annotations

import csv
import errno
import json
import os
import signal
import sys
from pathlib import Path

import numpy as np
import pytest
from stages.drawn_file import colours_of
from stages.interrupted_loading import run_code
from stages.typed_command import begun, call
from worlds.scene_of_length import scene_of_length

from fracture_collision.cli.scene import RESULTS, parse_settings
from fracture_collision.process.full_disk import REMEDY
from fracture_collision.run_report import PAPER, statistics_table, summaries, times_table
from fracture_collision.scene_run import SceneRun, StepFigures
from fracture_collision.simulation.scene.scene import load_scene, scene_names


def test_a_full_disk_is_reported_without_a_traceback(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(SceneRun, "write_steps", full)
    done = call("scene", "pane", "--steps", 2, "--no-pictures", "--out", tmp_path / "out")
    assert done.status == 1 and f"Error: No space left on device; {REMEDY}" in done.text
    assert not (tmp_path / "out").exists()


@pytest.fixture(scope="module")
def pane(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    pytest.importorskip("embreex", exc_type=ModuleNotFoundError)
    out = tmp_path_factory.mktemp("pane") / "out"
    before = signal.getsignal(signal.SIGTERM)
    done = call("scene", "pane", "--out", out, "--count-colliding")
    assert done.status == 0, done.output
    assert signal.getsignal(signal.SIGTERM) is before
    return out, done.output


def test_a_run_writes_a_report_a_csv_and_two_pictures(pane: tuple[Path, str]) -> None:
    out, said = pane
    assert sorted(file.name for file in out.iterdir()) == sorted(RESULTS)
    report = json.loads((out / "report.json").read_text())
    steps = load_scene("pane").step_count
    assert report["finished"] and report["step"] == list(range(steps))
    with (out / "steps.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == steps and list(rows[0]) == list(StepFigures._fields)
    for name in ("collision_ms", "contacts", "deepest_gap", "missed_depth_bound"):
        assert [float(row[name]) for row in rows] == report[name]
    assert colours_of(out / "film_strip.png") > 50 and colours_of(out / "times.png") > 50
    assert all(str(out / file) in said.replace("\n", "") for file in RESULTS)
    assert all(words in said for words in ("tetrahedra", "triangles after", "whole step", "fracture computation"))


def test_times_add_up_and_figures_of_a_run_are_consistent(pane: tuple[Path, str]) -> None:
    report = json.loads((pane[0] / "report.json").read_text())
    columns = {name: np.array(report[name]) for name in StepFigures._fields}
    parts = sum(columns[name] for name in ("collision_ms", "physics_ms", "update_ms", "fracture_ms"))
    np.testing.assert_allclose(parts, columns["total_ms"], rtol=1e-9)
    assert (columns["solver_ms"] <= columns["physics_ms"]).all() and (columns["collision_ms"] > 0.0).all()
    # an event of one step reaches the service in the next step
    broke = np.flatnonzero(columns["fractures"])
    assert (columns["fracture_ms"][broke] > 0.0).all()
    assert len(broke) and set(np.flatnonzero(columns["update_ms"] > 0.0)) == set(broke + 1)
    assert (columns["colliding_points"] >= columns["contacts"]).all()
    assert columns["colliding_points"].max() > columns["contacts"].max()
    assert (columns["touching_pairs"] <= columns["pairs"]).all() and columns["visits"].max() > 1000
    assert columns["missed_depth_bound"].max() < 0.002 * 0.15 + 1e-12
    (size,) = report["sizes"]
    assert (size["object"], size["bodies"], size["triangles"], size["tetrahedra"]) == ("brick", 1, 320, 384)
    totals = report["totals"]
    assert totals["triangles_before"] == 320 < totals["triangles_after"]
    assert totals["fragments"] == columns["fragments"][-1] - 1  # the ball is not a fragment
    assert report["summary"]["contacts"]["worst"] == columns["contacts"].max()


def test_options_are_obeyed_and_results_of_an_earlier_run_removed(tmp_path: Path) -> None:
    for file in RESULTS:
        (tmp_path / file).write_text("of the run before")
    settings = ("--settings", "contacts_per_pair=3,max_work=1000000", "--settings", "penetration_tolerance=0.01")
    options = ("--steps", 20, "--no-pictures", "--seed", 9, "--threads", 2, *settings)
    done = call("scene", "pane", "--out", tmp_path, *options)
    assert done.status == 0, done.output
    assert sorted(file.name for file in tmp_path.iterdir()) == ["report.json", "steps.csv"]
    report = json.loads((tmp_path / "report.json").read_text())
    settings = report["settings"]
    assert (report["seed"], settings["threads"], settings["contacts_per_pair"]) == (9, 2, 3)
    assert settings["max_work"] == 1_000_000
    assert settings["penetration_tolerance"] == 0.01 and len(report["step"]) == 20
    assert "colliding_points" not in report
    done = call("scene", "pane", "--out", tmp_path, *options, "--curvature", 0.3)
    assert done.status == 0, done.output
    assert json.loads((tmp_path / "report.json").read_text())["digest"] != report["digest"]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["nowhere"], "no scene 'nowhere'"),
        (["reference_sphere:finest"], "has no variant 'finest'; there are fine_surface, coarse_inside"),
        (["pane", "--settings", "contacts=3"], "--settings: no setting 'contacts'; did you mean max_contacts?"),
        (["pane", "--settings", "contacts_per_pair=many"], "--settings contacts_per_pair: 'many' is not of type int"),
        (["pane", "--settings", "contacts_per_pair=0"], "contacts_per_pair: 0 is less than 1"),
        (["pane", "--settings", "method=oak"], "method: 'oak' is not one of"),
        (["pane", "--curvature", "-1"], "--curvature"),
        (["pane", "--curvature", "nan"], "curvature: nan is not a number of at least 0"),
        (["pane", "--steps", "0"], "--steps"),
        (["pane", "--seed", "x"], "--seed"),
        (["pane", "--out", __file__], "is a file"),
        ([], "Missing argument 'NAME'"),
    ],
)
def test_invalid_arguments_are_rejected_with_an_explanation(tmp_path: Path, words: list[str], said: str) -> None:
    done = call("scene", "--out", tmp_path / "out", *words)
    assert done.status == 2 and said in done.text


def test_settings_are_separated_by_commas_or_repeated() -> None:
    assert parse_settings(()) == {}
    given = parse_settings(("threads=3, method=glondu2014", "max_work=9"))
    assert given == {"threads": 3, "method": "glondu2014", "max_work": 9}


def test_an_interrupted_scene_reports_it_and_keeps_the_steps_done(tmp_path: Path) -> None:
    scene = scene_of_length("pane", 600.0, tmp_path)
    out = tmp_path / "out"
    out.mkdir()
    (out / "report.json").write_text("of the run before")
    with begun(tmp_path, "scene", scene, "--out", out) as process:
        process.until(lambda: "simulating" in process.text)
        process.stop(signal.SIGINT)
    report = json.loads((out / "report.json").read_text())
    done = len(report["step"])
    assert 0 < done < 240_000 and not report["finished"]
    assert f"stopped after {done} of 240000 steps" in process.text
    assert len((out / "steps.csv").read_text().splitlines()) == done + 1


def test_a_signal_while_kernels_load_ends_the_process_at_once(tmp_path: Path) -> None:
    words = ["scene", "pane", "--out", str(tmp_path / "out"), "--no-pictures"]
    done = run_code("from fracture_collision.cli import main", f"main({words!r})")
    assert done.returncode == 130 and "Traceback" not in done.stderr, done.stderr
    assert "stopped after 0 of 60 steps" in done.stdout


def test_a_held_signal_does_not_interrupt_kernels() -> None:
    done = run_code(
        "import click",
        "from rich.console import Console",
        "from fracture_collision.cli.console import Interruption",
        "from fracture_collision.simulation.warm_up import compile_kernels",
        "@click.command()",
        "def command():",
        "    interruption = Interruption(Console(), 'at once')",
        "    try:",
        "        with interruption.held():",
        "            compile_kernels(lambda words: None)",
        "            print(len(kernels), 'kernels', flush=True)",
        "            interruption.check()",
        "            print('not checked')",
        "    except KeyboardInterrupt:",
        "        print('checked', flush=True)",  # an immediate exit flushes nothing
        "        os.kill(os.getpid(), signal.SIGTERM)",
        "command()",
    )
    said = done.stdout.splitlines()
    assert done.returncode == 130, done.stderr
    assert int(said[-4].split()[0]) > 3 and said[-3:] == ["checked", "", "at once"]


REPORT = {
    "scene": "bricks",
    "totals": {"time_step_ms": 2.5, "triangles_before": 100, "triangles_after": 900, "fragments": 12},
    "summary": {
        "contacts": {"median": 5.0, "average": 6.0, "worst": 9.0},
        "total_ms": {"median": 1.0, "average": 2.0, "worst": 3.0},
        "update_ms": {},
    },
}


def test_only_steps_with_updates_count_as_updates():
    found = summaries({"update_ms": [0.0, 4.0, 0.0, 2.0], "collision_ms": [0.0, 4.0, 0.0, 2.0]})
    assert (found["update_ms"]["average"], found["collision_ms"]["average"]) == (3.0, 1.5)
    assert summaries({"fracture_ms": [0.0, 0.0]}) == {"fracture_ms": {}}


def test_tables_show_figures_of_the_paper_where_it_has_any():
    statistics = {row.words: row[1:] for row in statistics_table(REPORT)}
    assert statistics["fragments at the end"] == (12, None, 156, None)
    assert statistics["triangles after"] == (900, None, 40_000, None)
    assert statistics["contacts per step"] == (6.0, 9.0, None, None)
    times = {row.words: row[1:] for row in times_table(REPORT)}
    assert times["whole step"] == (2.0, 3.0, 11.7, 29.5)
    assert times["time step"] == (2.5, None, None, None)
    assert times["update, at fractures"] == (None, None, None, None)
    assert "colliding points per step" not in statistics and "physics" not in times
    own = times_table(REPORT | {"scene": "mine"})
    assert all(row.paper_average is None and row.paper_worst is None for row in own)


def test_every_scene_with_a_figure_in_the_paper_exists():
    assert PAPER.keys() <= set(scene_names())


def test_another_engine_runs_a_scene_and_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("mujoco", reason="no wheels for Python 3.10")
    done = call("scene", "pane", "--steps", 4, "--no-pictures", "--engine", "mujoco", "--out", tmp_path / "out")
    assert done.status == 0, done.output
    assert json.loads((tmp_path / "out" / "report.json").read_text())["engine"] == "mujoco"
    done = call("scene", "pane", "--engine", "mujco", "--out", tmp_path / "none")
    assert done.status == 2 and "did you mean mujoco?" in done.output
    monkeypatch.setattr("fracture_collision.extras.find_spec", lambda _: None)
    monkeypatch.delitem(sys.modules, "fracture_collision.simulation.mujoco_dynamics")
    done = call("scene", "pane", "--engine", "mujoco", "--out", tmp_path / "none")
    assert done.status == 2 and "pip install '.[mujoco]'" in done.output
