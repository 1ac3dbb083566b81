"""Compare sampling strategies in a scene: pictures, errors, times, figures and a report."""

try:  # at once, not after hours of rendering
    import flip_evaluator  # noqa: F401
    import jinja2  # noqa: F401
    import scipy  # noqa: F401
    import simpleimageio  # noqa: F401
except ImportError as error:
    raise ImportError(
        f"comparisons need the package {error.name}: pip install 'mi_ellipse[study]'"
    ) from None

from .results import Comparison
from .run import compare

__all__ = ["Comparison", "compare"]
