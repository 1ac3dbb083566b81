"""Lamps that choose among themselves which one answers for a light sample."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import InitVar, dataclass, field
from functools import partial
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..geometry import ellipse
from ..geometry.ellipse import StoredEllipse
from ..geometry.tracing import branch, instance_number, take
from . import choice, tree
from .choice import Choice, Members
from ..sampling.strategy import Strategy
from .lamp import Lamp, density_of, draw_from
from .tree import Lights, Tree

# Up to this number every lamp is estimated at every point.
FEW = 8


@dataclass
class Group:
    """Lamps of one scene, any of which may answer for another one.

    Mitsuba picks the emitter of a light sample with a fixed probability, the same at every point.
    A lamp of a group that is asked for a sample chooses a member, with a probability that follows
    what each one gives to the point, and answers with a sample of that member. Mitsuba multiplies
    the density by the probability of the lamp that it asked, and uses the emitter of the answer for
    all that follows. So the density of an answer has the factor ``W / w``: the sum W of the
    sampling weights of the group over the weight w of the lamp that was asked. The density of a
    direction has it with the weight of the lamp that it meets. Mitsuba's product is the same in
    both, and the estimate is unbiased.

    All members run the same code over gathered numbers. Dr.Jit traces it once for the group.

    The fields are what `dr.freeze` has to find.

    Parameters
    ----------
    lamps
        The members, at least two.
    weights
        Their sampling weights, positive.
    emitters
        Numbers of their emitters in Dr.Jit's registry; in scalar variants functions without
        arguments that return the emitters.
    """

    lamps: InitVar[Sequence[Lamp]]
    weights: InitVar[Sequence[float]]
    emitters: InitVar[Sequence[Any]]

    members: Members = field(init=False)
    nodes: Tree | None = field(init=False, default=None)  # None for few lamps
    radiance: mi.UnpolarizedSpectrum = field(init=False)
    strategy: mi.UInt32 = field(init=False)  # Place in the list of the group's strategies
    emitter: mi.UInt32 = field(init=False)
    slot: mi.UInt32 = field(init=False)  # By registry number
    start: mi.Float = field(init=False)  # Sum of the weights of the lamps before, of a sum of 1
    width: mi.Float = field(init=False)  # Weight, of a sum of 1

    def __post_init__(
        self, lamps: Sequence[Lamp], weights: Sequence[float], emitters: Sequence[Any]
    ) -> None:
        self._lamps = list(lamps)
        self._draw_once, self._density_once = _Once(len(lamps)), _Once(len(lamps))
        rows = [_Row.of(lamp) for lamp in lamps]
        self._matrices = np.stack([row.matrix for row in rows])
        self._brightness = np.array([row.brightness for row in rows])
        self._colours = [row.colour for row in rows]
        self._emitters = list(emitters)
        self._weights = np.array(weights, dtype=float)
        self._arrange()

    def __len__(self) -> int:
        return len(self._lamps)

    # ---- Parameters ----

    def refresh(self, lamp: Lamp, weight: float) -> None:
        """Follow a change of a member's parameters."""
        place = next(k for k, member in enumerate(self._lamps) if member is lamp)
        row = _Row.of(lamp)
        self._matrices[place], self._brightness[place] = row.matrix, row.brightness
        self._colours[place], self._weights[place] = row.colour, weight
        self._arrange()

    def _arrange(self) -> None:
        """Put the lamps into slots and make the arrays."""
        count = len(self._lamps)
        lights = _lights(self._matrices, self._brightness * self._weights)
        if count > FEW:
            slots = tree.arrange(lights)
            self.nodes = tree.build(lights, slots)
        else:
            slots, self.nodes = np.arange(count), None
        there = slots >= 0
        rows = np.where(there, slots, 0)

        self._strategies, strategies = _distinct(self._lamps)
        stored = [lamp.stored for lamp in self._lamps]
        self.members = Members(
            stored=[stored[k] for k in rows] if _scalar() else _stored(self._matrices[rows]),
            power=_array(mi.Float, np.where(there, (self._brightness * self._weights)[rows], 0)),
        )
        self.strategy = _array(mi.UInt32, strategies[rows])
        self._make_radiance(rows)
        share = self._weights / self._weights.sum()
        self.start = _array(mi.Float, (np.cumsum(share) - share)[rows])
        self.width = _array(mi.Float, share[rows])
        self._make_pointers(slots, rows)
        if not _scalar():
            dr.eval(self)

    def _make_radiance(self, rows: np.ndarray) -> None:
        """Radiance of a slot; none if a lamp has more than one colour."""
        uniform = all(colour is not None for colour in self._colours)
        self._uniform = uniform
        if _scalar():
            self.radiance = [self._colours[k] for k in rows] if uniform else []
            return
        width = dr.size_v(mi.UnpolarizedSpectrum)
        colours = np.zeros((len(rows), width))
        if uniform:
            colours = np.array([np.array(dr.detach(c)).ravel() for c in self._colours])[rows]
        self.radiance = mi.UnpolarizedSpectrum(np.float32(colours.T))

    def _make_pointers(self, slots: np.ndarray, rows: np.ndarray) -> None:
        """Emitter of a slot, and slot of an emitter."""
        place = np.empty(len(self._lamps), dtype=np.uint32)
        place[slots[slots >= 0]] = np.flatnonzero(slots >= 0)
        if _scalar():
            self.emitter = [self._emitters[k] for k in rows]
            self.slot = [int(p) for p in place]
            return
        numbers = np.array(self._emitters, dtype=np.uint32)
        by_number = np.zeros(numbers.max() + 1, dtype=np.uint32)
        by_number[numbers] = place
        self.emitter = mi.UInt32(numbers[rows])
        self.slot = mi.UInt32(by_number)
        self._slots = place

    # ---- Directions ----

    def sample_direction(
        self, lamp: Lamp, it: mi.Interaction3f, u: mi.Point2f, active: mi.Mask
    ) -> tuple[mi.DirectionSample3f, mi.UnpolarizedSpectrum]:
        """Answer of a member that is asked for a light sample, of any member."""
        inputs = type(it)(it), mi.Point2f(u), active
        return self._draw_once(inputs, partial(self._sample_direction, lamp, *inputs))

    def pdf_direction(
        self, lamp: Lamp, it: mi.Interaction3f, d: mi.Vector3f, active: mi.Mask
    ) -> mi.Float:
        """Density of a direction that meets a member."""
        inputs = type(it)(it), mi.Vector3f(d), active
        return self._density_once(inputs, partial(self._pdf_direction, lamp, *inputs))

    def _sample_direction(self, lamp, it, u, active):
        asked = self._slot_of(lamp)
        draw = partial(self._draw, it, asked)
        *drawn, slot = branch(u, True, draw, _draw_nothing)
        ds = mi.DirectionSample3f()
        ds.p, ds.n, ds.uv, ds.d, ds.dist, pdf = drawn
        ds.pdf = dr.select(active, pdf, 0)
        ds.time, ds.delta = it.time, False
        if _scalar():
            ds.emitter = self.emitter[slot]()
        else:
            number = dr.gather(mi.UInt32, self.emitter, slot, active)
            ds.emitter = dr.reinterpret_array(mi.EmitterPtr, number)
        lit = active & (ds.pdf > 0)
        inverse = dr.select(lit, dr.rcp(dr.select(lit, ds.pdf, 1)), 0)
        return ds, self._radiance(it, ds, slot, lit) * inverse

    def _radiance(self, it, ds, slot, lit):
        if self._uniform and not dr.grad_enabled(self._colours):
            return mi.depolarizer(take(mi.UnpolarizedSpectrum, self.radiance, slot))
        return ds.emitter.eval_direction(it, ds, lit)

    def _draw(self, it, asked, u):
        with dr.suspend_grad(), _without_lookup():
            width = take(mi.Float, self.width, asked)
            x = dr.fma(width, u.x, take(mi.Float, self.start, asked))
            chosen = self._choose(it, dr.minimum(x, choice.LAST))
            stored = take(StoredEllipse, self.members.stored, chosen.slot)
            u = mi.Point2f(chosen.u, u.y)
            *drawn, pdf = self._by_strategy(draw_from, chosen.slot, stored, chosen.root, it, u)
            return *drawn, pdf * (chosen.probability / width), chosen.slot

    def _pdf_direction(self, lamp, it, d, active):
        return branch(d, active, partial(self._density, it, self._slot_of(lamp)), _no_density)

    def _density(self, it, slot, d):
        with dr.suspend_grad(), _without_lookup():
            if self.nodes is None:
                first, count = mi.UInt32(0), len(self._lamps)
                share, root = choice.probability(self.members, first, count, it, slot)
            else:
                share, root = self.nodes.probability(self.members, it, slot)
            stored = take(StoredEllipse, self.members.stored, slot)
            pdf = self._by_strategy(density_of, slot, stored, root, it, d)
            return pdf * share / take(mi.Float, self.width, slot)

    def _choose(self, it: mi.Interaction3f, u: mi.Float) -> Choice:
        if self.nodes is None:
            return choice.choose(self.members, mi.UInt32(0), len(self._lamps), it, u)
        return self.nodes.choose(self.members, it, u)

    def _by_strategy(self, function: Callable, slot: mi.UInt32, *arguments: Any) -> Any:
        """Call a function of `lamp` with the strategy of the lamp in a slot."""
        functions = [partial(function, strategy) for strategy in self._strategies]
        if len(functions) == 1:
            return functions[0](*arguments)
        return dr.switch(take(mi.UInt32, self.strategy, slot), functions, *arguments)

    def _slot_of(self, lamp: Lamp) -> mi.UInt32:
        """Slot of the member whose method is called."""
        number = None if _scalar() else instance_number()
        if number is not None:
            return dr.gather(mi.UInt32, self.slot, number)
        place = next(k for k, member in enumerate(self._lamps) if member is lamp)
        return mi.UInt32(int(self.slot[place]) if _scalar() else int(self._slots[place]))


