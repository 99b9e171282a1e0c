"""Remaining depth and unnecessary motion after the least translation, for boxes of known depth."""

from __future__ import annotations

import numpy as np
import pytest
from test_peers import OVERLAP, blocks, judged, one_contact, placed  # noqa: F401 - blocks is a fixture

from benchmarks.peers.judging import score as score_module
from benchmarks.peers.judging.moved_pairs import MovedPairs, Way
from benchmarks.peers.judging.score import FrameTruth, score
from benchmarks.peers.judging.solver_error import HALVINGS, RESOLVED, translations
from benchmarks.peers.judging.truth import Solids
from benchmarks.peers.method import Contacts, contacts_of, no_contacts

INTO, APART = (1.0 - OVERLAP, 0.05, 0.05), (1.0 + OVERLAP, 0.0, 0.0)
X, Y = np.eye(3)[:2]


def contacts(normals: list[np.ndarray], depths: list[float]) -> Contacts:
    count = len(depths)
    points = np.zeros((count, 3))
    return contacts_of([0] * count, [1] * count, points, points, normals, depths)


def test_depths_after_parts_of_a_translation(blocks: Solids) -> None:  # noqa: F811
    frame = placed(INTO)
    ways = [Way(frame, 0, 1, shift, OVERLAP) for shift in (OVERLAP * X, -2.0 * OVERLAP * X, OVERLAP * Y)]
    pairs = MovedPairs(blocks, ways)
    assert pairs.depths(np.zeros(3)) == pytest.approx(3 * [OVERLAP])
    assert pairs.depths(np.array([0.25, 0.5, 1.0])) == pytest.approx([0.75 * OVERLAP, 2.0 * OVERLAP, OVERLAP])
    asked = pairs.depths(np.array([1.0, np.nan, 0.5]))
    assert asked[0] == pytest.approx(0.0, abs=1e-9) and np.isnan(asked[1]) and asked[2] == pytest.approx(OVERLAP)


def test_a_turned_pair_moves_in_the_world(blocks: Solids) -> None:  # noqa: F811
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    frame = placed(INTO)._replace(rotations=np.array([np.eye(3), turn]))
    pairs = MovedPairs(blocks, [Way(frame, 0, 1, OVERLAP * way, OVERLAP) for way in (X, Y)])
    assert pairs.depths(np.full(2, 0.5)) == pytest.approx([0.5 * OVERLAP, OVERLAP])


@pytest.mark.parametrize(
    ("second", "answer", "remaining", "unnecessary", "of_depth"),
    [
        (INTO, one_contact(OVERLAP), 0.0, RESOLVED, 0.0),
        (INTO, contacts([X, X, X], [OVERLAP, 0.5 * OVERLAP, OVERLAP]), 0.0, RESOLVED, 0.0),  # redundant
        (INTO, one_contact(3.0 * OVERLAP), 0.0, 2.0 * OVERLAP + RESOLVED, 2.0 * OVERLAP),  # too far
        (INTO, one_contact(0.25 * OVERLAP), 0.75 * OVERLAP, 0.0, 0.75 * OVERLAP),  # not far enough
        (INTO, one_contact(OVERLAP, (0.0, 1.0, 0.0)), OVERLAP, OVERLAP, 0.0),  # along the face: no effect
        (INTO, contacts([X, Y], [OVERLAP, OVERLAP]), 0.0, np.sqrt(2.0) * RESOLVED, 0.0),  # a false one beside the right
        (INTO, no_contacts(), OVERLAP, 0.0, OVERLAP),  # missed
        (INTO, one_contact(-0.001), OVERLAP, 0.0, OVERLAP),  # a gap is no penetration
        (APART, no_contacts(), 0.0, 0.0, 0.0),
        (APART, one_contact(OVERLAP), 0.0, OVERLAP, OVERLAP),  # false
        (APART, one_contact(0.001), 0.0, 0.001, 0.001),  # however small
    ],
)
def test_errors_of_a_pair(
    blocks: Solids, second, answer: Contacts, remaining: float, unnecessary: float, of_depth: float  # noqa: F811
) -> None:
    got = judged(blocks, placed(second), answer)
    assert got.pair_error_max == got.pair_error_mean == pytest.approx(of_depth, abs=1e-9)
    step = 3.0 * OVERLAP / 2**HALVINGS
    assert got.remaining_max == got.remaining_mean == pytest.approx(remaining, abs=1e-9)
    assert got.unnecessary_max == got.unnecessary_mean == pytest.approx(unnecessary, abs=step)
    assert got.solver_error_max == pytest.approx(got.remaining_max + got.unnecessary_max)


def test_at_most_solver_pairs_are_judged(blocks: Solids, monkeypatch: pytest.MonkeyPatch) -> None:  # noqa: F811
    frame = placed(INTO)
    truths = [FrameTruth(frame, blocks.truth(frame), {(0, 1)}, {})] * 4
    answers = [no_contacts()] * 3 + [one_contact(OVERLAP)]
    all_of_them = score(blocks, truths, answers)
    assert all_of_them.remaining_mean == pytest.approx(0.75 * OVERLAP)
    monkeypatch.setattr(score_module, "SOLVER_PAIRS", 1)
    one = score(blocks, truths, answers)
    assert one.remaining_mean == one.remaining_max and one == score(blocks, truths, answers)
    assert one.pair_error_mean == all_of_them.pair_error_mean


def test_translations_by_pair() -> None:
    # the second listed first, with its normal reversed; another pair in between
    zero = np.zeros((3, 3))
    answer = contacts_of([1, 2, 0], [0, 1, 1], zero, zero, [-X, X, Y], [OVERLAP, 2.0 * OVERLAP, 2.0 * OVERLAP])
    found = translations(answer)
    assert list(found) == [(0, 1), (1, 2)]
    np.testing.assert_allclose(found[0, 1], OVERLAP * (X + 2.0 * Y), atol=1e-12)
    np.testing.assert_allclose(found[1, 2], -2.0 * OVERLAP * X, atol=1e-12)
    assert translations(no_contacts()) == {}
