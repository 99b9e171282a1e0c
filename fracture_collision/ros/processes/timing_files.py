"""Columns of the arrays that both nodes leave in `timing_file`; a row for each answer or step."""

from __future__ import annotations

from pathlib import Path

import numpy as np

# Times in seconds; `visits` counts sphere tree nodes.
SERVICE_COLUMNS = ("step", "fracture_sequence", "collision", "update", "conversion", "visits")

# Times in seconds, energies in joules, lengths in metres; as in simulation.StepReport.
SIMULATOR_COLUMNS = (
    "step",
    "time",
    "contacts",
    "fragments",
    "total",
    "round_trip",
    "solver",
    "fracture",
    "kinetic_energy",
    "potential_energy",
    "drift_energy",
    "max_speed",
    "deepest_gap",
)


class RowFile:
    """A .npy file of float64 rows, written as they come, so that hours of them need no memory."""

    def __init__(self, path: Path, columns: int) -> None:
        """Raises OSError."""
        self._columns = columns
        self._rows = 0
        self._file = path.open("wb")
        self._write_header()

    def add(self, row: tuple[float, ...]) -> None:
        """Writes one row; it must have as many numbers as the file has columns."""
        self._file.write(np.array(row, dtype="<f8").tobytes())
        self._rows += 1

    def close(self) -> None:
        """Writes the number of rows into the header."""
        self._file.seek(0)
        self._write_header()
        self._file.close()

    def _write_header(self) -> None:
        # numpy leaves room for the longest count of rows, so that the header can be overwritten
        header = {"descr": "<f8", "fortran_order": False, "shape": (self._rows, self._columns)}
        np.lib.format.write_array_header_1_0(self._file, header)
