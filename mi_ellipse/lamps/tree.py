"""A balanced tree over many lamps, whose leaves choose by exact estimates.

As in A. Conty Estevez and C. Kulla, *Importance Sampling of Many Lights with Adaptive Tree
Splitting* (HPG 2018), the importance of a node comes from power, distance, orientation and the
surface. It takes means over the lamps where they take bounds. Bounds are 1 as soon as a node is
close and its normals differ, so they tell near nodes nothing about each other.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..geometry.tracing import table, take
from . import choice
from .choice import Choice, Members
from .estimate import FAR_SIDE
from .records import Shapes

LEAF = 2  # slots of a leaf

# Levels that a step down the tree descends: it chooses among eight nodes. Nodes far below tell more
# about what is near a point than two halves of the lamps do, and eight at once take little longer
# than three times two. Every lamp has the code of a step, so more nodes would take longer to trace.
LEVELS = 3

# The mean of a cosine, clipped at zero, over a node: ``(m + √(m² + SOFTNESS v)) / 2`` for the mean
# m and the variance v of the cosine. At m = 0 it is that of a normal distribution, √(v / 2π).
SOFTNESS = 2 / np.pi

# Part of the choice among nodes that follows their power alone. A node whose importance is
# too low then costs variance and no fireflies.
POWER_SHARE = 0.01


@dataclass
class Tree:
    """Nodes in the order of their levels, without the root: a node has its sibling beside it.

    The lamps of a subtree are neighbours in the order of the slots, so the slot of a lamp gives the
    path to it.
    """

    centre: mi.Point3f  # Of the lamps, weighted by power
    spread2: mi.Float  # Mean squared distance of the lamps' surfaces from the centre
    normal: mi.Vector3f  # Mean normal, zero for lamps that shine in all directions
    flat: mi.Float  # Part of the power from lamps that have a normal
    power: mi.Float
    depth: int = field(default=0)  # levels below the root, a multiple of `LEVELS`

    def choose(self, members: Members, it: mi.Interaction3f, u: mi.Float) -> Choice:
        """Choose a lamp for a point with one random number."""

        def descend(level, position, chance, u):
            left = position * mi.UInt32(2**LEVELS)
            place, share, u = choice.pick(self._shares(level, left, it), u)
            return left + place, chance * share, u

        position, chance, u = self._descend(descend, mi.UInt32(0), mi.Float(1), u)
        leaf = choice.choose(members, position * LEAF, LEAF, it, u)
        return leaf._replace(probability=leaf.probability * chance)

    def probability(self, members: Members, it: mi.Interaction3f, slot: mi.UInt32) -> mi.Float:
        """Probability with which `choose` takes a slot."""
        position = slot // LEAF

        def descend(level, chance):
            here = position >> (mi.UInt32(self.depth) - level)
            place = here & mi.UInt32(2**LEVELS - 1)
            return (chance * choice.entry_of(self._shares(level, here - place, it), place),)

        (chance,) = self._descend(descend, mi.Float(1))
        return chance * choice.probability(members, position * LEAF, LEAF, it, slot)

    def _descend(self, step: Callable[..., tuple], *state: Any) -> tuple:
        """Result of all steps, from the root to the leaves."""
        first = mi.UInt32(LEVELS)
        if self.depth == LEVELS:
            return step(first, *state)

        def body(level: mi.UInt32, *state: Any) -> tuple:
            return level + mi.UInt32(LEVELS), *step(level, *state)

        _, *state = dr.while_loop(
            (first, *state), lambda level, *_: level <= mi.UInt32(self.depth), body
        )
        return tuple(state)

    def _shares(self, level: mi.UInt32, left: mi.UInt32, it: mi.Interaction3f) -> list[mi.Float]:
        """Probabilities of the nodes that a step chooses among, from the leftmost one on."""
        first = left + _first(level)
        nodes = [self._importance(first + mi.UInt32(k), it) for k in range(2**LEVELS)]
        power = _sum([own for _, own in nodes])  # Zero where all lamps are dark
        total = _sum([importance for importance, _ in nodes])
        some = (total > 0) & (total < dr.inf)
        inverse = dr.select(some, dr.rcp(dr.select(some, total, 1)), 0) * (1 - POWER_SHARE)
        by_power = dr.select(some, POWER_SHARE, 1) / dr.select(power > 0, power, 1)
        return [
            dr.fma(dr.select(some, importance, 0), inverse, own * by_power)
            for importance, own in nodes
        ]

    def _importance(self, node: mi.UInt32, it: mi.Interaction3f) -> tuple[mi.Float, mi.Float]:
        """About what the lamps of a node give to a point, and the node's power."""
        power = take(mi.Float, self.power, node)
        to_centre = take(mi.Point3f, self.centre, node) - it.p
        spread2 = take(mi.Float, self.spread2, node)
        distance2 = dr.squared_norm(to_centre) + spread2  # Mean square
        inv = dr.rsqrt(distance2)
        # Variance of a direction's component, of lamps that are spread alike in all directions
        variance = spread2 * inv * inv * (1 / 3)

        normal, flat = take(mi.Vector3f, self.normal, node), take(mi.Float, self.flat, node)
        flat2 = flat * flat
        scatter = dr.maximum(flat2 - dr.squared_norm(normal), 0) * (1 / 3)
        towards = -dr.dot(normal, to_centre) * inv
        at_lamp = 1 - flat + _clipped_mean(towards, dr.fma(flat2, variance, scatter))

        upwards = dr.dot(it.n, to_centre) * inv
        front, back = _clipped_mean(upwards, variance), _clipped_mean(-upwards, variance)
        at_surface = dr.fma(FAR_SIDE, back, front)
        at_surface = dr.select(dr.squared_norm(it.n) > 0, at_surface, 1)
        return dr.select(power > 0, power * at_lamp * at_surface * (inv * inv), 0), power


