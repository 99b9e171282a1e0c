"""`python -m fracture_collision.cli`: the command line without an installed `fracture-collision`."""

from fracture_collision.cli import main

if __name__ == "__main__":
    main()
