"""JSON files that tell whether they are as they were written."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from . import atomic

CHECKSUM = "checksum"

Document = dict[str, Any]


def write_json(file: Path, document: Mapping[str, Any]) -> None:
    """
    Write a document, and its checksum as one more entry; an older file stays until then.

    Raises
    ------
    ValueError
        For a NaN or an infinity, which JSON does not have.
    """
    sealed = {**document, CHECKSUM: _checksum(document)}
    atomic.write_text(file, json.dumps(sealed, indent=1, allow_nan=False) + "\n")


def read_json(file: Path) -> Document:
    """
    Return the document in a file of :func:`write_json`.

    Raises
    ------
    ValueError
        If the file is damaged; the message says which one.
    OSError
        If it cannot be read.
    """
    document = parse(file)
    verify(file, document)
    return document


def parse(file: Path) -> Document:
    """Return the document in a file as it is; errors are those of :func:`read_json`."""
    try:
        document = json.loads(file.read_text(encoding="utf-8"))
    except ValueError as error:  # of JSON or of UTF-8
        raise ValueError(f"{file} is damaged: {error}") from None
    if not isinstance(document, dict):
        raise ValueError(f"{file} is damaged: it holds no document")
    return document


def verify(file: Path, document: Document) -> None:
    """Take the checksum out of a document; a ValueError if it is wrong or missing."""
    if document.pop(CHECKSUM, None) != _checksum(document):
        raise ValueError(f"{file} is damaged: its checksum is wrong")


def _checksum(document: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(document, sort_keys=True).encode()).hexdigest()
