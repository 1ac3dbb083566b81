"""Read each picture of a comparison once, and keep those that are looked at again."""

from __future__ import annotations

from pathlib import Path

from ..files import images
from ..files.images import Image

# Bytes of pictures that may be looked at again; later ones are read a second time.
LIMIT = 2**30


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

    def look(self, file: Path) -> Image:
        """Return a picture that will not be asked for again; errors are those of :meth:`read`."""
        return self._pictures.pop(file) if file in self._pictures else images.read_exr(file)

    def keep(self, file: Path, image: Image) -> None:
        """Take what a file holds, for those who ask later."""
        image.flags.writeable = False  # All of them see the same memory.
        self._pictures[file] = image

    def keep_if_small(self, file: Path, image: Image) -> None:
        """Take what a file holds if there is room."""
        if sum(one.nbytes for one in self._pictures.values()) + image.nbytes <= LIMIT:
            self.keep(file, image)
