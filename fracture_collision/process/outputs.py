"""Outputs of a run that replace an earlier run's all together, or not at all.

A run writes into a folder of its own inside OUT, `.new-...`. At its end, or on `publish`, the earlier run's outputs are
removed and the new ones put in their place. A run that never started, or was killed, leaves OUT as it was.
"""

from __future__ import annotations

import fcntl
import os
import shutil
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

NEW, OLD = ".new-", ".old-"


class NewOutputs:
    """The outputs of a run in progress. Use as a context manager.

    At its end the contents of `folder` are published if `started` is true, whatever ended the run, and deleted
    otherwise.
    """

    def __init__(self, out: Path, names: Sequence[str]) -> None:
        """`names`: all that a run may leave in `out`, files and folders; nothing else there is touched."""
        self._out, self._names = out, tuple(names)
        self.started = False  # set by the run once it has results
        self.published = False
        self.folder = out  # of the new run

    def __enter__(self) -> NewOutputs:
        """Raises OSError if `out` cannot be written."""
        with ExitStack() as undo:
            undo.callback(_remove_empty, [each for each in (self._out, *self._out.parents) if not each.exists()])
            self._out.mkdir(parents=True, exist_ok=True)
            with _locked(self._out):
                self.folder = Path(tempfile.mkdtemp(prefix=NEW, dir=self._out))
                undo.callback(shutil.rmtree, self.folder, ignore_errors=True)
                undo.enter_context(_locked(self.folder))  # as long as its owner lives
            self._open = undo.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        with self._open:
            if self.started:
                self.publish()

    def publish(self) -> None:
        """Replaces the earlier run's outputs by the new ones.

        More may be written into the new ones afterwards, under their names in `out`.
        """
        with _locked(self._out):
            old = Path(tempfile.mkdtemp(prefix=OLD, dir=self._out))
            for name in self._names:
                with suppress(FileNotFoundError):
                    (self._out / name).rename(old / name)
            for name in self._names:
                with suppress(FileNotFoundError):
                    (self.folder / name).rename(self._out / name)
            shutil.rmtree(old)
            for left in self._out.glob(f"{NEW}*"):
                if left != self.folder:
                    _remove_ownerless(left)
        self.published, self.started = True, False


@contextmanager
def _locked(folder: Path, wait: bool = True) -> Iterator[None]:
    """Raises BlockingIOError if another process has the lock and `wait` is false. The lock ends with the process."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX if wait else fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield
    finally:
        os.close(handle)


def _remove_ownerless(folder: Path) -> None:
    """Removes the folder of a killed run."""
    with suppress(OSError), _locked(folder, wait=False):
        shutil.rmtree(folder)


def _remove_empty(folders: Sequence[Path]) -> None:
    """Innermost first; folders that are not empty stay."""
    with suppress(OSError):
        for folder in folders:
            folder.rmdir()
