from fracture_collision.extras import need

need("bags", "fracture_collision.bag")
