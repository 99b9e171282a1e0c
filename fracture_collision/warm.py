"""Compiles all kernels into numba's cache: `python -m fracture_collision.warm` (part of `make build`)."""

from __future__ import annotations

from fracture_collision.world.warm_up import compile_kernels


def main() -> None:
    compile_kernels(progress=print)


if __name__ == "__main__":
    main()
