"""The same course and the same answers, bit for bit, on any x86-64 processor.

Other processors are emulated by the variables that select a library's code path: OpenBLAS's kernels, numpy's
dispatch, glibc's variants of sin, exp and others. numba's code generation for another processor is a slow test, as
it recompiles every kernel.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from scene_courses import PINNED

PROGRAM = Path(__file__).with_name("scene_courses.py")
EXPECTED = yaml.safe_load(PINNED.read_text())
# Shards, flat and curved cracks, thin walls: these diverged while BLAS and libm kernels were in use.
SOME = ["plates", "piggy_bank", "pane@0.25"]
SHORT = ["pane@0.25"]
# A run of these takes more than ten seconds; the digests of others of their kind are compared each time.
LONG = {"plates@0", "wall", "bricks", "bricks@0.25", "bunnies", "drop_bunnies", "reference_sphere", "piggy_bank"}
ENVIRONMENTS = {
    "as it is": {},
    "OpenBLAS for Haswell": {"OPENBLAS_CORETYPE": "Haswell"},
    "OpenBLAS for SkylakeX": {"OPENBLAS_CORETYPE": "SkylakeX"},
    "OpenBLAS for Zen": {"OPENBLAS_CORETYPE": "Zen"},
    "OpenBLAS for Prescott": {"OPENBLAS_CORETYPE": "Prescott"},
    # numpy 2.4 and later names groups of features; older versions take single ones and warn of unknown ones
    "numpy's baseline": {"NPY_DISABLE_CPU_FEATURES": "X86_V3 X86_V4 AVX2 FMA3 AVX512F AVX512_SKX"},
    "glibc without FMA": {"GLIBC_TUNABLES": "glibc.cpu.hwcaps=-FMA,-FMA4,-AVX2,-AVX2_Usable,-FMA_Usable"},
}
FOR_SOME = {
    "an older processor": ("OpenBLAS for Haswell",),
    "a newer processor": ("OpenBLAS for SkylakeX",),
    "an old processor": ("OpenBLAS for Prescott", "numpy's baseline", "glibc without FMA"),
}


def course(names, environment):
    done = subprocess.run(
        [sys.executable, "-W", "ignore", PROGRAM, *names], env=os.environ | environment, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    return dict(line.split() for line in done.stdout.splitlines() if len(line.split()) == 2)


def expected(names):
    return {name: EXPECTED[name] for name in names}


@pytest.mark.parametrize(
    "names", [EXPECTED.keys() - LONG, pytest.param(LONG, marks=pytest.mark.slow)], ids=["short", "long"]
)
def test_scenes_have_their_pinned_digests(names):
    assert course(sorted(names), {}) == expected(names)


@pytest.mark.parametrize(
    ("processor", "names"),
    [("an old processor", SHORT), *(pytest.param(kind, SOME, marks=pytest.mark.slow) for kind in FOR_SOME)],
)
def test_digests_are_the_same_on_other_processors(processor, names):
    together = {name: value for kind in FOR_SOME[processor] for name, value in ENVIRONMENTS[kind].items()}
    assert course(names, together) == expected(names)


@pytest.mark.slow
@pytest.mark.parametrize("kind", list(ENVIRONMENTS)[1:])
def test_digests_of_all_scenes_are_the_same_in_other_environments(kind):
    assert course(EXPECTED, ENVIRONMENTS[kind]) == EXPECTED


@pytest.mark.slow
def test_digests_are_the_same_with_kernels_for_any_processor(tmp_path):
    generic = {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": "", "NUMBA_CACHE_DIR": str(tmp_path)}
    assert course(EXPECTED, generic) == EXPECTED


def test_the_environments_change_the_rounding_of_libraries():
    """The comparison can fail: BLAS, numpy and libm do round differently here, if the processor offers a choice."""
    program = (
        "import hashlib, math, numpy as np; r = np.random.default_rng(1); a = r.normal(size=(300, 300));"
        "x = r.uniform(0, 9, 20000); d = lambda v: hashlib.sha256(np.asarray(v).tobytes()).hexdigest();"
        "print(d(a @ a), d(np.exp(x)), d([math.sin(v) for v in x]))"
    )

    def rounding(kind):
        environment = os.environ | ENVIRONMENTS[kind]
        done = subprocess.run([sys.executable, "-W", "ignore", "-c", program], env=environment, capture_output=True)
        assert done.returncode == 0, done.stderr
        return done.stdout.decode().split()

    features = Path("/proc/cpuinfo").read_text().split("flags", 1)[1].split("\n", 1)[0].split()
    if "avx2" not in features or "fma" not in features:
        pytest.skip("this processor leaves the libraries no choice")
    of_blas = {rounding(kind)[0] for kind in ENVIRONMENTS if "OpenBLAS" in kind}
    assert len(of_blas) > 1
    assert rounding("as it is")[1] != rounding("numpy's baseline")[1] or "avx512f" not in features
    assert rounding("as it is")[2] != rounding("glibc without FMA")[2]
