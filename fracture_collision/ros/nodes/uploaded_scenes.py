"""Scenes of meshes that users upload: made by the page, loaded by the live simulator, by name."""

from __future__ import annotations

import re
import threading
from collections.abc import Callable
from itertools import count
from pathlib import Path, PurePath

from fracture_collision.uploaded_scene import SceneMaker, UploadRejected
from fracture_collision.viewer.page.page_events import Upload

UPLOADS = "uploads"  # folder in that of a page
NAME = re.compile(r"upload_[0-9]{1,6}", re.ASCII)
MOST_SCENES = 200  # in a folder: each may take some megabytes


def scene_file(folder: Path, name: str) -> Path | None:
    """The file of the uploaded scene `name`; None if there is none. No other file can be named."""
    file = folder / f"{name}.yaml"
    return file if NAME.fullmatch(name) and file.is_file() else None


class UploadedScenes:
    """Makes scenes in the folder that scene_file reads, one at a time; their names are upload_1, upload_2 ..."""

    def __init__(self, folder: Path, made: Callable[[str, Upload], None]) -> None:
        """`made` gets each new scene's name, in another thread."""
        self._folder, self._made = folder, made
        self._maker = SceneMaker()
        self._thread: threading.Thread | None = None

    def add(self, upload: Upload) -> None:
        """Begin to make a scene; the user hears of its outcome."""
        if self._thread is not None and self._thread.is_alive():
            upload.tell(f"{upload.name}: another mesh is being read; try again")
            return
        self._thread = threading.Thread(target=self._make, args=(upload,), name="upload", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Ends what is being made."""
        self._maker.stop()
        if self._thread is not None:
            self._thread.join()

    def _make(self, upload: Upload) -> None:
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            scene = self._new_file()
            self._maker.make(upload.content, PurePath(upload.name).suffix.lower(), scene)
        except (UploadRejected, OSError) as error:
            # The reason of an OSError without its path, which is no concern of the user's.
            upload.tell(f"{upload.name}: {error.strerror if isinstance(error, OSError) else error}")
        else:
            self._made(scene.stem, upload)

    def _new_file(self) -> Path:
        names = (f"upload_{number}" for number in count(1))
        name = next(name for name in names if not (self._folder / f"{name}.yaml").exists())
        if int(name.rpartition("_")[2]) > MOST_SCENES:
            raise UploadRejected(f"{MOST_SCENES} meshes are uploaded already; the operator may delete some")
        return self._folder / f"{name}.yaml"
