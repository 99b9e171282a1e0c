"""Memory that a process pre-faults before it is needed; each case runs in its own process."""

from __future__ import annotations

import json
import platform
import subprocess
import sys

import pytest

COUNT_FAULTS = """
import json, resource, sys
import numpy as np
from fracture_collision.process.kept_memory import keep_memory
size = int(sys.argv[1])
done = keep_memory(size) if size else None
def faults():
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt
counts = []
for _ in range(3):
    before = faults()
    arrays = [np.ones(1 << 17) for _ in range(8)]  # 8 MiB in all, of pages of 4 KiB: 2048
    counts.append(faults() - before)
    del arrays
print(json.dumps([done, counts]))
"""


def count_faults(size):
    done = subprocess.run(
        [sys.executable, "-c", COUNT_FAULTS, str(size)], check=True, capture_output=True, text=True, timeout=60
    )
    return json.loads(done.stdout)


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="glibc's malloc")
def test_new_arrays_reuse_pages_that_were_kept():
    _, fetched = count_faults(0)
    done, kept = count_faults(16 << 20)
    assert done
    assert 10 * max(kept) < fetched[0]
