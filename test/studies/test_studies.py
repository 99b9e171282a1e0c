"""The paper's studies: equal tables for any number of workers, and pictures and a page made from the tables alone."""

from __future__ import annotations

import csv
import os
import shutil
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

DOCS = Path(__file__).resolve().parents[2] / "docs"

pytest.importorskip("distributed")

from distributed import LocalCluster  # noqa: E402

import benchmarks.studies.cluster as cluster_module  # noqa: E402
from benchmarks.studies.ahead import flights, throws  # noqa: E402
from benchmarks.studies.bench import Progress, run_studies  # noqa: E402
from benchmarks.studies.cluster import cluster, run_trials  # noqa: E402
from benchmarks.studies.machine import machine, versions  # noqa: E402
from benchmarks.studies.page import BY_HAND, PAGE, STUDIES, study_files, write_page  # noqa: E402
from benchmarks.studies.paper import fig5, fig12, fig15, fig16, fig17, resolution, tables  # noqa: E402
from benchmarks.studies.replay import record, replay  # noqa: E402
from benchmarks.studies.scene_trials import ONE_THREAD, in_words, with_shortest_times  # noqa: E402
from benchmarks.studies.study import StudyError, Trial  # noqa: E402
from benchmarks.studies.table import (  # noqa: E402
    Table,
    is_time,
    read_table,
    write_table,
)
from fracture_collision.lockstep import Lockstep  # noqa: E402
from fracture_collision.run_report import summaries  # noqa: E402
from fracture_collision.simulation.scene.scene import load_scene  # noqa: E402

# Each study at its smallest size that still has contacts and a fracture.
TINY = {
    "tables": tables.Size(curved=("bricks",), counted=("flat",), scenes=("bricks",), duration=0.16, repeats=2),
    "fig5": fig5.Size(0.05, fig5.TOLERANCES[:1]),
    "fig12": fig12.Size(("flat",), ("bricks",), 0.16),
    "resolution": resolution.Size(1, ("flat",), 0.06, resolution.VARIANTS[2:]),
    "fig15": fig15.Size(1, ("flat",), 0.12),
    "fig16": fig16.Size(2, (2, 8), 0.4),
    "fig17": fig17.Size((fig17.NEW,), ("flat",), 0.02, 0.01, 1),
    "flights": flights.Size(2, ("rod",), ("rod", "plane"), (5.0,)),
    "throws": throws.Size(2, ("shard",), ("fixed plate", "heap"), (50.0,)),
}


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """All studies with one worker, and some with two in another order."""
    assert set(TINY) == set(STUDIES)
    folders = []
    for workers, names in ((1, list(TINY)), (2, ["fig16", "fig15", "fig12", "tables"])):
        folder = tmp_path_factory.mktemp(f"workers{workers}")
        told: list[str] = []
        progress = Progress(begin=lambda name, trials, told=told: told.append(name))
        left = [
            file
            for files in run_studies(names, [TINY[n] for n in names], "tiny", folder, None, workers, progress)
            for file in files
        ]
        assert told == names and all(file.is_file() for file in left)
        assert {*left, folder / PAGE} == set(folder.iterdir())
        folders.append(folder)
    return folders[0], folders[1]


def untimed(csv_path: Path) -> list[list[str]]:
    """Header and rows of the file without the times."""
    rows = list(csv.reader(line for line in csv_path.read_text().splitlines() if not line.startswith("#")))
    kept = [i for i, name in enumerate(rows[0]) if not is_time(name)]
    return [[row[i] for i in kept] for row in rows]


@pytest.mark.slow
def test_results_do_not_depend_on_workers_or_order(made: tuple[Path, Path]) -> None:
    one, two = made
    files = sorted(file.name for file in two.glob("*.csv"))
    assert len(files) == 6
    for name in files:
        rows = untimed(one / name)
        assert rows == untimed(two / name), name
        assert len(rows) > 1 and len(rows[0]) > 2


@pytest.mark.slow
def test_tables_name_the_machine_and_have_plausible_figures(made: tuple[Path, Path]) -> None:
    for file in made[0].glob("*.csv"):
        about = read_table(file).about
        assert about["effort"] == "tiny" and about["cpu"] == machine()["cpu"] and float(about["load"]) >= 0.0
        assert about["versions"] == versions()["versions"] and about["sources"] == versions()["sources"]
    (flat, curved) = read_table(study_files(made[0], STUDIES["tables"], "", "csv")).rows
    assert flat["fractures"] > 0 and flat["colliding_points_worst"] > flat["contacts_worst"] > 0
    assert curved["colliding_points_worst"] is None and curved["triangles_after"] != flat["triangles_after"]
    replayed = read_table(made[0] / "bench_fig15.csv").rows
    assert len(replayed) == 4 and all(row["fractures"] and row["update_ms_worst"] > 0.0 for row in replayed)
    by_tree = {row["combination"]: row["visits_average"] for row in replayed}
    assert by_tree["D exact, S updated"] != by_tree["D exact, S rebuilt"]
    drops = read_table(made[0] / "bench_fig16.csv")
    few, many = (drops.where(selection="fixed", contacts_allowed=n).rows[0] for n in (2, 8))
    assert few["deepest_mm"] > many["deepest_mm"] > 0.0 and few["visits_a_frame"] < many["visits_a_frame"]
    assert few["contacts_a_frame"] <= 2.0
    adaptive = drops.where(selection="adaptive", contacts_allowed=2).rows[0]
    assert adaptive["deepest_mm"] < few["deepest_mm"]
    same = read_table(made[0] / "bench_fig5.csv").rows
    assert same[0]["off_path_mm"] == same[1]["off_path_mm"] == 0.0


