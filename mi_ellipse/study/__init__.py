"""Compare sampling strategies in a scene: pictures, errors, times, figures and a report."""

from .compare import compare
from .results import Comparison

__all__ = ["Comparison", "compare"]
