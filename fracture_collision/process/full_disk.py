"""A disk without space: a state of the machine, which a user understands without a traceback."""

from __future__ import annotations

import errno
import os

STATUS = os.EX_IOERR  # of a node that could not write
REMEDY = "free some space, or write to another disk"
_REASONS = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


def full_disk_words(error: OSError) -> str:
    """What is wrong and what to do; "" if `error` has another reason."""
    return f"{error.strerror}; {REMEDY}" if error.errno in _REASONS else ""
