"""Slow truths that the fast paths are tested against: plain numpy, brute force, small meshes."""
