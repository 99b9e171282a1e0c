"""The method of Glondu et al., "Fast Collision Detection for Fracturing Rigid Bodies" (2014), beside our own.

It reads beside the paper: 4.1 and 4.4 interior_field.py, averaged_field.py; 4.2 front_propagation.py; 4.5
paper_probe.py; 5.1 and 6.1 max_distance_order.py, point_hierarchy.py, sphere_tree.py; 5.2 and 5.3 algorithm1.py; 6.2
and 6.3 sphere_tree_deal.py, sphere_tree_split.py; the three variants of 7.3 fragment_trees.py. paper_geometry.py keeps
the data, paper_pairs.py runs all pairs of a step. Spheres and planes are not in the paper: their contacts are those of
our method.
"""
