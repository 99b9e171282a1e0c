"""Fig. 5: a rolling plate, with up to 6 and up to 128 contacts per pair.

The paper shows where the contacts are. What matters is whether the plate rolls the same way: its height, its energy,
its bumps. The choice of contacts depends on the detection tolerance, so that is varied too.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure
from scipy.spatial.transform import Rotation

from benchmarks.studies.pictures import BLUE, GREEN, ORANGE, RED, finish, new_figure
from benchmarks.studies.scene_trials import ONE_THREAD
from benchmarks.studies.study import Study, Trial
from benchmarks.studies.table import Row, Table, average_and_worst, markdown_table, number
from fracture_collision.lockstep import Lockstep
from fracture_collision.simulation.scene.scene import load_scene

FEW, MANY = 6, 128
TOLERANCES = (ONE_THREAD.detection_tolerance, 0.02)  # of R: the service's default, and one that reaches along the rim
ROLLING = 2.0  # [s] from its start, the plate rolls upright; then it begins to swing
EVERY = 15  # steps per row of the table of steps
MILLI = 1e3
COLOURS = {(TOLERANCES[0], FEW): BLUE, (TOLERANCES[0], MANY): ORANGE,
           (TOLERANCES[1], FEW): RED, (TOLERANCES[1], MANY): GREEN}  # fmt: skip


class Size(NamedTuple):
    duration: float  # [s]
    tolerances: tuple[float, ...] = TOLERANCES


class Roll(NamedTuple):
    """For each step, (n,)."""

    center: np.ndarray  # (n, 3) [m], of mass
    energy: np.ndarray  # [J]
    contacts: np.ndarray
    visits: np.ndarray
    collision: np.ndarray  # [s]
    total: np.ndarray  # [s]


def trials(size: Size) -> list[Trial]:
    return [
        _trial(size.duration, tolerance, contacts) for tolerance in size.tolerances for contacts in (FEW, MANY)
    ]


def _trial(duration: float, tolerance: float, contacts: int) -> Trial:
    words = f"rolling plate, up to {contacts} contacts within {tolerance} R"
    return Trial(roll, (duration, tolerance, contacts), words, True)


def roll(duration: float, tolerance: float, contacts: int) -> Roll:
    """The only moving body in rolling_plate."""
    scene = load_scene("rolling_plate")._replace(duration=duration)
    settings = ONE_THREAD._replace(detection_tolerance=tolerance, contacts_per_pair=contacts)
    rows = []
    with Lockstep(scene, settings) as run:
        for exchange in run:
            row = int(np.flatnonzero(exchange.registry.fragment_ids == exchange.states.fragment_ids[0])[0])
            own = exchange.registry.centers_of_mass[row]
            turn = Rotation.from_quat(exchange.states.orientations[0])
            center = exchange.states.positions[0] + turn.apply(own)
            report = exchange.report
            rows.append((
                *center, report.kinetic_energy + report.potential_energy, report.contacts, run.world.last_visits,
                exchange.times.collision, exchange.times.total,
            ))  # fmt: skip
    found = np.array(rows)
    return Roll(found[:, :3], *found[:, 3:].T)


def tables(size: Size, results: Mapping[Trial, Any]) -> dict[str, list[Row]]:
    step = load_scene("rolling_plate").time_step
    summary, steps = [], []
    for tolerance in size.tolerances:
        reference: Roll = results[_trial(size.duration, tolerance, MANY)]
        for contacts in (FEW, MANY):
            found: Roll = results[_trial(size.duration, tolerance, contacts)]
            rolling = slice(0, round(ROLLING / step))
            acceleration = np.diff(found.center[rolling, 2], 2) / step**2
            summary.append({
                "tolerance_R": tolerance,
                "contacts_allowed": contacts,
                "contacts_average": found.contacts.mean(),
                "contacts_worst": int(found.contacts.max()),
                "visits_average": found.visits.mean(),
                "energy_lost_percent": 100.0 * (1.0 - found.energy[rolling][-1] / found.energy[0]),
                "energy_gained_most_mJ": MILLI * float(np.diff(found.energy).max()),
                "bumps_rms_m_s2": float(np.sqrt(np.mean(acceleration**2))),
                "off_path_rolling_mm": MILLI * _farthest(found.center[rolling], reference.center[rolling]),
                "off_path_mm": MILLI * _farthest(found.center, reference.center),
                "collision_ms_average": MILLI * found.collision.mean(),
                "collision_ms_worst": MILLI * found.collision.max(),
                "total_ms_average": MILLI * found.total.mean(),
                "total_ms_worst": MILLI * found.total.max(),
            })  # fmt: skip
            for i in range(0, len(found.energy), EVERY):
                x, y, z = found.center[i]
                steps.append({
                    "tolerance_R": tolerance, "contacts_allowed": contacts, "time": i * step, "x_m": x, "y_m": y,
                    "height_mm": MILLI * z, "energy_J": found.energy[i],
                    "contacts": found.contacts[i : i + EVERY].mean(),
                })  # fmt: skip
    return {"": summary, "steps": steps}


def _farthest(some: np.ndarray, others: np.ndarray) -> float:
    return float(np.linalg.norm(some - others, axis=1).max())


def draw(tables: Mapping[str, Table]) -> Figure:
    figure, ((height, energy), (path, contacts)) = new_figure(2, 2)
    steps = tables["steps"]
    # the many are broad bands in the background, so that the few stay visible on them
    for allowed in (MANY, FEW):
        for tolerance in steps.values("tolerance_R"):
            own = steps.where(tolerance_R=tolerance, contacts_allowed=allowed)
            width = 4.0 if allowed == MANY else 1.3
            how = {
                "color": COLOURS[tolerance, allowed], "linewidth": width, "alpha": 0.5 if allowed == MANY else 1.0,
                "label": f"up to {allowed} within {100 * tolerance:g} % R",
            }  # fmt: skip
            time = own.column("time")
            height.plot(time, own.column("height_mm"), **how)
            energy.plot(time, own.column("energy_J"), **how)
            path.plot(own.column("x_m"), own.column("y_m"), **how)
            contacts.plot(time, own.column("contacts"), **how)
    finish(height, "height of the centre of mass", "simulated time [s]", "height [mm]")
    finish(energy, "energy, kinetic and potential", "simulated time [s]", "energy [J]", None)
    finish(path, "path on the ground", "x [m]", "y [m]", None)
    finish(contacts, "contacts", "simulated time [s]", f"contacts a step, mean of {EVERY}", None)
    path.set_aspect("equal", "datalim")
    return figure


def section(tables: Mapping[str, Table]) -> str:
    rows = [
        (
            f"{100 * row['tolerance_R']:g} % R, up to {row['contacts_allowed']}",
            average_and_worst(row, "contacts"),
            number(row["energy_lost_percent"]), number(row["bumps_rms_m_s2"]),
            number(row["off_path_rolling_mm"]), number(row["off_path_mm"]),
            average_and_worst(row, "collision_ms"), average_and_worst(row, "total_ms"),
        )
        for row in tables[""].rows
    ]  # fmt: skip
    seconds = max(row["time"] for row in tables["steps"].rows)
    equal = [
        f"{100 * tolerance:g} % R"
        for tolerance in tables[""].values("tolerance_R")
        if tables[""].where(tolerance_R=tolerance, contacts_allowed=FEW).rows[0]["off_path_mm"] == 0.0
    ]
    verdict = f"At {' and '.join(equal)} both runs are identical to the last digit: no contact is dropped. "
    return f"""\
A plate rolls on its rim over the ground for {ROLLING:g} s, then begins to wobble and falls ({seconds:.1f} s in all;
scene `rolling_plate`). Contacts are detected within the detection tolerance. The rim is a polygon of 120 corners, so
few of them are that near. {verdict if equal else ""}Bumps: rms of the vertical acceleration in the first {ROLLING:g}
s. Contacts and times are average / worst:

{markdown_table(
    ("tolerance, contact limit", "contacts", f"energy lost in {ROLLING:g} s, %", "bumps, m/s²",
     f"off the path with {MANY}: in {ROLLING:g} s, mm", "at any time, mm", "collision, ms", "whole step, ms"), rows)}"""


STUDY = Study(
    "fig5", f"Rolling plate: {FEW} against {MANY} contacts (Fig. 5)", Size(3.6), Size(6.0),
    trials, tables, {"": draw}, section,
)  # fmt: skip
