"""A slice of the bad-input campaign.

Every mutation of every field once, several at once, and corrupted bytes. The whole campaign is a slow test.
"""

from __future__ import annotations

import re
import tracemalloc
from collections import Counter

import pytest

from campaigns.bad_input.campaign import (
    TOPICS,
    Tally,
    every_case,
    nothing,
    numbered,
    picking,
    run,
    run_campaign,
    run_chunk,
)
from campaigns.bad_input.clean_scene import SETTINGS
from campaigns.bad_input.doors import REFUSED, TAKEN
from campaigns.bad_input.mutations import ANY_KIND
from campaigns.bad_input.refusal_sites import counted, files_of_messages, refusal_sites
from campaigns.bad_input.trial import REJECTED, Bench, Case, several

CASES = 100_000


def must_be_as_expected(tally: Tally) -> None:
    assert not tally.problems, "\n".join(f"{p.door}, {p.name}: {p.text}" for p in tally.problems[:5])


def test_every_mutation_of_every_field_through_both_doors() -> None:
    tally = run(every_case(seed=1))
    must_be_as_expected(tally)
    assert tally.cases > 1500
    assert {kind for _, kind in tally.kinds} == ANY_KIND | REJECTED
    assert [str(site) for site, count in counted(tally.sites).items() if not count] == []
    assert min(tally.outcomes[topic, door, REFUSED] for topic in TOPICS for door in ("records", "messages")) > 40
    assert min(tally.outcomes[topic, door, TAKEN] for topic in TOPICS for door in ("records", "messages")) > 10


def test_refusal_sites_are_all_lines_that_reject() -> None:
    """Those read from the syntax are those found in the text; otherwise a line without a case would go unnoticed."""
    sites = Counter(site.file for site in refusal_sites())
    assert sites.total() > 60
    for file in files_of_messages():
        text = re.sub(r"def refuse\(.*?(?=\n\S|\Z)", "", file.read_text(encoding="utf-8"), flags=re.DOTALL)
        assert sites[str(file)] == len(re.findall(r"\brefuse\(|raise \w*(?:Invalid|Ahead)\w*\(", text)), file.name


def test_a_slice_of_the_campaign() -> None:
    tally = nothing()
    for part in run_campaign(600, seed=2, workers=1):
        tally = tally + part
    must_be_as_expected(tally)
    assert tally.cases == 600 and tally.readers["bodies", "both"] > 15 and tally.readers["bodies", "neither"] > 15
    again = run_chunk(2, 0, 60)
    assert again.sites == run_chunk(2, 0, 60).sites and not again.sites - tally.sites


def test_several_mutations_in_one_message() -> None:
    cases = (several(TOPICS[k % len(TOPICS)], k, picking(3, k), 2 + k % 3) for k in range(900))
    tally = run(("messages", case) for case in cases if case.on_the_wire)
    must_be_as_expected(tally)
    assert tally.cases > 40


def test_rejected_messages_leave_nothing_in_memory() -> None:
    bench = Bench("records", SETTINGS)
    kept: list[Case] = []
    for number in range(500):
        door, case = numbered(7, number)
        if door == "records" and bench.judge(case) == "" and bench.verdict.outcome == REFUSED:
            kept.append(case)
    assert len(kept) > 150
    # A leak grows with every round. The interpreter's free lists of tuples fill up within some rounds, as each full
    # garbage collection empties them.
    grown: list[int] = []
    tracemalloc.start()
    try:
        while len(grown) < 8 and not any(growth < 20_000 for growth in grown):
            before = tracemalloc.get_traced_memory()[0]
            for case in kept:
                bench.judge(case)
            grown.append(tracemalloc.get_traced_memory()[0] - before)
    finally:
        tracemalloc.stop()
    assert grown[-1] < 20_000, grown


def test_the_judge_reports_unexpected_verdicts() -> None:
    """Tests the judge: legal cases labelled as rejected, rejected ones as legal, or with a wrong kind or field name."""
    bench = Bench("records", SETTINGS)
    (_, refused), (_, taken) = next(c for c in every_case(1) if c[1].kinds == {"retired_id"}), next(
        c for c in every_case(1) if c[1].must_pass
    )  # fmt: skip
    assert bench.judge(refused) == "" and bench.judge(taken) == ""
    assert "was taken" in bench.judge(taken._replace(must_fail=True))
    assert "was refused" in bench.judge(refused._replace(must_pass=True))
    assert "not doubled" in bench.judge(refused._replace(kinds=frozenset({"doubled"})))
    assert "name none of" in bench.judge(refused._replace(names=frozenset({"density"})))
    assert "raised" in bench.judge(refused._replace(record=None))
    assert bench.retire() == ""


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_the_whole_campaign() -> None:
    tally = nothing()
    for part in run_campaign(CASES, seed=1, workers=2):
        tally = tally + part
    must_be_as_expected(tally)
    assert tally.cases == CASES
    refused = Counter({topic: sum(n for (t, _, o), n in tally.outcomes.items() if t == topic and o == REFUSED)
                       for topic in TOPICS})  # fmt: skip
    assert min(refused.values()) > 20_000
    for sizes in tally.resident.values():
        assert sizes[-1] < 1.15 * sizes[min(10, len(sizes) - 1)]
