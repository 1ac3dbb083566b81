"""A balanced tree over many lamps, whose leaves choose by exact estimates.

The importance of a node follows A. Conty Estevez and C. Kulla, *Importance Sampling of Many Lights
with Adaptive Tree Splitting* (HPG 2018): power, distance, a cone of normals, and bounds of the
cosines over the node's sphere.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..geometry.tracing import take
from . import choice
from .choice import Choice, Members, rescaled
from .estimate import FAR_SIDE

LEAF = 2  # slots of a leaf

# Least cosine at the surface in the importance of a node. Bounds of the cosine are rough. A node
# that gives light with too small an importance makes fireflies.
LEAST_COSINE = 0.02


@dataclass
class Tree:
    """Nodes in the order of their levels, without the root: a node has its sibling beside it.

    The lamps of a subtree are neighbours in the order of the slots, so the slot of a lamp gives the
    path to it.
    """

    centre: mi.Point3f  # Of the lamps, weighted by power
    radius2: mi.Float  # Squared, of the sphere about the centre around the lamps
    axis: mi.Vector3f  # Mean normal
    cos_spread: mi.Float  # Cosine of the largest angle between a normal and the axis
    power: mi.Float
    depth: int = field(default=0)  # levels below the root

    def choose(self, members: Members, it: mi.Interaction3f, u: mi.Float) -> Choice:
        """Choose a lamp for a point with one random number."""
        position, chance, first = mi.UInt32(0), mi.Float(1), 0
        for level in range(1, self.depth + 1):
            left = position + position
            share = self._left_share(left + first, it)
            right = u >= share
            width = dr.select(right, 1 - share, share)
            u = rescaled(u, dr.select(right, share, 0), width)
            chance *= width
            position = left + dr.select(right, mi.UInt32(1), mi.UInt32(0))
            first += 2**level
        leaf = choice.choose(members, position * LEAF, LEAF, it, u)
        return leaf._replace(probability=leaf.probability * chance)

    def probability(
        self, members: Members, it: mi.Interaction3f, slot: mi.UInt32
    ) -> tuple[mi.Float, mi.Float]:
        """Probability with which `choose` takes a slot, and its `View.root`."""
        position, chance, first = slot // LEAF, mi.Float(1), 0
        for level in range(1, self.depth + 1):
            here = position >> (self.depth - level)
            is_right = (here & 1) > 0
            share = self._left_share(here - (here & 1) + first, it)
            chance *= dr.select(is_right, 1 - share, share)
            first += 2**level
        inside, root = choice.probability(members, position * LEAF, LEAF, it, slot)
        return chance * inside, root

    def _left_share(self, left: mi.UInt32, it: mi.Interaction3f) -> mi.Float:
        """Probability of the left one of two siblings."""
        a, power_a = self._importance(left, it)
        b, power_b = self._importance(left + mi.UInt32(1), it)
        total = a + b
        some = total > 0
        by_power = power_a / (power_a + power_b)  # The left one of two siblings is never empty
        share = dr.select(some, a / dr.select(some, total, 1), by_power)
        # All of a random number: it is below 1.
        return dr.select(power_b > 0, share, 1)

    def _importance(self, node: mi.UInt32, it: mi.Interaction3f) -> tuple[mi.Float, mi.Float]:
        """Bound of what the lamps of a node give to a point, and the node's power."""
        power = take(mi.Float, self.power, node)
        to_centre = take(mi.Point3f, self.centre, node) - it.p
        radius2 = take(mi.Float, self.radius2, node)
        distance2 = dr.squared_norm(to_centre)
        inside = distance2 <= radius2
        inv = dr.rsqrt(dr.select(inside, 1, distance2))

        # The sphere of the node covers this angle around its centre.
        sin2 = dr.select(inside, 1, radius2 * inv * inv)
        sine, cosine = dr.sqrt(sin2), dr.safe_sqrt(1 - sin2)
        cosine = dr.select(inside, -1, cosine)

        spread = take(mi.Float, self.cos_spread, node)
        towards = -dr.dot(take(mi.Vector3f, self.axis, node), to_centre) * inv
        towards = _nearer(towards, spread, dr.safe_sqrt(1 - spread * spread))
        at_lamp = dr.select(inside, 1, dr.maximum(_nearer(towards, cosine, sine), 0))

        upwards = dr.dot(it.n, to_centre) * inv
        front = dr.maximum(_nearer(upwards, cosine, sine), 0)
        back = dr.maximum(_nearer(-upwards, cosine, sine), 0)
        at_surface = dr.maximum(front + FAR_SIDE * back, LEAST_COSINE)
        at_surface = dr.select(inside | (dr.squared_norm(it.n) == 0), 1, at_surface)
        return power * at_lamp * at_surface / dr.maximum(distance2, 0.25 * radius2), power


