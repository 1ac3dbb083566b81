"""Draw the figures of a comparison."""

from ..figures import write_figures

__all__ = ["write_figures"]
