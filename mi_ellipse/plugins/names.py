"""Names of plugins in scene files: those of this package, and those that it takes over."""

ELLIPSE = "ellipse"
ELLIPTICAL_AREA = "ellipticalarea"

DISK = "disk"
AREA = "area"
