"""Let one process at a time work in a folder."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from filelock import FileLock, Timeout

# It stays in the folder and is empty; the system knows who holds it.
LOCK = "in_use.lock"


@contextmanager
def only_one(folder: Path) -> Iterator[None]:
    """
    Hold a folder during the block; the block may contain others for the same folder.

    The system frees the folder when the process ends, whatever ends it.

    Raises
    ------
    ValueError
        At once, if another process or thread holds the folder.
    """
    # The one object of this path counts the blocks of a thread. Other threads and processes wait.
    lock = FileLock(folder / LOCK, timeout=0, is_singleton=True)
    try:
        lock.acquire()
    except Timeout:
        raise ValueError(
            f"{folder} is in use by another `mi-ellipse compare` or `report`: wait until it ends,"
            " or name another folder"
        ) from None
    try:
        yield
    finally:
        lock.release()
