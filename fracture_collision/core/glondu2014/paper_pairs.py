"""All pairs of a step by Algorithm 1, each from its roots: nothing is kept from one step to the next."""

from __future__ import annotations

import numpy as np

from fracture_collision.core.contacts.contact_choice import Rule
from fracture_collision.core.glondu2014.algorithm1 import algorithm1
from fracture_collision.core.glondu2014.paper_pools import PaperPools
from fracture_collision.core.memory.compiled import threaded_kernel
from fracture_collision.core.memory.crew import Crew
from fracture_collision.core.memory.pair import Step, put_pair
from fracture_collision.core.memory.pools import Pools
from fracture_collision.core.search.kept_answer import PairContacts
from fracture_collision.core.search.passes import NO_ROOM, Found, Passes, keep_found, room_of
from fracture_collision.core.search.scratch import Scratch
from fracture_collision.core.search.work_limit import BY_LIMIT, COMPLETE, LEAST
from fracture_collision.grouping import begins_of

# Tree nodes that a search may visit for each sample that its share allows: inner nodes and rejected ones count, too.
VISITS_EACH = 4


def query_by_paper(
    pools: Pools, paper: PaperPools, step: Step, rule: Rule, within: np.ndarray, own: tuple[tuple[Scratch, ...], Crew]
) -> PairContacts:
    """Contacts of all pairs of a Step, by a Rule with epsilon and near as shares of the smaller R of the two.

    within (p,): of share_work; own: a Scratch for each thread of the Crew. With rule.every > 1 a search ends after a
    share of its visits.
    """
    search = Passes(step, *own)
    counts, bounds, visits, exhausted, *_ = search.columns
    budgets = np.zeros(len(step.pairs), np.int64)
    if rule.every > 1:
        budgets = VISITS_EACH * np.maximum(within // rule.every, LEAST)
    todo, again = np.arange(len(step.pairs)), False
    while len(todo):
        out = search.new(todo, again)
        search.run(_query_share, pools, paper, step, rule, (todo, budgets), out)
        todo, again = todo[out.begin[todo] == NO_ROOM], True
    return PairContacts(counts, bounds, visits, exhausted, *search.gather(begins_of(counts)))


@threaded_kernel
def _query_share(pools, paper, step, rule, work, out, scratch, part):
    """Process every pair that is a thread's, see Crew.share.

    work: the pairs (m,), and the visits that each may take (p,), 0: any number.
    """
    (todo, budgets), (thread, threads) = work, part
    for k in range(thread, len(todo), threads):
        p = todo[k]
        pair = put_pair(step, p, scratch.rotation, scratch.translation)
        radius = min(pools.fragment.radius[pair.a], pools.fragment.radius[pair.b])
        its = Rule(rule.wanted, rule.most, rule.epsilon * radius, rule.near * radius, rule.every)
        count, bound, visits, is_cut = algorithm1(
            pools, paper, pair, its, budgets[p], room_of(out, thread), scratch
        )
        keep_found(out, p, thread, Found(count, bound, visits, BY_LIMIT if is_cut else COMPLETE, 0.0))
