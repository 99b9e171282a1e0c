"""Cached kernels load without the compiler's modules, and compiling other code besides or with them still works."""

from __future__ import annotations

import json
import subprocess
import sys

LOAD_THEN_COMPILE = """
import json, sys
import numpy as np
from fracture_collision.core.mesh.connected_pieces import _joined, joined
from numba import njit

def for_compiling():
    return sorted({"numba.np.random.generator_methods", "scipy", "coverage"} & sys.modules.keys())

pieces = joined(np.array([0, 3]), np.array([2, 4]), 6).tolist()
told = {"pieces": pieces, "hits": sum(_joined.stats.cache_hits.values()), "imported for compiling": for_compiling()}

@njit
def pieces_of_a_ring(count):
    nodes = np.arange(count)
    return _joined(nodes, np.append(nodes[1:], 0), count).max() + 1

print(json.dumps(told | {"ring": int(pieces_of_a_ring(7)), "compiled": for_compiling() != []}))
"""

START = """
import json, sys
import fracture_collision.ros.service.collision_node
from fracture_collision.world import warm_up
announced = sorted({"numba", "scipy"} & sys.modules.keys())
warm_up.compile_kernels(lambda what: None)
print(json.dumps([announced, sorted({"numba", "scipy", "coverage"} & sys.modules.keys())]))
"""


def said(script: str) -> object:
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=240)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_cached_kernels_load_without_preparing_to_compile() -> None:
    said(LOAD_THEN_COMPILE)  # fills the cache if necessary
    assert said(LOAD_THEN_COMPILE) == {
        "pieces": [0, 1, 0, 2, 2, 3], "hits": 1, "imported for compiling": [], "ring": 1, "compiled": True,
    }  # fmt: skip


def test_a_service_announces_itself_before_numba_and_never_needs_scipy() -> None:
    assert said(START) == [[], ["numba"]]
