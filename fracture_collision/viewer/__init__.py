from fracture_collision.extras import need

need("viewer", "fracture_collision.viewer")
