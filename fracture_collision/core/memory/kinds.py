"""What a fragment's surface is made of: which closed form or structure answers its elementary queries."""

PLANE = 0
SPHERE = 1
BOX = 2
TETRAHEDRA = 3
TRIANGLES = 4
