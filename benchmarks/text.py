"""What the pages are made of: measured data, numbers and tables."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from functools import cache
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent


@cache
def data(name: str) -> Any:
    """What a benchmark measured."""
    document = json.loads((ROOT / "docs" / "data" / f"{name}.json").read_text(encoding="utf-8"))
    return document.get(name, document)


def number(value: float, digits: int = 2) -> str:
    """Some significant digits, without an exponent up to a million."""
    if value == 0:
        return "0"
    rounded = float(f"{value:.{digits}g}")
    if abs(rounded) >= 1e6 or abs(rounded) < 1e-5:
        mantissa, exponent = f"{rounded:.{digits - 1}e}".split("e")
        return f"{mantissa.rstrip('0').rstrip('.')}e{int(exponent)}"
    if abs(rounded) >= 10 ** (digits - 1):
        return f"{rounded:.0f}"
    text = f"{rounded:#.{digits}g}"
    return f"{rounded:.7f}".rstrip("0") if "e" in text else text


def span(values: Iterable[float], form: str = "{:.2f}") -> str:
    """Least and largest of some numbers."""
    values = list(values)
    return f"{form.format(min(values))} to {form.format(max(values))}"


def table(head: str, rows: Sequence[Sequence[object]]) -> str:
    """A Markdown table; the names of its columns are separated by ``|``."""
    columns = head.split(" | ")
    lines = [columns, ["---"] * len(columns), *rows]
    return "\n".join("| " + " | ".join(map(str, line)) + " |" for line in lines) + "\n"
