"""Replace files whole: whatever happens, a path holds the old file or the new one."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from os import PathLike
from pathlib import Path


@contextmanager
def replacement(path: str | PathLike[str]) -> Iterator[Path]:
    """
    Give a temporary path in the folder of `path`, and move it there if all goes well.

    Within one folder the move is atomic. The temporary file is removed after an error.
    """
    path = Path(path).resolve()
    temporary = path.with_name(f".{path.stem}.{os.getpid()}{path.suffix}")
    try:
        yield temporary
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def write_text(path: str | PathLike[str], text: str) -> None:
    """Write a text in UTF-8, with its line ends as they are; an older file stays until then."""
    write_bytes(path, text.encode())


def write_bytes(path: str | PathLike[str], data: bytes | memoryview) -> None:
    """Write a whole file; an older one stays until then."""
    with replacement(path) as temporary:
        temporary.write_bytes(data)


def check_writable(path: str | PathLike[str]) -> None:
    """Raise an OSError unless a file can be written at `path`; leave what is there alone."""
    path = Path(path)
    if path.is_dir():
        raise IsADirectoryError(f"{path} is a folder")
    if not path.parent.is_dir():
        raise FileNotFoundError(f"the folder {path.parent} does not exist")
    with tempfile.TemporaryFile(dir=path.parent):
        pass
