"""A process that gets a signal while its kernels load. For tests."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Mapping

# While numba passes the third kernel to LLVM: an exception there is swallowed and the kernel's address is null.
SIGNAL_WHILE_LOADING = """
import os, signal, sys
from numba.core.codegen import CPUCodeLibrary
hand_over = CPUCodeLibrary._object_getbuffer_hook
kernels = []
def interrupted(module):
    kernels.append(module)
    if len(kernels) == 3:
        os.kill(os.getpid(), {order})
    return hand_over(module)
CPUCodeLibrary._object_getbuffer_hook = interrupted
"""


def run_code(
    *lines: str, order: signal.Signals = signal.SIGINT, environment: Mapping[str, str] | None = None
) -> subprocess.CompletedProcess[str]:
    code = SIGNAL_WHILE_LOADING.format(order=int(order)) + "\n".join(lines)
    return subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=280.0, env=environment
    )