def _first(level: mi.UInt32) -> mi.UInt32:
    """Place of the first node of a level."""
    return (mi.UInt32(1) << level) - mi.UInt32(2)


def _sum(values: list[mi.Float]) -> mi.Float:
    return sum(values[1:], values[0])


def _clipped_mean(mean: mi.Float, variance: mi.Float) -> mi.Float:
    """Mean of a number, clipped at zero, from its mean and variance (`SOFTNESS`)."""
    return 0.5 * (mean + dr.sqrt(dr.fma(mean, mean, SOFTNESS * variance)))


# ---- Building ----


def arrange(shapes: Shapes) -> np.ndarray:
    """Slots of the lamps: an array with the row of a lamp in each slot, -1 in empty ones.

    Their number is that of whole steps down the tree.

    Halves of the lamps are separated at the median along the longest extent of their centres, or of
    their normals where those differ more.
    """
    count = len(shapes.lx)
    normal = shapes.normal
    size = LEAF
    while size < count:
        size *= 2**LEVELS
    slots = np.full(size, -1)
    pending = [(np.arange(count), 0, size)]
    while pending:
        rows, start, width = pending.pop()
        if not len(rows):
            continue
        if width == LEAF:
            slots[start : start + len(rows)] = rows
            continue
        extent = np.ptp(shapes.centre[rows], axis=0).max()
        keys = np.concatenate([shapes.centre[rows], 0.5 * extent * normal[rows]], axis=1)
        rows = rows[np.argsort(keys[:, np.ptp(keys, axis=0).argmax()], kind="stable")]
        half = (len(rows) + 1) // 2
        pending.append((rows[:half], start, width // 2))
        pending.append((rows[half:], start + width // 2, width // 2))
    return slots


def build(shapes: Shapes, planar: np.ndarray, brightness: np.ndarray, slots: np.ndarray) -> Tree:
    """Nodes over the arranged lamps, of eight leaves at least, from the leaves upwards.

    Parameters
    ----------
    shapes, planar, brightness
        The lamps; which of them shine to one side; their radiances times sampling weights.
    slots
        The result of `arrange`.
    """
    # What a solid shows of itself is about as large as its largest cross section.
    power = brightness * np.pi * shapes.lx**2 * shapes.ratio
    there = slots >= 0
    power = np.where(there, power[slots], 0.0)
    centre, normal = shapes.centre[slots], shapes.normal[slots]
    radius = np.where(there, shapes.lx[slots], 0.0)
    all_around = there & ~planar[slots]
    levels = []
    width = LEAF
    while width < len(slots):
        levels.append(_level(width, there, power, centre, normal, radius, all_around))
        width *= 2
    nodes = [np.concatenate(parts) for parts in zip(*reversed(levels), strict=True)]
    middle, spread2, normal, flat, total = nodes
    return Tree(
        centre=table(mi.Point3f, middle.T),
        spread2=table(mi.Float, spread2),
        normal=table(mi.Vector3f, normal.T),
        flat=table(mi.Float, flat),
        power=table(mi.Float, total),
        depth=len(levels),
    )


def _level(width, there, power, centre, normal, radius, all_around) -> tuple[np.ndarray, ...]:
    """Nodes that hold `width` slots each."""
    there, power, radius, all_around = (
        v.reshape(-1, width) for v in (there, power, radius, all_around)
    )
    centre, normal = (v.reshape(-1, width, 3) for v in (centre, normal))
    total = power.sum(1)
    # A dark lamp still has a place in its node.
    weight = np.where(there, power + 1e-6 * total[:, None] + 1e-30, 0)
    weight /= np.maximum(weight.sum(1), 1e-30)[:, None]
    middle = (weight[..., None] * centre).sum(1)
    # The square of a coordinate is a quarter of the squared radius in the mean over a disk.
    distance2 = ((centre - middle[:, None]) ** 2).sum(2) + 0.25 * radius**2
    spread2 = (weight * distance2).sum(1)
    facing = np.where(all_around, 0, weight)
    return middle, spread2, (facing[..., None] * normal).sum(1), facing.sum(1), total
