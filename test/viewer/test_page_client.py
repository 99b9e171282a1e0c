"""The client used by benchmarks/page: without drawing, it receives what a browser receives."""

from __future__ import annotations

from stages.browser import until
from worlds.small_run import small_run

from benchmarks.page.lookers import taker
from fracture_collision.records import CollisionBody, FragmentStates
from fracture_collision.viewer.page.page import Page

PICTURES = 5


def test_a_test_client_gets_the_meshes_and_poses_of_a_browser() -> None:
    records = [record for _, record in small_run()]
    states = next(r for r in records if isinstance(r, FragmentStates))
    with Page() as page:
        for record in records:
            if isinstance(record, CollisionBody):
                page.add_body(record)
        page.show_states(states)
        with taker(page.address) as seen:
            until(lambda: sorted(mesh.fragment_id for mesh in seen.meshes()), lambda ids: ids == [2, 3, 4, 5])
            until(lambda: page.browsers, lambda count: count == 1)
            until(lambda: seen.pictures().count, bool)  # the state at its connection
            places, counted = states.positions.reshape(-1, 3), []
            for step in range(1, PICTURES + 1):
                before = page.pictures
                page.show_states(states._replace(positions=(places + [0.0, 0.0, 0.01 * step]).ravel()))
                until(lambda before=before: page.pictures, lambda count, before=before: count > before)
            # a newer pose may replace one that has not been sent
            until(lambda: counted.append(seen.pictures()) or sum(each.count for each in counted), bool)
    assert sum(each.count for each in counted) <= PICTURES + 1  # plus one that may have been in flight
    assert 0.0 < counted[-1].moved <= len(places)
    assert not seen.shown()