@pytest.mark.slow
def test_pictures_are_not_blank(made: tuple[Path, Path]) -> None:
    pictures = [study_files(made[0], study, name, "png") for study in STUDIES.values() for name in study.pictures]
    assert set(pictures) == set(made[0].glob("*.png"))
    for picture in pictures:
        assert len(np.unique(imread(picture)[..., :3].reshape(-1, 3), axis=0)) > 30, picture


@pytest.mark.slow
def test_the_page_has_a_section_for_each_table_in_the_folder(made: tuple[Path, Path], tmp_path: Path) -> None:
    page = (made[0] / PAGE).read_text()
    places = [page.index(f"## {study.title}\n") for study in STUDIES.values()]
    assert places == sorted(places) and machine()["cpu"] in page
    for study in STUDIES.values():
        assert f"](bench_{study.name}.png)" in page and f"(bench_{study.name}.csv)" in page
    assert all(len(line) <= 120 for line in page.splitlines() if not line.startswith(("|", "!", "<", "- ")))
    file = made[0] / "bench_fig16.csv"
    (tmp_path / file.name).write_text(file.read_text().replace("fixed,2,2,", "fixed,2,7531,"))
    alone = write_page(tmp_path).read_text()
    assert "(Fig. 16)" in alone and "(Fig. 17)" not in alone
    (tmp_path / file.name).write_text(file.read_text().replace("adaptive,2,2,", "adaptive,2,7531,"))
    assert "7531 random drops" in write_page(tmp_path).read_text() and "7531" not in alone


def test_the_page_in_docs_is_what_the_generator_writes(tmp_path: Path) -> None:
    """With its sections that are written by hand."""
    page = (DOCS / PAGE).read_text(encoding="utf-8")
    copy = shutil.copytree(DOCS, tmp_path / "docs")
    assert write_page(copy).read_text(encoding="utf-8") == page
    assert all(f"\n## {name}\n" in page for name in BY_HAND)


def test_the_page_is_written_despite_a_table_of_other_sources(tmp_path: Path) -> None:
    write_table(tmp_path / "bench_fig16.csv", {}, [{"selection": "fixed"}])
    assert "Run `fracture-collision bench fig16` again." in write_page(tmp_path).read_text()


def test_a_replay_gives_the_answers_of_the_run() -> None:
    recording = record(load_scene("pane"))
    with Lockstep(load_scene("pane"), ONE_THREAD) as run:
        contacts, visits = zip(*((len(step.contacts.gaps), run.world.last_visits) for step in run), strict=True)
    answers = replay(recording, ONE_THREAD)
    assert answers.contacts.tolist() == list(contacts) and answers.visits.tolist() == list(visits)
    sequences = np.array([states.fracture_sequence for states in recording.states])
    assert np.array_equal(np.flatnonzero(answers.update > 0.0), 1 + np.flatnonzero(np.diff(sequences)))
    assert (answers.query > 0.0).all() and len(recording.events) == sequences[-1] > 1


def test_spikes_compare_first_steps_after_fractures_with_their_neighbours() -> None:
    ordinary = {"collision_ms": 2.0, "update_ms": 0.0, "contacts": 5}
    rows = [dict(ordinary) for _ in range(60)]
    rows[30] |= {"collision_ms": 6.0, "update_ms": 1.0}
    rows[32] |= {"collision_ms": 100.0, "update_ms": 1.0}
    rows[50]["collision_ms"] = 3.0
    rows[0]["contacts"] = 0
    after, elsewhere = fig12.spikes(Table({}, rows))
    assert after.tolist() == [3.0, 50.0]
    assert len(elsewhere) == 57 and elsewhere.max() == 1.5 and np.median(elsewhere) == 1.0


