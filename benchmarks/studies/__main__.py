"""`python -m benchmarks.studies NAME`, from the root of the sources: the same as `fracture-collision bench NAME`."""

from fracture_collision.cli.bench import bench

if __name__ == "__main__":
    bench(prog_name="python -m benchmarks.studies")
