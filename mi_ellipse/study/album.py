"""Read each picture of a comparison once, and keep those that are looked at again."""

from __future__ import annotations

from pathlib import Path

from ..files import images
from ..files.images import Image


class Album:
    """Pictures by their files; the memory that they take is freed with the album."""

    def __init__(self) -> None:
        self._pictures: dict[Path, Image] = {}

    def read(self, file: Path) -> Image:
        """Return a picture as (height, width, channels), read the first time that it is asked for.

        Errors are those of :func:`mi_ellipse.files.images.read_exr`.
        """
        if file not in self._pictures:
            self.keep(file, images.read_exr(file))
        return self._pictures[file]

    def keep(self, file: Path, image: Image) -> None:
        """Take what a file holds, for those who ask later."""
        image.flags.writeable = False  # All of them see the same memory.
        self._pictures[file] = image
