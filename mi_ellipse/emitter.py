"""Plugin `ellipticalarea`: Mitsuba's emitter interface for elliptical lights."""

from __future__ import annotations

import copy
from functools import partial

import drjit as dr
import mitsuba as mi

from . import ellipse, llvm
from .sampling import DEFAULT, STRATEGIES
from .sampling.textured import Textured, follows_texture

# Distances below this part of the coordinates are nothing but their rounding.
RESOLUTION = 2**-21


MISPLACED = (
    "ellipticalarea: the light is attached to {} and gives no light; put it into a shape of type "
    '"ellipse" or "disk"'
)


def define() -> type:
    """Class of the plugin under the current variant: `mi.Emitter` is another base in each."""

    class EllipticalArea(mi.Emitter):
        """Uniform or textured emission of one side of an ellipse, sampled by direction.

        Goes into a shape `ellipse` or `disk`. Gradients reach the radiance and, through the shape,
        its transform; directions and their densities are detached.

        Parameters
        ----------
        radiance : spectrum or texture
            Emitted radiance. Default 1.
        sampling : str
            A key of `mi_ellipse.sampling.STRATEGIES`. Default ``solid_angle``.
        """

        def __init__(self, props: mi.Properties):
            super().__init__(props)
            self._props = mi.Properties(props)  # For copies
            llvm.check()
            if "to_world" in props:
                raise ValueError(
                    "ellipticalarea: to_world is not allowed; the light inherits the transform of "
                    "its shape, put it there"
                )
            self.radiance = props.get_emissive_texture("radiance", 1.0)
            self.sampling = props.get("sampling", DEFAULT)
            if self.sampling not in STRATEGIES:
                raise ValueError(
                    f'ellipticalarea: sampling="{self.sampling}" is unknown; choose one of '
                    + ", ".join(STRATEGIES)
                )
            self.claimed = False  # By a shape: another one takes a copy
            self.ellipse = None
            self._misplaced = None
            self._follow_radiance()

        def copy(self) -> EllipticalArea:
            """A light with the same parameters that is not attached to a shape."""
            return type(self)(self._props)

        # ---- Parameters ------------------------------------------------------------------------

        def traverse(self, cb: mi.TraversalCallback) -> None:
            super().traverse(cb)
            cb.put("radiance", self.radiance, mi.ParamFlags.Differentiable)

        def parameters_changed(self, keys: list[str]) -> None:
            super().parameters_changed(keys)
            if not keys or "parent" in keys:
                self.attach()
            self._follow_radiance()

        def _follow_radiance(self) -> None:
            self.m_flags = mi.EmitterFlags.Surface
            if self.radiance.is_spatially_varying():
                self.m_flags |= mi.EmitterFlags.SpatiallyVarying
            self.strategy = STRATEGIES[self.sampling]()
            self.follows_texture = follows_texture(self.radiance)
            if self.follows_texture:
                self.strategy = Textured(self.strategy, self.radiance)

        def attach(self) -> None:
            """Take the geometry from the shape, as values that do not keep it alive."""
            shape = self.get_shape()
            if shape is None or shape.class_name() != "Disk":
                name = "no shape" if shape is None else f"a {shape.class_name()}"
                self._misplaced = MISPLACED.format(name)
                raise ValueError(self._misplaced)
            light = ellipse.from_transform(dr.detach(mi.traverse(shape)["to_world"]))
            light.centre = mi.Point3f(light.centre)  # Which it is, and half as much to gather
            dr.make_opaque(light)
            self.ellipse = light

        def _attached(self) -> ellipse.Ellipse | None:
            """Geometry of the light; None without a shape and for one that has raised its error.

            A copy, since its cached properties belong to one trace.

            Dr.Jit traces every living emitter, also that of a scene which the traceback of its
            error keeps alive, and one that has no shape yet: those must not fail the renders of
            other scenes, nor touch a shape that may be gone.
            """
            if self.ellipse is None:  # A plain disk gives no earlier opportunity
                if dr.is_jit_v(mi.Float) and (self._misplaced or self.get_shape() is None):
                    mi.Log(mi.LogLevel.Warn, self._misplaced or MISPLACED.format("no shape"))
                else:
                    self.attach()
            return copy.copy(self.ellipse)

        # ---- Directions ------------------------------------------------------------------------

        # Draws, with their radiance, and densities are branches of the kernel. Dr.Jit calls the one
        # kind of light of a scene for every packet of paths, active or not; a branch looks at the
        # mask of the call.

        def sample_direction(self, it, sample, active=True):
            light = self._attached()
            if light is None:
                return dr.zeros(mi.DirectionSample3f), dr.zeros(mi.Spectrum)
            ds = mi.DirectionSample3f()
            ds.n = mi.Normal3f(light.normal)
            # A copy of `it`, which may have changed until derivatives trace the branch again
            draw = partial(self._draw, light, type(it)(it))
            # The condition always holds, but Dr.Jit does not know: it drops a branch that it knows.
            drawn = dr.if_stmt((sample,), sample.x <= 1, draw, self._draw_nothing)
            ds.p, ds.d, ds.dist, ds.pdf, weight, ds.uv = drawn
            ds.pdf = dr.select(active, ds.pdf, 0)
            ds.time = it.time
            ds.delta = False
            ds.emitter = mi.EmitterPtr(self) if dr.is_jit_v(mi.Float) else self
            return ds, mi.depolarizer(dr.select(active, weight, 0))

        def _draw(self, light, it, u):
            """Point of the light, direction, distance, density, radiance over density, and uv.

            Integrators skip draws of no density; a NaN would survive a multiplication by zero.
            """
            light = copy.copy(light)  # For every trace of the branch
            with dr.suspend_grad(), self._lookup():
                record = self.strategy.prepare(light, it.p, it.n)
                d, pdf, valid = self.strategy.sample(record, u)
                centre = mi.Vector3f(record.centre)
                zero = mi.Float(0)
                valid &= (centre.z < zero) & (pdf > zero) & (pdf < dr.inf)
                a, b, dist = light.point_from_direction(centre, d)
                # From a point of the light itself the point drawn may be this same one, and the
                # direction that `prb` and others take between the two is then 0/0.
                valid &= dist > RESOLUTION * dr.max(dr.abs(it.p))
                pdf = dr.select(valid, pdf, zero)
                inv_pdf = dr.select(valid, dr.rcp(pdf), zero)

                si = dr.zeros(mi.SurfaceInteraction3f)
                si.p = light.point(a, b)
                si.n = mi.Normal3f(light.axes32[2])
                si.uv = light.uv(a, b)
                si.wavelengths = it.wavelengths
                d = light.to_world(d)
            return si.p, d, dist, pdf, self.radiance.eval(si, valid) * inv_pdf, si.uv

        def _draw_nothing(self, u):
            zero = mi.Float(0)
            dark = mi.UnpolarizedSpectrum(zero)
            return mi.Point3f(zero), mi.Vector3f(zero), zero, zero, dark, mi.Point2f(zero)

        def pdf_direction(self, it, ds, active=True):
            light = self._attached()
            if light is None:
                return mi.Float(0)
            with dr.suspend_grad():
                lit = active & (dr.dot(ds.d, ds.n) < 0)
                density = partial(self._pdf, light, it)
                return dr.if_stmt((ds.d,), lit, density, lambda _: mi.Float(0))

        def _pdf(self, light, it, d):
            with self._lookup():
                record = self.strategy.prepare(light, it.p, it.n)
                pdf = self.strategy.pdf(record, light.to_light(d))
                return dr.select(dr.isfinite(pdf), pdf, 0)

        def _lookup(self):
            """Leave out that Dr.Jit looks for each new operation among all living ones.

            With a hundred lamps it is a quarter of the time to trace them, and the strategies
            hardly repeat themselves; Mitsuba's bitmaps do.
            """
            return dr.scoped_set_flag(dr.JitFlag.ValueNumbering, self.follows_texture)

        def eval_direction(self, it, ds, active=True):
            lit = active & (dr.dot(ds.d, ds.n) < 0)
            si = mi.SurfaceInteraction3f(ds, it.wavelengths)
            return mi.depolarizer(dr.select(lit, self.radiance.eval(si, lit), 0))

        # ---- Positions, rays and wavelengths ---------------------------------------------------

        def eval(self, si, active=True):
            lit = active & (mi.Frame3f.cos_theta(si.wi) > 0)
            return mi.depolarizer(dr.select(lit, self.radiance.eval(si, lit), 0))

        def sample_position(self, time, sample, active=True):
            light = self._attached()
            ps = dr.zeros(mi.PositionSample3f) if dr.is_jit_v(mi.Float) else mi.PositionSample3f()
            if light is None:
                return ps, mi.Float(0)
            with dr.suspend_grad():
                if self.follows_texture:
                    ps.uv, _ = self.radiance.sample_position(sample, active)
                    a, b = light.from_uv(ps.uv)
                else:
                    a, b = light.from_disk(mi.warp.square_to_uniform_disk_concentric(sample))
                    ps.uv = light.uv(a, b)
                ps.p = light.point(a, b)
                ps.n = mi.Normal3f(light.normal)
                ps.time = time
                ps.delta = False
                ps.pdf = self._pdf_position(light, ps.uv)
                valid = active & (ps.pdf > 0)
                return ps, dr.select(valid, dr.rcp(dr.select(valid, ps.pdf, 1)), 0)

        def pdf_position(self, ps, active=True):
            light = self._attached()
            if light is None:
                return mi.Float(0)
            return dr.select(active, self._pdf_position(light, ps.uv), 0)

        def _pdf_position(self, light, uv):
            """Density per area."""
            if not self.follows_texture:
                return dr.rcp(light.area)
            # uv = (radius, angle / 2π): the area is 2π radius du dv, times lx ly
            pdf = self.radiance.pdf_position(uv)
            per_area = 2 * light.area * uv.x
            return dr.select(per_area > 0, pdf / dr.select(per_area > 0, per_area, 1), 0)

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
            return self.radiance.sample_spectrum(si, shifted, active)

        def pdf_wavelengths(self, wavelengths, active=True):
            si = dr.zeros(mi.SurfaceInteraction3f)
            si.wavelengths = wavelengths
            return self.radiance.pdf_spectrum(si, active)

        # ---- Other -----------------------------------------------------------------------------

        def bbox(self):
            return self.get_shape().bbox()

        def to_string(self) -> str:
            return (
                "EllipticalArea[\n"
                f"  sampling = {self.sampling},\n"
                f"  radiance = {str(self.radiance).replace(chr(10), chr(10) + '  ')}\n"
                "]"
            )

    return EllipticalArea
