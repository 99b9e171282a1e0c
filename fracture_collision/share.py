"""Location of the package's config/ and launch/: beside the sources, or in share/ of the installation prefix."""

from __future__ import annotations

from pathlib import Path


def share_directory() -> Path:
    """The folder that holds config/ and launch/, whether run from a source tree or installed by pip or colcon.

    Raises FileNotFoundError if the package was copied without them.
    """
    package = Path(__file__).resolve().parent
    if (package.parent / "package.xml").is_file():
        return package.parent
    for prefix in package.parents:
        share = prefix / "share" / "fracture_collision"
        if (share / "config").is_dir():
            return share
    raise FileNotFoundError(f"no share/fracture_collision in any folder above {package}")
