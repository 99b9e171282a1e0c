"""A picture that was written to a file. For tests."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.image import imread


def colours_of(file: Path) -> int:
    """How many different colours it has; a blank picture has few."""
    pixels = np.round(255.0 * imread(file)[..., :3]).astype(np.uint32)
    assert min(pixels.shape[:2]) > 100
    return len(np.unique(pixels @ np.array([1 << 16, 1 << 8, 1], np.uint32)))
