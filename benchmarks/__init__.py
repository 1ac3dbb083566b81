"""Measurements of the strategies, the renders and their first frames."""

import mi_ellipse  # noqa: F401  before mitsuba: it chooses the LLVM
