"""The choice of one lamp among several, from what each gives to a point."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import drjit as dr
import mitsuba as mi

from ..geometry.tracing import take
from .estimate import Outlines

# Part of the choice that is the same for all lamps of a leaf. It bounds what a low estimate costs:
# with n lamps the weight of a sample is at most 50 n times what it is without a choice.
EQUAL_SHARE = 0.02

# Largest random number below 1 in single precision.
LAST = 1 - 2**-24


class Choice(NamedTuple):
    """A lamp, how likely it was, and what is left of the random number."""

    slot: mi.UInt32
    probability: mi.Float
    u: mi.Float  # Uniform in [0, 1) again


@dataclass
class Members:
    """The lamps of a group, an element a slot; a slot of no power is empty."""

    power: mi.Float  # Sampling weight times mean radiance
    outlines: Outlines


def choose(
    members: Members, first: mi.UInt32, count: int, it: mi.Interaction3f, u: mi.Float
) -> Choice:
    """Choose among `count` slots from `first` on, in proportion to what each gives to a point.

    Parameters
    ----------
    members
        The lamps.
    first, count
        The slots.
    it
        The point and the normal of its surface.
    u
        A random number in [0, 1).
    """
    place, chosen, u = pick(_shares(members, first, count, it), u)
    return Choice(first + place, chosen, u)


def pick(probabilities: list[mi.Float], u: mi.Float) -> tuple[mi.UInt32, mi.Float, mi.Float]:
    """Place in a list of probabilities, its probability, and what is left of a random number."""
    place, start, end = mi.UInt32(0), mi.Float(0), mi.Float(0)
    chosen = probabilities[0]
    for k in range(1, len(probabilities)):
        end = end + probabilities[k - 1]
        # A place without probability has no draws, whatever the sum is rounded to.
        past = (u >= end) & (probabilities[k] > 0)
        place = dr.select(past, mi.UInt32(k), place)
        start = dr.select(past, end, start)
        chosen = dr.select(past, probabilities[k], chosen)
    return place, chosen, rescaled(u, start, chosen)


def probability(
    members: Members, first: mi.UInt32, count: int, it: mi.Interaction3f, slot: mi.UInt32
) -> mi.Float:
    """Probability with which `choose` takes a slot."""
    return entry_of(_shares(members, first, count, it), slot - first)


def entry_of(probabilities: list[mi.Float], place: mi.UInt32) -> mi.Float:
    """The probability at a place of a list."""
    chosen = probabilities[0]
    for k in range(1, len(probabilities)):
        chosen = dr.select(place == k, probabilities[k], chosen)
    return chosen


def rescaled(u: mi.Float, start: mi.Float, width: mi.Float) -> mi.Float:
    """Place of a random number between `start` and `start + width`, in [0, 1); 0 without width."""
    some = width > 0
    return dr.select(some, dr.clip((u - start) / dr.select(some, width, 1), 0, LAST), 0)


def _shares(members: Members, first: mi.UInt32, count: int, it: mi.Interaction3f) -> list[mi.Float]:
    """Probability of each slot."""
    slots = [first + mi.UInt32(k) for k in range(count)]
    powers = [take(mi.Float, members.power, slot) for slot in slots]
    gains = [
        power * members.outlines.irradiance(slot, it.p, it.n)
        for power, slot in zip(powers, slots, strict=True)
    ]
    total = sum(gains[1:], gains[0])
    some = (total > 0) & (total < dr.inf)
    inverse = (1 - EQUAL_SHARE) * dr.select(some, dr.rcp(dr.select(some, total, 1)), 0)
    occupied = [dr.select(power > 0, mi.Float(1), 0) for power in powers]
    # Without any light all occupied slots are alike.
    equal = dr.select(some, EQUAL_SHARE, 1) / dr.maximum(sum(occupied[1:], occupied[0]), 1)
    return [
        dr.fma(dr.select(some, gain, 0), inverse, equal * there)
        for gain, there in zip(gains, occupied, strict=True)
    ]
