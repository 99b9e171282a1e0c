"""Cached kernels load without the compiler's modules, and compiling other code besides or with them still works."""

from __future__ import annotations

from pathlib import Path

from own_process import said

LOAD_THEN_COMPILE = """
import json, sys
import numpy as np
from fracture_collision.core.mesh.connected_pieces import _joined, joined
from numba import njit

def for_compiling():
    return sorted({"numba.np.random.generator_methods"} & sys.modules.keys())

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
print(json.dumps([announced, "numba" in sys.modules]))
"""


def test_cached_kernels_load_without_preparing_to_compile() -> None:
    said(LOAD_THEN_COMPILE)  # fills the cache if necessary
    assert said(LOAD_THEN_COMPILE) == {
        "pieces": [0, 1, 0, 2, 2, 3], "hits": 1, "imported for compiling": [], "ring": 1, "compiled": True,
    }  # fmt: skip


def test_a_service_announces_itself_before_numba() -> None:
    assert said(START) == [[], True]


FROM_KERNELS = """
import json
import numpy as np
from fracture_collision.core.memory.callees import is_callee
from kernels_for_the_cache import outer, middle, inner, allocating
from numba import njit
first = outer(np.arange(6.0))
callees = [name.py_func.__name__ for name in (inner, allocating) if all(map(is_callee, name.overloads.values()))]
hits = sum(outer.stats.cache_hits.values())

@njit
def of_the_user(values):
    return middle(values, 3.0) + outer(values)

print(json.dumps([first, callees, hits, float(inner(np.arange(3.0), 2.0)), of_the_user(np.arange(6.0))]))
"""

KERNELS = """
import numpy as np
from fracture_collision.core.memory.compiled import kernel, query_kernel

@query_kernel
def twice(x):
    return 2.0 * x

@kernel
def allocating(values):
    return np.sort(np.concatenate((values, values[::-1] + 0.5)))[: len(values)].reshape(2, -1)

@kernel
def inner(values, x):
    if x < 0.0:
        raise ValueError("negative")
    total = 0.0
    for value in values:
        total += twice(value) * x
    return total

@query_kernel
def middle(values, x):
    return inner(values, x) + 1.0

@kernel
def outer(values):
    return middle(values, 1.0) + allocating(values)[1, 2]
"""


def test_callees_are_linked_into_what_python_calls(tmp_path: Path) -> None:
    """Compiled here, then loaded by another process, which has nothing else compiled that it might be linked with.

    A function of the user calls them, too.
    """
    (tmp_path / "kernels_for_the_cache.py").write_text(KERNELS)
    for hits, callees in ((0, ["inner", "allocating"]), (1, ["inner", "allocating"])):
        assert said(FROM_KERNELS, tmp_path) == [33.5, callees, hits, 12.0, 91.0 + 33.5]
