"""Fig. 16: penetration depth of a plate in a bowl, and nodes visited, by the number of contacts allowed per pair.

Random drops of scene plate_in_bowl. `adaptive` is the paper's selection: once a pair has its contacts, those deeper
than epsilon still count. `fixed` has no such tolerance: it never lists more than allowed. `exact` is our method: as
many, spread over all near samples, and some more if more are deep; its visits are leaves and samples.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure

from benchmarks.studies.pictures import BLUE, GREEN, RED, finish, new_figure
from benchmarks.studies.scene_trials import ONE_THREAD, PAPERS
from benchmarks.studies.study import Study, Trial
from benchmarks.studies.table import Row, Table, markdown_table, number
from fracture_collision.lockstep import Lockstep
from fracture_collision.simulation.scene.scene import load_scene
from fracture_collision.simulation.scene.scene_changes import random_drop
from fracture_collision.world import CollisionWorld
from fracture_collision.world.inspection import every_contact

SCENE = "plate_in_bowl"
SELECTIONS = {
    "adaptive": PAPERS,
    "fixed": PAPERS._replace(penetration_tolerance=1.0),  # [R] deeper than anything
    "exact": ONE_THREAD,
}
COLOURS = {"adaptive": BLUE, "fixed": RED, "exact": GREEN}
PAPERS_ENOUGH = 8  # contacts: "adding more contact points barely improves quality" (7.4)
MILLI = 1e3


class Size(NamedTuple):
    drops: int
    contacts: tuple[int, ...]
    duration: float | None = None  # [s] of each drop


class Drop(NamedTuple):
    """One drop, over its frames from the first in which plate and bowl come within the detection tolerance."""

    frames: int
    deepest: float  # [m] maximum over samples of either in the other; mean over frames, 0 in one without any inside
    worst: float  # [m] maximum over frames
    depth: float  # [m] mean of all samples inside; mean over frames as above
    visits: float  # per frame
    contacts: float  # per frame
    colliding: float  # samples of either inside the other, per frame


def trials(size: Size) -> list[Trial]:
    return [
        _trial(size, seed, selection, contacts)
        for seed in range(size.drops)
        for selection in SELECTIONS
        for contacts in size.contacts
    ]


def _trial(size: Size, seed: int, selection: str, contacts: int) -> Trial:
    words = f"drop {seed}, {contacts} contacts, {selection}"
    return Trial(drop, (seed, selection, contacts, size.duration), words, False)


def drop(seed: int, selection: str, contacts: int, duration: float | None) -> Drop:
    """One drop, its penetration measured in each frame by all contacts of a world of its own, along nearest normals."""
    scene = random_drop(load_scene(SCENE), seed)
    if duration is not None:
        scene = scene._replace(duration=duration)
    settings = SELECTIONS[selection]._replace(contacts_per_pair=contacts)
    rows, witness = [], CollisionWorld(PAPERS)
    with Lockstep(scene, settings) as run:
        for body in run.simulation.start_bodies():
            witness.add_body(body)
        for exchange in run:
            visits = run.world.last_visits
            near = -every_contact(witness, exchange.states).gaps
            if len(near) or rows:
                inside = near[near > 0.0]
                depths = (inside.max(), inside.mean()) if len(inside) else (0.0, 0.0)
                rows.append((*depths, visits, len(exchange.contacts.gaps), len(inside)))
            run.world.forget()  # each step is searched from scratch, as with the paper's method
    if not rows:
        return Drop(0, *[0.0] * 6)
    found = np.array(rows, dtype=np.float64)
    deepest, depth, visits, listed, colliding = found.mean(axis=0).tolist()
    return Drop(len(rows), deepest, float(found[:, 0].max()), depth, visits, listed, colliding)


def tables(size: Size, results: Mapping[Trial, Any]) -> dict[str, list[Row]]:
    rows: list[Row] = []
    for selection in SELECTIONS:
        for contacts in size.contacts:
            drops = [results[_trial(size, seed, selection, contacts)] for seed in range(size.drops)]
            touching = [one for one in drops if one.frames]
            row: dict[str, Any] = {
                "selection": selection, "contacts_allowed": contacts, "drops": len(drops),
                "drops_that_touch": len(touching), "frames": sum(one.frames for one in touching),
            }  # fmt: skip
            for name, unit, scale in (
                ("deepest", "mm", MILLI), ("depth", "mm", MILLI), ("visits", "a_frame", 1.0),
                ("contacts", "a_frame", 1.0), ("colliding", "a_frame", 1.0),
            ):  # fmt: skip
                values = scale * np.array([getattr(one, name) for one in touching])
                row[f"{name}_{unit}"] = float(values.mean()) if len(values) else None
                row[f"{name}_{unit}_error"] = float(values.std() / np.sqrt(len(values))) if len(values) else None
            row["worst_mm"] = MILLI * max((one.worst for one in touching), default=0.0)
            rows.append(row)
    return {"": rows}


def draw(tables: Mapping[str, Table]) -> Figure:
    table = tables[""]
    figure, ((deepest, visits),) = new_figure(1, 2, height=4.0)
    for selection in table.values("selection"):
        own = table.where(selection=selection)
        allowed = own.column("contacts_allowed")
        for name, style, words in (("deepest_mm", "-o", "deepest sample"), ("depth_mm", "--s", "mean of all inside")):
            deepest.errorbar(
                allowed, own.column(name), own.column(f"{name}_error"), fmt=style, color=COLOURS[selection],
                markersize=4, linewidth=1.3, capsize=2, label=f"{selection}: {words}",
            )  # fmt: skip
        visits.errorbar(
            allowed, own.column("visits_a_frame"), own.column("visits_a_frame_error"), fmt="-o",
            color=COLOURS[selection], markersize=4, linewidth=1.3, capsize=2, label=selection,
        )  # fmt: skip
    for axes in (deepest, visits):
        axes.axvline(PAPERS_ENOUGH, color="black", linestyle="--", linewidth=1.0,
                     label=f"paper: {PAPERS_ENOUGH} contacts are enough")  # fmt: skip
        axes.set_xscale("log")
        ticks = table.values("contacts_allowed")
        axes.set_xticks(ticks, [str(tick) for tick in ticks])
        axes.minorticks_off()
    deepest.set_yscale("log")
    visits.set_ylim(bottom=0.0)
    finish(deepest, "penetration, mean over frames and drops", "contacts allowed a pair", "depth [mm]")
    finish(visits, "visited nodes", "contacts allowed a pair", "nodes a frame")
    return figure


def section(tables: Mapping[str, Table]) -> str:
    rows = [
        (
            f"{row['contacts_allowed']}, {row['selection']}", number(row["contacts_a_frame"]),
            number(row["colliding_a_frame"]), f"{number(row['deepest_mm'])} ± {number(row['deepest_mm_error'], 2)}",
            number(row["worst_mm"]), f"{number(row['depth_mm'])} ± {number(row['depth_mm_error'], 2)}",
            f"{number(row['visits_a_frame'])} ± {number(row['visits_a_frame_error'], 2)}",
        )
        for row in tables[""].rows
    ]  # fmt: skip
    first = tables[""].rows[0]
    meaning = {
        "adaptive": f"contacts deeper than ε = {PAPERS.penetration_tolerance} R are listed beyond the limit",
        "fixed": "the limit is never exceeded",
        "exact": "our method: up to the limit, spread over all near samples, and some more if more are deeper than ε"
        " (its visits are leaves and samples)",
    }
    listed = dict.fromkeys(str(row["selection"]) for row in tables[""].rows)
    legend = " ".join(f"*{selection.capitalize()}*: {meaning[selection]}." for selection in listed)
    return f"""\
{first["drops"]} random drops of a plate (R = 100 mm) into a bowl for each contact limit; the paper made 10,000.
Depths come from full detection in each frame. They are averaged over the frames from the first touch on, then over the
drops, ± the standard error. {legend}

{markdown_table(("contact limit", "listed per frame", "inside per frame", "deepest, mm", "worst, mm", "mean depth, mm",
                 "visited nodes per frame"), rows)}"""


STUDY = Study(
    "fig16", "Penetration and visits by contact limit (Fig. 16)", Size(4, (2, 3, 4, 6, 8, 12, 20, 50), 0.9),
    Size(100, (2, 3, 4, 5, 6, 7, 8, 10, 12, 16, 20, 30, 50)), trials, tables, {"": draw}, section,
)  # fmt: skip