def _nearer(cosine: mi.Float, other: mi.Float, other_sine: mi.Float) -> mi.Float:
    """Cosine of an angle less another one, and 1 where the other one is larger."""
    return dr.select(
        cosine >= other, 1, dr.fma(cosine, other, dr.safe_sqrt(1 - cosine * cosine) * other_sine)
    )


# ---- Building ----


@dataclass(frozen=True)
class Lights:
    """What the tree needs of lamps, in NumPy and world space, a row each."""

    centre: np.ndarray  # (n, 3)
    normal: np.ndarray  # (n, 3), unit
    all_around: np.ndarray  # (n,), True for a lamp that shines in all directions
    radius: np.ndarray  # (n,), longest semi-axis
    power: np.ndarray  # (n,), radiance times area times sampling weight


def arrange(lights: Lights) -> np.ndarray:
    """Slots of the lamps: an array with the row of a lamp in each slot, -1 in empty ones.

    Halves of the lamps are separated at the median along the longest extent of their centres, or of
    their normals where those differ more.
    """
    count = len(lights.power)
    size = LEAF
    while size < count:
        size *= 2
    slots = np.full(size, -1)
    pending = [(np.arange(count), 0, size)]
    while pending:
        rows, start, width = pending.pop()
        if width == LEAF:
            slots[start : start + len(rows)] = rows
            continue
        extent = np.ptp(lights.centre[rows], axis=0).max()
        keys = np.concatenate([lights.centre[rows], 0.5 * extent * lights.normal[rows]], axis=1)
        rows = rows[np.argsort(keys[:, np.ptp(keys, axis=0).argmax()], kind="stable")]
        half = (len(rows) + 1) // 2
        pending.append((rows[:half], start, width // 2))
        pending.append((rows[half:], start + width // 2, width // 2))
    return slots


def build(lights: Lights, slots: np.ndarray) -> Tree:
    """Nodes over the arranged lamps, of two leaves at least, from the leaves upwards."""
    there = slots >= 0
    power = np.where(there, lights.power[slots], 0.0)
    centre, normal = lights.centre[slots], lights.normal[slots]
    radius = np.where(there, lights.radius[slots], 0.0)
    all_around = there & lights.all_around[slots]
    levels = []
    width = LEAF
    while width < len(slots):
        levels.append(_level(width, there, power, centre, normal, radius, all_around))
        width *= 2
    nodes = [np.concatenate(parts) for parts in zip(*reversed(levels), strict=True)]
    middle, radius2, axis, cos_spread, total = nodes
    return Tree(
        centre=_array(mi.Point3f, middle),
        radius2=_array(mi.Float, radius2),
        axis=_array(mi.Vector3f, axis),
        cos_spread=_array(mi.Float, cos_spread),
        power=_array(mi.Float, total),
        depth=len(levels),
    )


def _array(dtype: type, rows: np.ndarray) -> Any:
    """Dr.Jit array of a row a node, or a list in scalar variants."""
    if dr.is_jit_v(mi.Float):
        return dtype(np.ascontiguousarray(np.float32(rows).T))
    return [dtype(row.tolist()) for row in rows]


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
    distance = np.linalg.norm(centre - middle[:, None], axis=2)
    reach = np.where(there, distance + radius, 0).max(1)
    axis = (weight[..., None] * normal).sum(1)
    length = np.linalg.norm(axis, axis=1, keepdims=True)
    axis = np.where(length > 1e-6, axis / np.maximum(length, 1e-6), [0.0, 0, 1])
    cosine = np.where(there, (normal * axis[:, None]).sum(2), 1)
    cosine = np.where(all_around, -1, cosine).min(1)
    # Rounded outwards to single precision
    return middle, reach**2 * (1 + 1e-5), axis, np.clip(cosine - 1e-6, -1, 1), total
