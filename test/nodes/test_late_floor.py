"""States that leave out the floor are never answered without it, however topics overtake each other."""

from __future__ import annotations

from pathlib import Path

from campaigns.late_floor import late_floor


def test_no_answer_lacks_the_floor(tmp_path: Path) -> None:
    found = late_floor(tmp_path, starts=6, restarts=1, progress=lambda text: None)
    assert (found.trials, found.without_floor, found.unanswered) == (7, 0, 0)
    assert found.answers >= 7
