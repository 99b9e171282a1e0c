"""Trials on a dask cluster: local processes, or any scheduler by its address."""

from __future__ import annotations

import logging
import os
import signal
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from multiprocessing import resource_tracker
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import dask
from distributed import Client, LocalCluster, TimeoutError, as_completed
from distributed.utils import silence_logging_cmgr

from benchmarks.studies.machine import machine, versions
from benchmarks.studies.study import StudyError, Trial

# Above all levels: if a worker ends during a write to it, the scheduler logs this as critical, with a traceback.
SILENCE = logging.CRITICAL + 1
# A worker's profiler would wake up a hundred times a second during timed work.
QUIET = {"distributed.worker.profile.enabled": False, "distributed.admin.system-monitor.interval": "10s"}
CONNECT_SECONDS = 10
LOOK_SECONDS = 5  # interval of checks that the timing worker is alive


class Cluster(NamedTuple):
    client: Client
    timing_worker: str  # address of the worker that runs all timed trials


@contextmanager
def cluster(address: str | None, workers: int) -> Iterator[Cluster]:
    """The workers of the scheduler at `address`, or `workers` processes of one thread each, ended with the context.

    Raises StudyError if there is no such scheduler, or if a worker has other sources or versions.
    """
    # outermost: the cluster's own silence ends before its last messages
    with TemporaryDirectory() as folder, dask.config.set(QUIET), silence_logging_cmgr(SILENCE):
        if address is None:
            with _deaf_to_interrupts():
                processes = LocalCluster(
                    n_workers=workers, threads_per_worker=1, processes=True, host="127.0.0.1", scheduler_port=0,
                    dashboard_address="127.0.0.1:0", memory_limit=None, local_directory=folder,
                    silence_logs=SILENCE,
                )  # fmt: skip
            with processes, Client(processes) as client:
                yield _prepared(client)
            return
        try:
            client = Client(address, timeout=CONNECT_SECONDS, set_as_default=False)
        except (OSError, ValueError) as error:
            raise StudyError(f"no scheduler at {address}: {error}") from error
        with client:
            _require_equals(client)
            yield _prepared(client)


def machine_of(crew: Cluster) -> dict[str, str]:
    """The machine on which times are measured."""
    return crew.client.run(machine, workers=[crew.timing_worker])[crew.timing_worker]


def run_trials(crew: Cluster, trials: Sequence[Trial], done: Callable[[Trial], None]) -> dict[Trial, Any]:
    """The result of each trial; calls `done` after each. Raises StudyError with the message of one that fails.

    Untimed trials run in parallel, then the timed ones, alone.
    """
    client, worker = crew
    found: dict[Trial, Any] = {}
    together = {}
    for trial in dict.fromkeys(trials):
        if not trial.is_timed:
            together[client.submit(trial.run, *trial.arguments, pure=False)] = trial
    for future in as_completed(list(together), loop=client.loop):
        found[together[future]] = _result(together[future], future)
        done(together[future])
    for trial in dict.fromkeys(trials):
        if trial.is_timed:
            future = client.submit(trial.run, *trial.arguments, pure=False, workers=[worker], allow_other_workers=False)
            while not _is_done(future):
                if worker not in client.ncores():
                    raise StudyError(f"{trial.words}: worker {worker} has died")
            found[trial] = _result(trial, future)
            done(trial)
    return found


@contextmanager
def _deaf_to_interrupts() -> Iterator[None]:
    """Blocks SIGINT in threads and processes started in this context.

    A terminal sends it to all of them, but only this process ends the workers, in order. A SIGINT that arrives
    meanwhile is delivered to it afterwards.
    """
    resource_tracker.ensure_running()  # its first start unblocks signals again
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _prepared(client: Client) -> Cluster:
    return Cluster(client, min(client.run(_bring_kernels_into_memory)))


def _bring_kernels_into_memory() -> None:
    """In a worker, before its first trial. PyBullet prints a banner on standard error, into the progress bar."""
    kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 2)
    try:
        import fracture_collision.simulation.warm_up as simulator
        import fracture_collision.world.warm_up as service

        service.compile_kernels(progress=lambda words: None)
        simulator.compile_kernels(progress=lambda words: None)
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)


def _is_done(future: Any) -> bool:
    """Returns after LOOK_SECONDS at most."""
    try:
        future.exception(timeout=LOOK_SECONDS)
    except TimeoutError:
        return False
    return True


def _result(trial: Trial, future: Any) -> Any:
    try:
        return future.result()
    except Exception as error:  # any error of a trial, or a dead worker
        raise StudyError(f"{trial.words}: {type(error).__name__}: {error}") from error
    finally:
        future.release()


def _require_equals(client: Client) -> None:
    def of_worker() -> dict[str, str] | str:
        # a local function is sent by value: a worker without these sources can still report that
        try:
            from benchmarks.studies.machine import versions
        except ImportError as error:
            return f"has not these sources: {error}; start it in a checkout of them"
        return versions()

    found = client.run(of_worker)
    if not found:
        raise StudyError("the scheduler has no workers")
    own = versions()
    for worker, theirs in sorted(found.items()):
        if isinstance(theirs, str):
            raise StudyError(f"worker {worker} {theirs}")
        for name, value in own.items():
            if theirs[name] != value:
                raise StudyError(f"worker {worker} has other {name}: {theirs[name]}; here: {value}")
