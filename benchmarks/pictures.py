"""Figures of pictures beside each other, with regions that are enlarged."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.patches import Rectangle
from mi_ellipse.files.images import to_srgb

WIDTH = 2.2  # of a picture, in inches


def draw(
    path: Path,
    pictures: Mapping[str, np.ndarray],
    insets: Mapping[str, tuple[int, int, int, int]],
    exposure: float = 0,
) -> None:
    """Write a figure.

    Parameters
    ----------
    path
        File to write.
    pictures
        Linear RGB pictures of one size by their titles.
    insets
        Regions by the colour of their frame: column, row, width and height in pixels.
    exposure
        Stops by which the pictures are brightened.
    """
    height, width = next(iter(pictures.values())).shape[:2]
    size = WIDTH * len(pictures), (1 + len(insets)) * WIDTH * height / width + 0.3
    with mpl.rc_context({"font.size": 8}):
        figure, axes = plt.subplots(
            1 + len(insets), len(pictures), figsize=size, layout="constrained", squeeze=False
        )
        for column, (title, linear) in zip(axes.T, pictures.items(), strict=True):
            picture = to_srgb(linear * 2**exposure)
            column[0].imshow(picture)
            column[0].set_title(title)
            for panel, (colour, (x, y, w, h)) in zip(column[1:], insets.items(), strict=True):
                column[0].add_patch(Rectangle((x, y), w, h, fill=False, edgecolor=colour))
                panel.imshow(picture[y : y + h, x : x + w])
                panel.spines[:].set_color(colour)
            for panel in column:
                panel.set(xticks=[], yticks=[])
        figure.savefig(path, dpi=130)
        plt.close(figure)
