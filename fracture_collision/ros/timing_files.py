"""Columns of the arrays that both nodes write at their end into `timing_file`; a row for each answer or step."""

from __future__ import annotations

# Times in seconds; `visits` counts sphere tree nodes.
SERVICE_COLUMNS = ("step", "fracture_sequence", "collision", "update", "conversion", "visits")

# Times in seconds, energies in joules, lengths in metres; as in simulation.StepReport.
SIMULATOR_COLUMNS = (
    "step",
    "time",
    "contacts",
    "fragments",
    "acknowledgement",
    "round_trip",
    "solver",
    "fracture",
    "kinetic_energy",
    "potential_energy",
    "drift_energy",
    "max_speed",
    "deepest_gap",
)
