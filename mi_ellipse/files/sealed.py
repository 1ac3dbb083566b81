"""JSON files that tell whether they are as they were written."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

from . import atomic


def write_json(file: Path, content: Any) -> None:
    """Write a document with a checksum; an older file stays until then."""
    document = {"content": content, "checksum": _checksum(content)}
    atomic.write_text(file, json.dumps(document, indent=1) + "\n")


def read_json(file: Path) -> Any:
    """
    Return the document in a file of :func:`write_json`.

    Raises
    ------
    ValueError
        If the file is damaged; the message says which one.
    OSError
        If it cannot be read.
    """
    try:
        document = json.loads(file.read_text(encoding="utf-8"))
        content, checksum = document["content"], document["checksum"]
    except (ValueError, KeyError, TypeError):  # of which the first covers JSON and UTF-8
        raise ValueError(f"{file} is damaged: it is no whole file of this package") from None
    if checksum != _checksum(content):
        raise ValueError(f"{file} is damaged: its checksum is wrong")
    return content


def _checksum(content: Any) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()
