"""Plugin `ellipticalarea`: Mitsuba's emitter interface for elliptical lamps."""

from __future__ import annotations

from importlib import import_module
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..lamps.group import Group
from ..lamps.lamp import Lamp
from ..lamps.sharing import Member
from ..sampling import DEFAULT, STRATEGIES
from ..system import llvm
from .attachment import Attachment
from .names import ELLIPTICAL_AREA, POWER, RADIANCE

# What Python adds to every class
NOT_OWN = ("__dict__", "__weakref__")


class EllipticalArea:
    """Uniform or textured emission of an ellipse or ellipsoid, sampled by direction.

    Goes into a shape `ellipse`, `ellipsoid`, `disk` or `sphere`. Gradients reach the radiance and,
    through the shape, its transform. Directions and their densities are detached.

    `define` gives these methods to a class under Mitsuba's `Emitter`.

    Parameters
    ----------
    radiance : spectrum or texture
        Emitted radiance. Default 1.
    power : spectrum
        Instead of the radiance, what the whole lamp emits: π times its area times the radiance. The
        area is that of the lamp as it is, also after an update of its transform.
    sampling : str
        Name of a strategy in `mi_ellipse.sampling`. Default ``solid_angle``.
    """

    def __init__(self, props: mi.Properties):
        _base(self).__init__(props)
        llvm.check()
        self.lamp = _lamp(props)
        self.attachment = Attachment(self.lamp)
        self.group: Group | None = None  # See `grouping`
        self.role: Member | None = None  # In the group
        self._follow_radiance()

    # ---- Parameters ----

    def traverse(self, cb: mi.TraversalCallback) -> None:
        _base(self).traverse(cb)
        name = POWER if self.lamp.is_power else RADIANCE
        cb.put(name, self.lamp.emission, mi.ParamFlags.Differentiable)

    def parameters_changed(self, keys: list[str]) -> None:
        _base(self).parameters_changed(keys)
        if not keys or "parent" in keys:
            self.attachment.attach(self.get_shape())
        self.lamp.follow_radiance()
        self._follow_radiance()
        if self.group is not None:
            self.group.refresh(self.role, float(self.sampling_weight()))

    def _follow_radiance(self) -> None:
        self.m_flags = mi.EmitterFlags.Surface
        if self.lamp.emission.is_spatially_varying():
            self.m_flags |= mi.EmitterFlags.SpatiallyVarying

    def _attached(self) -> bool:
        return self.attachment.ready(self.get_shape)

    def _shines(self) -> bool:
        """Tell whether the radiance is known: that of a power needs the area of the shape."""
        return not self.lamp.is_power or self._attached()

    # ---- Directions ----

    def sample_direction(self, it, sample, active=True):
        ds = mi.DirectionSample3f()
        if not self._attached():
            return dr.zeros(mi.DirectionSample3f), dr.zeros(mi.Spectrum)
        if self.group is not None:
            return self.group.sample_direction(self.role, it, sample, active)
        drawn = self.lamp.draw(it, sample)
        ds.p, ds.n, ds.uv = drawn.p, drawn.n, drawn.uv
        ds.d, ds.dist, ds.time = drawn.d, drawn.distance, it.time
        ds.pdf = dr.select(active, drawn.pdf, 0)
        ds.delta = False
        ds.emitter = mi.EmitterPtr(self) if dr.is_jit_v(mi.Float) else self
        return ds, mi.depolarizer(dr.select(active, drawn.weight, 0))

    def pdf_direction(self, it, ds, active=True):
        if not self._attached():
            return mi.Float(0)
        if self.group is not None:
            return self.group.pdf_direction(self.role, it, ds.d, active)
        return self.lamp.density(it, ds.d, active)

    def eval_direction(self, it, ds, active=True):
        if not self._attached():
            return dr.zeros(mi.Spectrum)
        return self._radiance(
            mi.SurfaceInteraction3f(ds, it.wavelengths), active & self.lamp.lights(it.p)
        )

    def eval(self, si, active=True):
        return self._radiance(si, active & self._faces(si))

    def _faces(self, si):
        """Tell whether a point of the lamp is seen from its emitting side.

        The interpolated normals of an ellipsoid's mesh face away near its silhouette, where its
        triangles do not.
        """
        faces = mi.Frame3f.cos_theta(si.wi) > 0
        if not self.lamp.planar:
            faces |= dr.dot(si.n, si.to_world(si.wi)) > 0
        return faces

    def _radiance(self, si, lit):
        if not self._shines():
            return dr.zeros(mi.Spectrum)
        return mi.depolarizer(dr.select(lit, self.lamp.radiance(si, lit), 0))

    # ---- Positions, rays and wavelengths ----

    def sample_position(self, time, sample, active=True):
        ps = dr.zeros(mi.PositionSample3f) if dr.is_jit_v(mi.Float) else mi.PositionSample3f()
        if not self._attached():
            return ps, mi.Float(0)
        with dr.suspend_grad():
            ps.p, ps.n, ps.uv = self.lamp.sample_position(sample, active)
            ps.time = time
            ps.delta = False
            ps.pdf = self.lamp.pdf_position(ps.p, ps.uv)
            valid = active & (ps.pdf > 0)
            return ps, dr.select(valid, dr.rcp(dr.select(valid, ps.pdf, 1)), 0)

    def pdf_position(self, ps, active=True):
        return dr.select(active, self.lamp.pdf_position(ps.p, ps.uv), 0) if self._attached() else 0

    def sample_ray(self, time, sample1, sample2, sample3, active=True):
        ps, weight = self.sample_position(time, sample2, active)
        local = mi.warp.square_to_cosine_hemisphere(sample3)
        si = mi.SurfaceInteraction3f(ps, dr.zeros(type(mi.Ray3f().wavelengths)))
        wavelengths, wavelength_weight = self.sample_wavelengths(si, sample1, active)
        si.time = time
        si.wavelengths = wavelengths
        # π is what remains of the cosine over its density
        weight = mi.depolarizer(wavelength_weight * (weight * dr.pi))
        return si.spawn_ray(si.to_world(local)), weight

    def sample_wavelengths(self, si, sample, active=True):
        # There is no wavelength, and no `sample_shifted`, outside the spectral variants.
        shifted = mi.sample_shifted(sample) if mi.is_spectral else mi.Color0f()
        wavelengths, weight = self.lamp.emission.sample_spectrum(si, shifted, active)
        return wavelengths, self.lamp.of_emission(weight) if self._shines() else weight * 0

    def pdf_wavelengths(self, wavelengths, active=True):
        si = dr.zeros(mi.SurfaceInteraction3f)
        si.wavelengths = wavelengths
        return self.lamp.emission.pdf_spectrum(si, active)

    # ---- Other ----

    def bbox(self):
        return self.get_shape().bbox()

    def to_string(self) -> str:
        name = POWER if self.lamp.is_power else RADIANCE
        emission = str(self.lamp.emission).replace("\n", "\n  ")
        return f"EllipticalArea[\n  sampling = {self.lamp.sampling},\n  {name} = {emission}\n]"


