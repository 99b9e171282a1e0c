from fracture_collision.extras import need

need("cli", "fracture_collision.simulation")
