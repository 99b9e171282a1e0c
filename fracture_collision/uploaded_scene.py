"""The scene of a mesh that a stranger uploaded, made in a process of its own.

A file is data: nothing in it is run, and no other file that it names is read. But a reader may take long, use much
memory or crash. So the process that reads has limits of time and memory, and what it costs is itself.
"""

from __future__ import annotations

import json
import os
import resource
import signal
import subprocess
import sys
import tempfile
import threading
from pathlib import Path

from fracture_collision.geometry.surface_files import SUFFIXES as SURFACES

SUFFIXES = (*SURFACES, ".npz")
SECONDS = 60  # of a processor, for reading and filling: the same files are accepted on a busy machine
PATIENCE = 10.0  # times SECONDS: a process that gets no time, or sleeps, is ended
MEMORY = 4 << 30  # [bytes] of addresses
MOST_TETRAHEDRA = 60_000  # a live scene must keep up with the clock
LONGEST_SIDE = 0.3  # [m]
LATER = 10  # niceness
MODULE = "fracture_collision.uploaded_scene"
INPUT, OUTCOME = "input", "outcome.json"
STOPPED = "the page is ending"
ONE_THREAD = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}


class UploadRejected(ValueError):
    """The text is for the user who sent the file."""


class SceneMaker:
    """One process at a time. `stop`, from another thread, ends it, and starts no other."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._process: subprocess.Popen | None = None
        self._stopped = False

    def make(self, content: bytes, suffix: str, scene: Path, seconds: int = SECONDS) -> None:
        """Write the scene file `scene` (.yaml), and its mesh beside it as .npz. Raises UploadRejected, OSError.

        content: of a file whose name ends in `suffix`, one of SUFFIXES. `seconds` of a processor are granted.
        """
        if suffix not in SUFFIXES:
            raise UploadRejected(f"{suffix or 'no suffix'} is none of {', '.join(SUFFIXES)}")
        with tempfile.TemporaryDirectory(prefix=".reading_", dir=scene.parent) as name:
            folder = Path(name)
            file = folder / f"{INPUT}{suffix}"
            file.write_bytes(content)
            self._run(file, scene.name, seconds)
            for written in (scene.with_suffix(".npz"), scene):
                (folder / written.name).replace(written)

    def stop(self) -> None:
        """End the process, if one runs, and start no other."""
        with self._lock:
            self._stopped = True
            if self._process is not None:
                self._process.kill()

    def _run(self, file: Path, scene_name: str, seconds: int) -> None:
        command = [sys.executable, "-m", MODULE, str(file), scene_name, str(seconds)]
        with self._lock:
            if self._stopped:
                raise UploadRejected(STOPPED)
            process = self._process = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, env=os.environ | ONE_THREAD
            )
        try:
            status = process.wait(PATIENCE * seconds)
        except subprocess.TimeoutExpired:
            raise UploadRejected(f"reading it takes more than {PATIENCE * seconds:g} s") from None
        finally:
            process.kill()
            process.wait()
            self._process = None
        if self._stopped:
            raise UploadRejected(STOPPED)
        outcome = file.with_name(OUTCOME)
        if status == -signal.SIGXCPU:
            raise UploadRejected(f"reading it takes more than {seconds} s of a processor")
        if not outcome.exists():
            raise UploadRejected(f"the process that read it ended with status {status}")
        if reason := json.loads(outcome.read_text(encoding="utf-8")):
            raise UploadRejected(reason)


def _write_scene(file: Path, scene: Path) -> str:
    """Write a scene with its mesh; returns the reason if that cannot be done. `file`: as it was uploaded."""
    from fracture_collision.lockstep import Lockstep
    from fracture_collision.meshing import read_mesh
    from fracture_collision.simulation.scene.scene import load_scene
    from fracture_collision.simulation.scene.scene_changes import write_own_scene

    try:
        mesh = read_mesh(file, longest_side=LONGEST_SIDE)
        if len(mesh.tetrahedra) > MOST_TETRAHEDRA:
            return f"{len(mesh.tetrahedra)} tetrahedra, more than {MOST_TETRAHEDRA}"
        write_own_scene(scene, scene.with_suffix(".npz").name, mesh, stands=True)
        with Lockstep(load_scene(scene)) as run:  # raises what the service would reject
            run.step()
    except ValueError as error:
        return str(error).removeprefix(f"{file}: ")
    except MemoryError:
        return f"reading it takes more than {MEMORY >> 30} GB of memory"
    return ""


def main() -> None:
    """Writes the outcome beside the file, then ends."""
    file, scene_name, seconds = Path(sys.argv[1]), sys.argv[2], int(sys.argv[3])
    outcome, scene = file.with_name(OUTCOME), file.with_name(scene_name)
    os.nice(LATER)
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 1))
    outcome.write_text(json.dumps(_write_scene(file, scene)), encoding="utf-8")


if __name__ == "__main__":
    main()
