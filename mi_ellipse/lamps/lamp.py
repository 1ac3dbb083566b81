"""A lamp: light, strategy and radiance, with its draws, densities and positions."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import drjit as dr
import mitsuba as mi

from ..geometry.light import Light, StoredLight
from ..geometry.tracing import branch, lookup
from ..sampling import STRATEGIES, find
from ..sampling.strategy import Strategy
from .textured import Textured, follows_texture

# A distance below this part of the coordinates is nothing but their rounding. Single precision
# knows a coordinate to 2^-24, and a distance comes from six coordinates.
RESOLUTION = 2**-21


class Draw(NamedTuple):
    """A direction towards a lamp, and what it meets there."""

    p: mi.Point3f  # Point of the lamp
    n: mi.Normal3f  # Normal there
    uv: mi.Point2f  # Parameterisation there
    d: mi.Vector3f  # World-space direction
    distance: mi.Float
    pdf: mi.Float  # Density per solid angle; zero for a draw without light
    weight: mi.UnpolarizedSpectrum  # Radiance over density


@dataclass
class Lamp:
    """One lamp, independent of Mitsuba's emitter interface.

    Inactive packets of paths cost nothing, because draws and densities are branches of the kernel.
    If a scene has one kind of lamp, Dr.Jit calls it for every packet, active or not. The branch
    looks at the mask of the call and leaves inactive packets out. The radiance of a draw is part
    of its branch.

    Gradients reach the radiance. Directions and their densities are detached.

    Parameters
    ----------
    emission
        Emitted radiance, or the power of the whole lamp.
    sampling
        Name of a strategy.
    is_power
        Whether the emission is the power.
    stored
        The light. It is None until the lamp is placed. `dr.freeze` finds it because this class is
        a dataclass.
    radiance_per_power
        ``1 / (π area)`` of a placed lamp whose emission is the power.
    """

    emission: mi.Texture
    sampling: str
    is_power: bool = False
    stored: StoredLight | None = None
    radiance_per_power: mi.Float | None = None

    def __post_init__(self) -> None:
        self.planar = True  # Until the lamp is placed
        self.follow_radiance()

    def place(self, light: Light, area: mi.Float | None = None) -> None:
        """Take the light. The lamp keeps values of its own.

        Parameters
        ----------
        light
            The light.
        area
            Its surface area, where the emission is the power. Gradients may follow it.

        Raises
        ------
        ValueError
            If the strategy cannot sample a light of this kind.
        """
        if not light.planar and find(self.sampling).planar:
            able = ", ".join(name for name, entry in STRATEGIES.items() if not entry.planar)
            raise ValueError(
                f'sampling="{self.sampling}" is for planar lamps, and this one is a solid; choose '
                f"one of {able}"
            )
        stored = light.stored()
        dr.make_opaque(stored)
        self.stored = stored
        if area is not None:
            # A diffuse surface of radiance L sends out π L per area, to one side.
            self.radiance_per_power = dr.rcp(dr.pi * area)
            dr.make_opaque(self.radiance_per_power)
        if self.planar != light.planar:
            self.planar = light.planar
            self.follow_radiance()

    def follow_radiance(self) -> None:
        """Choose how to draw for the present radiance."""
        self.strategy = find(self.sampling).make()
        self.follows_texture = self.planar and follows_texture(self.emission)
        if self.follows_texture:
            self.strategy = Textured(self.strategy, self.emission)

    def radiance(self, si: mi.SurfaceInteraction3f, active: mi.Mask) -> mi.UnpolarizedSpectrum:
        """Emitted radiance at a point of the lamp."""
        return self.of_emission(self.emission.eval(si, active))

    def of_emission(self, value: mi.UnpolarizedSpectrum) -> mi.UnpolarizedSpectrum:
        """Radiance for a value of the emission; that itself where it is the radiance."""
        return value if self.radiance_per_power is None else value * self.radiance_per_power

    # ---- Directions ----

    def draw(self, it: mi.Interaction3f, u: mi.Point2f) -> Draw:
        """Draw a direction from a reference point with two random numbers."""
        # Derivatives trace the branch again, and `it` may have changed by then: keep a copy.
        drawn = branch(u, True, partial(self._draw, type(it)(it)), _draw_nothing)
        return Draw(*drawn)

    def density(self, it: mi.Interaction3f, d: mi.Vector3f, active: mi.Mask) -> mi.Float:
        """Density per solid angle of a world-space direction that meets the lamp."""
        return branch(d, active, partial(self._density, type(it)(it)), _no_density)

    def lights(self, point: mi.Point3f) -> mi.Mask:
        """Tell whether a point is on the emitting side; draws and densities use this test."""
        with dr.suspend_grad():
            return self.stored.light().seen_from(point).lit

    def _draw(self, it, u):
        """`Draw` of one trace of the branch."""
        with dr.suspend_grad(), lookup(self.follows_texture):
            drawn = p, n, uv, _, _, pdf = draw_from(self.strategy, self.stored, it, u)
            inv_pdf = dr.select(pdf > 0, dr.rcp(pdf), 0)
            si = dr.zeros(mi.SurfaceInteraction3f)
            si.p, si.n, si.uv = p, n, uv
            si.wavelengths = it.wavelengths
        return *drawn, self.radiance(si, pdf > 0) * inv_pdf

    def _density(self, it, d):
        """Density of one trace of the branch."""
        with dr.suspend_grad(), lookup(self.follows_texture):
            return density_of(self.strategy, self.stored, it, d)

    # ---- Positions ----

    def sample_position(
        self, u: mi.Point2f, active: mi.Mask
    ) -> tuple[mi.Point3f, mi.Normal3f, mi.Point2f]:
        """Point of the lamp, normal and uv, by the texture or as the light draws its surface."""
        light = self.stored.light()
        if not self.follows_texture:
            return light.sample_surface(u)
        uv = self.strategy.sample_position(u, active)
        a, b = light.from_uv(uv)
        return light.point(a, b), mi.Normal3f(light.normal), uv

    def pdf_position(self, p: mi.Point3f, uv: mi.Point2f) -> mi.Float:
        """Density per area of `sample_position`."""
        density = self.stored.light().surface_pdf(p)
        if self.follows_texture:
            density *= self.strategy.texture_density(uv)
        return density


def draw_from(
    strategy: Strategy,
    stored: StoredLight,
    it: mi.Interaction3f,
    u: mi.Point2f,
) -> tuple[mi.Point3f, mi.Normal3f, mi.Point2f, mi.Vector3f, mi.Float, mi.Float]:
    """Draw a point of a light from a reference point.

    Parameters
    ----------
    strategy
        How to draw.
    stored
        The light.
    it
        Reference point and normal of the surface there.
    u
        Two random numbers.

    Returns
    -------
    p, n, uv
        Point of the light, normal and parameterisation there.
    direction
        In world space.
    distance
        From the reference point.
    pdf
        Density per solid angle. An invalid draw gets the density zero, and integrators skip it. A
        NaN would survive a multiplication by zero.
    """
    light = stored.light()
    view = light.seen_from(it.p)
    record = strategy.prepare(view, it.n)
    d, pdf, valid = strategy.sample(record, u)
    zero = mi.Float(0)
    valid &= view.lit & (pdf > zero) & (pdf < dr.inf)
    hit = light.hit(view, d)
    # If the reference is a point of the lamp itself, the point drawn may be the same one. The
    # direction between the two, which `prb` and others compute, is then 0/0.
    valid &= hit.distance > RESOLUTION * dr.max(dr.abs(it.p))
    pdf = dr.select(valid, pdf, zero)
    return hit.p, hit.n, hit.uv, light.to_world(d), hit.distance, pdf


def density_of(
    strategy: Strategy,
    stored: StoredLight,
    it: mi.Interaction3f,
    direction: mi.Vector3f,
) -> mi.Float:
    """Density with which `draw_from` draws a world-space direction that meets the light."""
    light = stored.light()
    view = light.seen_from(it.p)
    record = strategy.prepare(view, it.n)
    pdf = strategy.pdf(record, light.to_light(direction))
    return dr.select(view.lit & dr.isfinite(pdf), pdf, 0)


def _draw_nothing(u):
    zero, origin = mi.Float(0), mi.Point3f(0)
    dark = mi.UnpolarizedSpectrum(zero)
    return origin, mi.Normal3f(zero), mi.Point2f(zero), mi.Vector3f(zero), zero, zero, dark


def _no_density(d):
    return mi.Float(0)
