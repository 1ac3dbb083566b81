"""What a light looks like from a point: ellipse, cone, irradiance, mesh."""
