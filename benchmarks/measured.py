"""Numbers out of `docs/data` with their 95 % intervals, and whether they keep a limit."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from functools import reduce
from operator import getitem

from .text import data, number

NORMAL = 1.96  # Standard errors from the mean to either end of a 95 % interval


@dataclass(frozen=True)
class Measured:
    """A value, and its 95 % interval where the data have one."""

    value: float
    low: float | None = None
    high: float | None = None

    @property
    def ends(self) -> tuple[float, float]:
        """The interval; the value itself at both ends where there is none."""
        if self.low is None or self.high is None:
            return self.value, self.value
        return self.low, self.high

    def __str__(self) -> str:
        digits = 4 if self.value < 2 else 3
        text = number(self.value, digits)
        if self.low is None:
            return text
        return f"{text} [{', '.join(number(end, digits) for end in self.ends)}]"


def at(name: str, *place: str) -> Measured:
    """A number or a ratio with its interval, in `docs/data/NAME.json`."""
    found = reduce(getitem, place, data(name))
    if isinstance(found, dict):
        return Measured(found["median"], found["low"], found["high"])
    return Measured(float(found))


def around(value: float, standard_error: float) -> Measured:
    """A mean with its standard error."""
    return Measured(value, value - NORMAL * standard_error, value + NORMAL * standard_error)


def quotient(over: Measured, under: Measured) -> Measured:
    """One over the other. Their errors are independent, so the logarithms add as squares."""
    value = over.value / under.value
    if over.low is None and under.low is None:
        return Measured(value)
    fall = math.hypot(_reach(over.ends[0], over.value), _reach(under.value, under.ends[1]))
    rise = math.hypot(_reach(over.value, over.ends[1]), _reach(under.ends[0], under.value))
    return Measured(value, value * math.exp(-fall), value * math.exp(rise))


def _reach(low: float, high: float) -> float:
    """Logarithm of the ratio; infinite where an interval reaches zero."""
    return math.log(high / low) if low > 0 else math.inf


class Verdict(Enum):
    """Whether a limit holds."""

    HOLDS = "yes"
    WITHIN = "within the error"
    MISSED = "**no**"


@dataclass(frozen=True)
class Limit:
    """A limit that was set, and where its measured value is.

    Parameters
    ----------
    subject
        Heading of the table that it belongs to.
    what
        What is limited.
    most
        Whether the bound is the most that is allowed, and not the least.
    bound
        The limit.
    measure
        Reads the value from `docs/data`.
    reason
        Why it costs or gains no better, in sentences that do not depend on the value.
    """

    subject: str
    what: str
    most: bool
    bound: float
    measure: Callable[[], Measured]
    reason: str

    @property
    def asked(self) -> str:
        """The limit in words."""
        return self.say(self.bound)

    def say(self, bound: float) -> str:
        """A bound of this kind in words."""
        return f"at {'most' if self.most else 'least'} {bound:g}"

    def verdict(self, measured: Measured) -> Verdict:
        """Whether a value keeps the limit: wholly, with a part of its interval, or not."""
        low, high = measured.ends
        best, worst = (low, high) if self.most else (-high, -low)
        bound = self.bound if self.most else -self.bound
        if worst <= bound:
            return Verdict.HOLDS
        return Verdict.WITHIN if best <= bound else Verdict.MISSED

    def bound_that_holds(self, measured: Measured) -> float:
        """The worse end of the interval, rounded away from the limit to three digits."""
        low, high = measured.ends
        end, away = (high, math.ceil) if self.most else (low, math.floor)
        digits = 2 - math.floor(math.log10(abs(end))) if end else 2
        return round(away(round(end * 10**digits, 6)) / 10**digits, max(digits, 0))
