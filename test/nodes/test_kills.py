"""Kill and restart: a slice of `python -m campaigns.kills` over real DDS, and its building blocks."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import pytest

from campaigns.kills.mixed import kill_mixed, medians
from campaigns.kills.stage import Digests, await_no_litter, await_that, litter
from campaigns.kills.trials import kill_listeners, kill_services, kill_simulators, orders_of_ending, undisturbed
from campaigns.soak import Cycle, growth, soak
from fracture_collision.bag.reader import message_counts

SCENE, STEPS = "pane", 60
LONG_SCENE = "plates"  # runs for seconds, long enough to kill nodes in
SOON = 0.1  # [s] after the first step; the whole run takes less than a second
pytestmark = pytest.mark.timeout(900)


def no_progress(_text: str) -> None:
    """Ignores progress."""


@pytest.fixture(scope="module")
def reference(tmp_path_factory: pytest.TempPathFactory) -> Digests:
    folder = tmp_path_factory.mktemp("undisturbed")
    found = undisturbed(folder, SCENE)
    assert message_counts(folder / "bag")["/fragment_states"] >= STEPS  # more if some states were resent
    return found


def test_a_restarted_service_gives_the_same_run(tmp_path: Path, reference: Digests) -> None:
    before = litter()
    returns, different, lost = kill_services(tmp_path, SCENE, 1, 3, reference, no_progress, SOON)
    assert len(returns) == 1 and different == 0 and lost <= 1
    await_no_litter(before)


@pytest.mark.slow
def test_the_comparison_of_runs_can_fail(tmp_path: Path, reference: Digests) -> None:
    other = reference._replace(registry="0" * 64)
    found = kill_services(tmp_path, SCENE, 1, 1, other, no_progress, SOON)
    runs = list(tmp_path.glob("run_*"))  # several if a run ended before its service was killed
    assert len(found.returns) == 1 and found.different == len(runs)


def test_different_answers_are_reported_and_lost_ones_counted(reference: Digests) -> None:
    assert not reference.differs(reference) and reference.lost(reference) == 0
    step = min(reference.answers)
    assert reference._replace(answers=reference.answers | {step: "0" * 64}).differs(reference, may_lack=1)
    lacking = reference._replace(answers={k: v for k, v in reference.answers.items() if k != step})
    assert lacking.lost(reference) == 1
    assert lacking.differs(reference) and not lacking.differs(reference, may_lack=1)


@pytest.mark.slow
def test_a_service_follows_the_next_simulator_after_a_kill(tmp_path: Path, reference: Digests) -> None:
    assert kill_simulators(tmp_path, SCENE, 1, 3, reference, no_progress) == 0


@pytest.mark.slow
def test_a_killed_listener_does_not_change_the_run(tmp_path: Path, reference: Digests) -> None:
    assert kill_listeners(tmp_path, SCENE, 1, 3, reference, no_progress) == 0


def test_service_and_recorder_restart_after_kills_at_the_worst_moments(tmp_path: Path) -> None:
    mixed = kill_mixed(tmp_path, LONG_SCENE, 4, 2, no_progress)
    assert mixed.kills >= 4 and mixed.returns
    assert mixed.deaf == [] and mixed.faults == []
    assert all(count > 0 for count, _, _ in medians(mixed.returns).values())


@pytest.mark.slow
def test_nodes_end_by_signals_in_any_order(tmp_path: Path) -> None:
    assert list(orders_of_ending(tmp_path, SCENE, no_progress)) == []


@pytest.mark.slow
def test_a_soak_measures_memory_and_processor_time(tmp_path: Path) -> None:
    (first,) = soak(tmp_path, SCENE, 2, 0.1, True, no_progress)
    assert first.runs == 2 and first.age > 0.1
    assert first.resident > 50.0 and 0.0 < first.processor < 60.0


@pytest.mark.slow
def test_a_soak_in_the_background_ends_on_sigint(tmp_path: Path) -> None:
    """A shell starts background jobs with SIGINT ignored."""
    before = litter().processes
    command = [sys.executable, "-m", "campaigns.soak", "--scene", SCENE, "--seeds", "1", "--out", str(tmp_path)]
    process = subprocess.Popen(command, stderr=subprocess.DEVNULL, preexec_fn=_ignore_ctrl_c)
    try:
        log = tmp_path / "logs" / "collision_node_1.log"
        await_that(lambda: log.exists() and "loading kernels" in log.read_text(), "a service that is soaked")
        assert process.poll() is None
        process.send_signal(signal.SIGINT)
        assert process.wait(60.0) not in (0, -signal.SIGINT)
    finally:
        process.kill()
    assert litter().processes <= before


def _ignore_ctrl_c() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def test_growth_of_memory_and_time_is_reported() -> None:
    steady = [Cycle(100.0 * k, k, 200.0, 3.0) for k in range(1, 30)]
    assert growth(steady) == (0.0, 0.0)
    leaking = [cycle._replace(resident=200.0 + 0.01 * cycle.age) for cycle in steady]
    slowing = [cycle._replace(processor=3.0 + 0.001 * cycle.age) for cycle in steady]
    assert growth(leaking)[0] > 0.1 and growth(slowing)[1] > 0.5
    with pytest.raises(ValueError, match="too few"):
        growth(steady[:3])