def _lamp(props: mi.Properties) -> Lamp:
    """Lamp with the emission and the strategy of an emitter in a scene file."""
    if "to_world" in props:
        raise ValueError(
            f"{ELLIPTICAL_AREA}: to_world is not allowed; the emitter takes the transform of its "
            "shape, put it there"
        )
    is_power = POWER in props
    if is_power and RADIANCE in props:
        raise ValueError(
            f"{ELLIPTICAL_AREA}: {RADIANCE} and {POWER} are both given; leave one of them out, a "
            "lamp has the radiance power / (π area)"
        )
    name = POWER if is_power else RADIANCE
    if name in props:
        _check_numbers(name, props[name])
    emission = props.get_emissive_texture(name, 1.0)
    if is_power and emission.is_spatially_varying():
        raise ValueError(
            f"{ELLIPTICAL_AREA}: {POWER} must be a number, an RGB colour or a spectrum; a texture "
            f"says how bright each point is, give it as {RADIANCE}"
        )
    sampling = props.get("sampling", DEFAULT)
    if sampling not in STRATEGIES:
        raise ValueError(
            f'{ELLIPTICAL_AREA}: sampling="{sampling}" is unknown; choose one of '
            + ", ".join(STRATEGIES)
        )
    return Lamp(emission, sampling, is_power)


def _check_numbers(name: str, given: Any) -> None:
    """Refuse numbers that are no light; Mitsuba looks at objects and texts itself."""
    if isinstance(given, mi.Object | str):
        return
    values = np.ravel(np.array(getattr(given, "values", given), dtype=float))
    if not (np.isfinite(values).all() and (values >= 0).all()):
        numbers = ", ".join(f"{value:g}" for value in values)
        raise ValueError(f"{ELLIPTICAL_AREA}: {name}={numbers} must be finite and not negative")


def _base(emitter: EllipticalArea) -> mi.Emitter:
    """Methods of Mitsuba's own class; `super()` needs a class body in which it stands."""
    return super(type(emitter), emitter)


def define(variant: str) -> type:
    """Class of the plugin for a variant: `EllipticalArea` under the `Emitter` of that variant.

    Mitsuba's binding refuses a second base, so the class takes the methods one by one.
    """
    base = import_module(f"mitsuba.{variant}").Emitter
    own = {name: value for name, value in vars(EllipticalArea).items() if name not in NOT_OWN}
    return type("EllipticalArea", (base,), own)
