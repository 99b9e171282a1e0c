"""Surface kinds of fragments: which closed form or structure computes the elementary queries."""

PLANE = 0
SPHERE = 1
BOX = 2
TETRAHEDRA = 3
TRIANGLES = 4
