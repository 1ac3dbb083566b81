"""Names of plugins in scene files: those of this package, and those that it takes over."""

ELLIPSE = "ellipse"
ELLIPSOID = "ellipsoid"
ELLIPTICAL_AREA = "ellipticalarea"

DISK = "disk"
SPHERE = "sphere"
AREA = "area"