def test_tables_are_read_as_they_were_written(tmp_path: Path) -> None:
    rows = [{"name": "a, b", "count": 3, "share": 0.123456789, "none": None}, {"name": "c", "count": -1, "share": 2.0,
                                                                              "none": float("nan")}]  # fmt: skip
    write_table(tmp_path / "t.csv", {"cpu": "Some: CPU", "load": "1.0"}, rows)
    table = read_table(tmp_path / "t.csv")
    assert table.about == {"cpu": "Some: CPU", "load": "1.0"}
    assert table.rows == [{"name": "a, b", "count": 3, "share": 0.12346, "none": None},
                          {"name": "c", "count": -1, "share": 2, "none": None}]  # fmt: skip
    assert table.values("count") == [3, -1] and np.isnan(table.column("none")).all()
    assert table.where(name="c").column("share").tolist() == [2.0]
    assert is_time("total_ms_worst") and is_time("visit_ns") and not is_time("deepest_mm")


def test_repeats_leave_the_shortest_times_and_the_worst() -> None:
    times = {"total_ms": [4.0, 1.0], "update_ms": [0.0, 3.0]}
    report = {"scene": "mine", "digest": "a", "contacts": [5, 6], **times}
    report["summary"] = {**summaries(times), "contacts": {"average": 5.5}}
    times = {"total_ms": [2.0, 8.0], "update_ms": [0.0, 2.5]}
    again = report | times | {"summary": summaries(times)}
    found = with_shortest_times([report, again])
    assert found["total_ms"] == [2.0, 1.0] and found["summary"]["total_ms"]["average"] == 1.5
    assert found["summary"]["total_ms"]["worst"] == 8.0, "of all runs"
    assert found["summary"]["update_ms"] == {"median": 2.5, "average": 2.5, "worst": 3.0}
    assert found["contacts"] == [5, 6] and found["summary"]["contacts"] == {"average": 5.5}
    with pytest.raises(StudyError, match="mine: equal runs took different courses"):
        with_shortest_times([report, report | {"digest": "b"}])
    assert "one run" in in_words(1) and "shortest time in 3" in in_words(3)


def test_sizes_of_both_efforts_name_trials() -> None:
    for study in STUDIES.values():
        quick, full = (set(study.trials(size)) for size in (study.quick, study.full))
        assert 0 < len(quick) < len(full) or study.name == "fig5"
        assert all(trial.words for trial in quick | full)
    assert len(STUDIES["fig16"].trials(STUDIES["fig16"].full)) >= 1000


@pytest.fixture(scope="module")
def scheduler() -> str:
    """The address of an external cluster."""
    with LocalCluster(
        n_workers=1, threads_per_worker=1, processes=True, host="127.0.0.1", scheduler_port=0,
        dashboard_address="127.0.0.1:0", memory_limit=None, silence_logs=50,
    ) as processes:  # fmt: skip
        yield processes.scheduler_address


def test_a_given_scheduler_is_used_and_left_running_and_a_failing_trial_named(scheduler: str) -> None:
    with cluster(scheduler, 0) as crew:
        assert crew.timing_worker.startswith("tcp://")
        trials = [Trial(divmod, (i, 3), f"{i} by 3", i % 2 == 0) for i in range(6)]
        done: list[Trial] = []
        found = run_trials(crew, trials + trials, done.append)
        assert [found[trial] for trial in trials] == [divmod(i, 3) for i in range(6)]
        assert sorted(done, key=trials.index) == trials
    with cluster(scheduler, 0) as crew, pytest.raises(StudyError, match="by nothing: ZeroDivisionError"):
        run_trials(crew, [Trial(divmod, (1, 0), "1 by nothing", True)], lambda trial: None)


def test_a_worker_with_other_sources_is_rejected(scheduler: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster_module, "versions", lambda: versions() | {"sources": "0123"})
    with pytest.raises(StudyError, match="worker tcp://.* has other sources: .*; here: 0123"), cluster(scheduler, 0):
        pass


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:1", "nonsense://x"])
def test_a_missing_scheduler_is_reported(address: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster_module, "CONNECT_SECONDS", 0.5)
    with pytest.raises(StudyError, match="no scheduler at"), cluster(address, 0):
        pass


def test_the_death_of_a_timing_worker_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster_module, "LOOK_SECONDS", 0.2)
    with cluster(None, 1) as crew, pytest.raises(StudyError, match="an end: .*(has died|KilledWorker)"):
        run_trials(crew, [Trial(os._exit, (1,), "an end", True)], lambda trial: None)


@pytest.mark.parametrize(
    ("thrown", "target", "speed", "number"),
    [
        ("shard", "box", 100.0, 44),  # touches with one end, touches beside it, and penetrates with the other
        ("shard", "box", 20.0, 40),
        ("pane", "box", 5.0, 12),
        ("shard", "heap", 100.0, 24),  # a corner, a metre away, enters and leaves a rim within two times
    ],
)
def test_throws_that_once_passed_through_no_longer_do(thrown: str, target: str, speed: float, number: int) -> None:
    (one,) = throws.throw(thrown, target, speed, number, number + 1)
    assert one.touches and not one.is_through and not one.is_ghost
    assert one.deepest < 1e-3 and one.energy_gain < 1e-9