class _Once:
    """Trace of the code that all members share.

    Dr.Jit hands the same variables to the trace of each member. The first trace keeps its result,
    and the others return it. The last one lets it go, since nothing of a trace may outlive it.
    """

    def __init__(self, members: int):
        self.members = members
        self._forget()

    def __call__(self, inputs: tuple, compute: Callable[[], Any]) -> Any:
        if not _shared_trace() or dr.grad_enabled(inputs):
            return compute()
        key = tuple(dr.detail.collect_indices(inputs))
        if self._key != key:
            self._forget()
            # The inputs too: as long as they live, no other variables have their numbers.
            self._key, self._inputs, self._result = key, inputs, compute()
        self._served += 1
        result = self._result
        if self._served == self.members:
            self._forget()
        return result

    def _forget(self) -> None:
        self._key = self._inputs = self._result = None
        self._served = 0


def _shared_trace() -> bool:
    """Tell whether Dr.Jit traces a call of which all instances share the variables."""
    return (
        dr.is_jit_v(mi.Float)
        and dr.flag(dr.JitFlag.SymbolicScope)
        and instance_number() is not None
    )


@dataclass(frozen=True)
class _Row:
    """What a group needs of a lamp."""

    matrix: np.ndarray  # (4, 4), transform of the unit disk
    brightness: float  # Mean of the radiance
    colour: mi.UnpolarizedSpectrum | None  # Radiance, if it is the same at all points and RGB or grey

    @classmethod
    def of(cls, lamp: Lamp) -> _Row:
        matrix = np.array(lamp.to_world.matrix, dtype=float).reshape(4, 4)
        radiance = lamp.radiance
        if mi.is_spectral or radiance.is_spatially_varying():
            return cls(matrix, float(np.array(dr.detach(radiance.mean())).ravel()[0]), None)
        colour = radiance.eval(dr.zeros(mi.SurfaceInteraction3f))
        plain = np.array(dr.detach(colour), dtype=float).ravel()
        return cls(matrix, float(plain.mean()), colour)


