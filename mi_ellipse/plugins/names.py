"""Names in scene files: plugins of this package, those that it takes over, and parameters."""

ELLIPSE = "ellipse"
ELLIPSOID = "ellipsoid"
ELLIPTICAL_AREA = "ellipticalarea"

DISK = "disk"
SPHERE = "sphere"
AREA = "area"

# How bright an `ellipticalarea` is: one of them
RADIANCE = "radiance"
POWER = "power"
