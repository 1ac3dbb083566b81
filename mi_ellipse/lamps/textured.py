"""Sampling of textured lamps: the density of the texture beside that of a strategy."""

from __future__ import annotations

from typing import Any, NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np

from ..geometry.ellipse import EllipseView
from ..geometry.tracing import TINY

# Least share of either kind of draws. It bounds the cost of mixing: the second moment of the other
# kind grows by a factor of at most 1 / (1 - MINIMUM_SHARE).
MINIMUM_SHARE = 0.05


class Record(NamedTuple):
    """What is computed once per reference point."""

    strategy: Any  # Record of the wrapped strategy
    view: EllipseView
    share: mi.Float  # Share of the draws that follow the texture


class Textured:
    """One-sample combination of a bitmap's density with that of a strategy.

    Neither a small bright feature nor a near light is noisy. Some draws follow the brightness of
    the texture: they find the bright feature. The other draws follow the strategy: they suit the
    near light. The density is that of the mixture (the balance heuristic of Veach and Guibas 1995,
    one-sample model). The share of each kind follows from an estimate of the relative variance that
    the other kind would have alone.

    Parameters
    ----------
    strategy
        Any strategy of this package.
    texture
        A bitmap for which `follows_texture` holds.
    """

    def __init__(self, strategy, texture: mi.Texture):
        self.strategy = strategy
        self.texture = texture

        # A texel covers an area in proportion to its radius: columns of the bitmap are radii.
        texels = np.array(dr.detach(mi.traverse(texture)["data"]), dtype=float).mean(axis=2)
        radius = (np.arange(texels.shape[1]) + 0.5) / texels.shape[1]
        # Relative variance of a strategy alone, far from the light: the radiance varies over the
        # area.
        contrast = _relative_variance(texels, radius)
        # Relative variance of the texture alone, far from the light: its density per area has a
        # factor of 1 / radius.
        spread = _relative_variance(radius, texels)
        self.contrast, self.spread = mi.Float(contrast), mi.Float(spread)
        dr.make_opaque(self.contrast, self.spread)

    def prepare(self, view: EllipseView, normal: mi.Normal3f) -> Record:
        """Compute the record of the strategy and the share of the texture."""
        seen = view.cone
        # Relative variance of the texture alone, near the light. Area sampling on the axis of a
        # large disk has tan² / 8.
        nearness = 0.125 * seen.ta * seen.tb
        share = self.contrast / (self.contrast + self.spread + nearness)
        return Record(
            strategy=self.strategy.prepare(view, normal),
            view=view,
            share=dr.clip(share, MINIMUM_SHARE, 1 - MINIMUM_SHARE),
        )

    def sample(self, record: Record, u: mi.Point2f) -> tuple[mi.Vector3f, mi.Float, mi.Mask]:
        """Direction along the light's frame, its density, and validity."""
        share = record.share
        from_texture = u.x < share
        u_texture = mi.Point2f(u.x / share, u.y)
        u_strategy = mi.Point2f((u.x - share) / (1 - share), u.y)

        uv = self.sample_position(u_texture, from_texture)
        light = record.view.light
        a, b = light.from_uv(uv)
        offset = mi.Vector3f(a, b * light.ratio32, 0)
        d_texture = dr.normalize(record.view.centre + offset)
        d_strategy, strategy_pdf, valid = self.strategy.sample(record.strategy, u_strategy)

        d = dr.select(from_texture, d_texture, d_strategy)
        strategy_pdf = dr.select(
            from_texture, self.strategy.pdf(record.strategy, d_texture), strategy_pdf
        )
        return d, self._mixture(record, d, strategy_pdf), valid | from_texture

    def pdf(self, record: Record, direction: mi.Vector3f) -> mi.Float:
        """Density of a direction that meets the light."""
        return self._mixture(record, direction, self.strategy.pdf(record.strategy, direction))

    def _mixture(self, record: Record, direction: mi.Vector3f, strategy_pdf: mi.Float) -> mi.Float:
        """Density per solid angle of both kinds of draws together."""
        view = record.view
        light = view.light
        a, b, _ = light.point_from_direction(view.centre, direction)
        distance = view.centre.z / direction.z
        area_to_angle = dr.square(distance) / (light.ratio32 * dr.abs(direction.z))
        texture_pdf = self.texture_density(light.uv(a, b)) * dr.inv_pi * area_to_angle
        return dr.lerp(strategy_pdf, texture_pdf, record.share)

    # ---- Positions ----

    def sample_position(self, u: mi.Point2f, active: mi.Mask) -> mi.Point2f:
        """Draw uv by the brightness of the texture."""
        return self.texture.sample_position(u, active)[0]

    def texture_density(self, uv: mi.Point2f) -> mi.Float:
        """Density per area of the draws by the texture, over that of uniform draws.

        Since ``uv = (radius, angle / 2π)``, the area is ``2π radius du dv`` times the semi-axes.
        """
        return self.texture.pdf_position(uv) / dr.maximum(uv.x + uv.x, TINY)


def follows_texture(texture: mi.Texture) -> bool:
    """Tell whether a texture can draw positions by its brightness, with their exact density.

    Only a bitmap can. It must not be black, and its `to_uv` must be the identity. Under another
    `to_uv` a bitmap draws as if there were none. So it misses what `to_uv` moves to places where
    the bitmap is black.
    """
    if not texture.class_name().startswith("BitmapTexture"):
        return False
    parameters = mi.traverse(texture)
    to_uv = parameters["to_uv"]
    return to_uv == type(to_uv)() and bool(np.any(dr.detach(parameters["data"])))


def _relative_variance(values: np.ndarray, weights: np.ndarray) -> float:
    """Weighted variance over the squared mean."""
    values, weights = np.broadcast_arrays(values, weights)
    mean = np.average(values, weights=weights)
    return float(np.average(values**2, weights=weights) / mean**2 - 1) if mean else 0.0
