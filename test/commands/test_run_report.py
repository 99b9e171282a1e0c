"""Summaries of a run's figures, and the paper's tables made from them."""

from __future__ import annotations

import pytest

from fracture_collision.run_report import (
    PAPER,
    last_words,
    statistics_table,
    summaries,
    summary_of,
    times_table,
    where_time_goes,
)
from fracture_collision.simulation.scene.scene import load_scene

REPORT = {
    "scene": "bricks",
    "totals": {"time_step_ms": 2.5, "triangles_before": 100, "triangles_after": 900, "fragments": 12},
    "summary": {
        "contacts": {"median": 5.0, "average": 6.0, "worst": 9.0},
        "total_ms": {"median": 1.0, "average": 2.0, "worst": 3.0},
        "update_ms": {},
    },
}


def test_summary_has_median_average_and_worst():
    assert summary_of([1.0, 2.0, 6.0]) == {"median": 2.0, "average": 3.0, "worst": 6.0}
    assert summary_of([]) == {}


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


@pytest.mark.parametrize("name", sorted(PAPER))
def test_every_scene_with_a_figure_in_the_paper_exists(name):
    assert load_scene(name).name == name


def test_no_penetration_is_a_plain_zero():
    said = last_words({"deepest_gap": [-0.002, 0.0, 0.1], "time": [0.1, 0.2, 0.3], "max_speed": [1.0, 0.5, 0.0]})
    assert said.startswith("deepest penetration: 0.000 mm at the end; 2.00 mm for a moment, at 0.10 s")
    assert "moment" not in last_words({"deepest_gap": [0.0, 0.1], "time": [0.1, 0.2], "max_speed": [1.0, 0.0]})


def test_the_share_of_ros_and_the_longest_step_are_explained():
    parts = {"collision_ms": [1.0, 2.0], "update_ms": [0.0, 0.0], "physics_ms": [70.0, 1.0], "fracture_ms": [0.0, 0.0]}
    report = {"step": [0, 1], "total_ms": [81.0, 5.0], **parts}
    said = where_time_goes(report)
    assert said == (
        "The longest step is number 0, 81.0 ms, of which 70.0 are physics; the next longest takes 5.0 ms."
    )
    said = where_time_goes(report | {"ros_ms": [10.0, 2.0]})
    assert said.startswith("ROS takes 6.0 of the 43.0 ms of an average step; the paper's step has no such part")
    assert where_time_goes({"step": [4], "total_ms": [2.0], "collision_ms": [2.0]}).endswith("are collision detection.")