def _draw_nothing(u):
    zero, origin = mi.Float(0), mi.Point3f(0)
    return (
        origin,
        mi.Normal3f(zero),
        mi.Point2f(zero),
        mi.Vector3f(zero),
        zero,
        zero,
        mi.UInt32(0),
    )


def _no_density(d):
    return mi.Float(0)


def _scalar() -> bool:
    return not dr.is_jit_v(mi.Float)


def _without_lookup():
    """See `Lamp._without_lookup`."""
    return dr.scoped_set_flag(dr.JitFlag.ValueNumbering, False)


def _distinct(lamps: Sequence[Lamp]) -> tuple[list[Strategy], np.ndarray]:
    """Strategies of lamps, each once, and the place of each lamp's in the list."""
    kinds: dict[Any, Strategy] = {}
    keys = [lamp.strategy if lamp.follows_texture else lamp.sampling for lamp in lamps]
    for key, lamp in zip(keys, lamps, strict=True):
        kinds.setdefault(key, lamp.strategy)
    places = {key: place for place, key in enumerate(kinds)}
    return list(kinds.values()), np.array([places[key] for key in keys], dtype=np.uint32)


def _batch(matrices: np.ndarray) -> mi.Matrix4d:
    return mi.Matrix4d(np.ascontiguousarray(np.moveaxis(matrices, 0, -1)))


def _stored(matrices: np.ndarray) -> StoredEllipse:
    return ellipse.from_transform(_batch(matrices)).stored()


def _array(dtype: type, values: np.ndarray) -> Any:
    """Dr.Jit array, or list in scalar variants."""
    return values.tolist() if _scalar() else dtype(values)


def _lights(matrices: np.ndarray, brightness: np.ndarray) -> Lights:
    """Centres, normals, sizes and powers of the images of the unit disk."""
    u, w, z = (matrices[:, :3, k] for k in range(3))
    across = np.cross(u, w)
    size = np.linalg.norm(across, axis=1)
    side = np.sign(np.einsum("ij,ij->i", across, z))
    # The longer semi-axis is the first singular value.
    radius = np.linalg.svd(matrices[:, :3, :2], compute_uv=False)[:, 0]
    normal = across * (side / size)[:, None]
    return Lights(matrices[:, :3, 3], normal, radius, brightness * np.pi * size)
