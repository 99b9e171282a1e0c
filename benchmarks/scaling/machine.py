"""The machine's limits: time of a load, a floating-point operation, a mispredicted branch; a second core."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from time import perf_counter
from typing import NamedTuple

import numpy as np

from fracture_collision.core.memory.compiled import threaded_kernel

LINE = 64  # [bytes] of a cache line
WORDS = LINE // 8
LOADS = 200_000  # at least
FLOPS = 1_000_000
CHAINS = 8  # of independent operations
SHARED_FLOPS = 100_000_000
TRIALS = 7  # the best of which counts: the machine's limit without interference


class Machine(NamedTuple):
    """Nanoseconds each, one thread."""

    footprint: int  # [bytes] that loads were spread over
    load_latency: float  # of a cache line whose address depends on the previous load
    load: float  # of a cache line at a random address known in advance
    flop_latency: float  # of an addition whose operand is the previous result
    flop: float  # of an addition among CHAINS independent ones
    wrong_guess: float  # extra time of a branch that goes either way, over one that always goes the same way


def measure_machine(footprint: int, seed: int = 1) -> Machine:
    """Loads go to random cache lines of an array of `footprint` [bytes]."""
    random = np.random.default_rng(seed)
    lines = max(footprint // LINE, CHAINS)
    follow = np.zeros((lines, WORDS), dtype=np.int64)
    order = random.permutation(lines)
    follow[order, 0] = np.roll(order, -1)  # one cycle through all cache lines
    loads = max(lines, LOADS)
    where = random.integers(0, lines, loads)
    either = random.integers(0, 2, LOADS)
    counts = np.zeros(WORDS)
    return Machine(
        footprint,
        _nanoseconds(_chase, loads, follow, loads),
        _nanoseconds(_gather, loads, follow, where),
        _nanoseconds(_dependent_sum, FLOPS, 1e-9, FLOPS),
        _nanoseconds(_independent_sums, FLOPS, 1e-9, FLOPS // CHAINS),
        # half of the predictions are wrong
        2.0 * (_nanoseconds(_branch, LOADS, either, counts) - _nanoseconds(_branch, LOADS, np.sort(either), counts)),
    )


def second_core() -> float:
    """Throughput of two threads over that of one, additions only: 2 if a second core is idle."""
    with ThreadPoolExecutor(1) as pool:
        pool.submit(_dependent_sum, 1e-9, 1).result()
        began = perf_counter()
        other = pool.submit(_dependent_sum, 1e-9, SHARED_FLOPS)
        _dependent_sum(1e-9, SHARED_FLOPS)
        other.result()
        together = perf_counter() - began
    began = perf_counter()
    _dependent_sum(1e-9, SHARED_FLOPS)
    return 2.0 * (perf_counter() - began) / together


def _nanoseconds(kernel, count: int, *arguments) -> float:
    """Per item, of `count`."""
    kernel(*arguments)
    times = []
    for _ in range(TRIALS):
        began = perf_counter()
        kernel(*arguments)
        times.append(perf_counter() - began)
    return 1e9 * min(times) / count


@threaded_kernel
def _chase(follow, count):
    at = 0
    for _ in range(count):
        at = follow[at, 0]
    return float(at)


@threaded_kernel
def _gather(lines, where):
    total = 0
    for i in range(len(where)):
        total += lines[where[i], 0]
    return float(total)


@threaded_kernel
def _dependent_sum(term, count):
    total = 0.0
    for _ in range(count):
        total += term
    return total


@threaded_kernel
def _independent_sums(term, rounds):
    a, b, c, d, e, f, g, h = 0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0
    for _ in range(rounds):
        a, b, c, d, e, f, g, h = a + term, b + term, c + term, d + term, e + term, f + term, g + term, h + term
    return a + b + c + d + e + f + g + h


@threaded_kernel
def _branch(either, counts):
    """A store on one side, so that the compiler cannot use a conditional move."""
    for i in range(len(either)):
        if either[i] == 1:
            counts[i % WORDS] += 1.0
    return counts[0]
