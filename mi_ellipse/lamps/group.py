"""Lamps that choose among themselves which one answers for a light sample."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import InitVar, dataclass, field
from functools import partial
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..geometry.light import StoredLight, field_values
from ..geometry.tracing import branch, lookup, take
from ..sampling.strategy import Strategy
from . import choice, tree
from .choice import Choice, Members
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

    All members run the same code over gathered numbers.

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
    behaviour: mi.UInt32 = field(init=False)  # Place in the list of the group's behaviours
    emitter: mi.UInt32 = field(init=False)
    slot: mi.UInt32 = field(init=False)  # Of a member, by its rank among the lamps
    start: mi.Float = field(init=False)  # Sum of the weights of the lamps before, of a sum of 1
    width: mi.Float = field(init=False)  # Weight, of a sum of 1

    def __post_init__(
        self, lamps: Sequence[Lamp], weights: Sequence[float], emitters: Sequence[Any]
    ) -> None:
        self._lamps = list(lamps)
        self._rows = [_Row.of(lamp) for lamp in lamps]
        self._weights = np.array(weights, dtype=float)
        self._emitters = list(emitters)
        self._arrange()

    def __len__(self) -> int:
        return len(self._lamps)

    # ---- Parameters ----

    def refresh(self, lamp: Lamp, weight: float) -> None:
        """Follow a change of a member's parameters."""
        place = self._place_of(lamp)
        self._rows[place], self._weights[place] = _Row.of(lamp), weight
        self._arrange()

    def _arrange(self) -> None:
        """Put the lamps into slots and make the arrays."""
        count = len(self._lamps)
        brightness = np.array([row.brightness for row in self._rows]) * self._weights
        if count > FEW:
            lights = _lights(self._rows, brightness)
            slots = tree.arrange(lights)
            self.nodes = tree.build(lights, slots)
        else:
            slots, self.nodes = np.arange(count), None
        rows = np.where(slots >= 0, slots, 0)  # An empty slot has the numbers of some lamp

        self.members = _members(
            [self._rows[k] for k in rows], np.where(slots >= 0, brightness[rows], 0)
        )
        self._behaviours, behaviours = _distinct(self._lamps)
        self.behaviour = _array(mi.UInt32, behaviours[rows])
        share = self._weights / self._weights.sum()
        self.start = _array(mi.Float, (np.cumsum(share) - share)[rows])
        self.width = _array(mi.Float, share[rows])
        self._make_radiance(rows)
        self._make_pointers(slots, rows)
        if not _scalar():
            dr.eval(self)

    def _make_radiance(self, rows: np.ndarray) -> None:
        """Radiance of a slot; none if a lamp has more than one colour."""
        colours = [row.colour for row in self._rows]
        self._uniform = all(colour is not None for colour in colours)
        self._values = [row.value for row in self._rows]
        if _scalar():
            self.radiance = [colours[k] for k in rows] if self._uniform else []
            return
        plain = np.zeros((len(rows), dr.size_v(mi.UnpolarizedSpectrum)))
        if self._uniform:
            plain = np.array([np.array(dr.detach(c)).ravel() for c in colours])[rows]
        self.radiance = mi.UnpolarizedSpectrum(np.float32(plain.T))

    def _make_pointers(self, slots: np.ndarray, rows: np.ndarray) -> None:
        """Emitter of a slot, and slot of an emitter."""
        place = np.empty(len(self._lamps), dtype=np.uint32)
        place[slots[slots >= 0]] = np.flatnonzero(slots >= 0)
        self.slot = _array(mi.UInt32, place)
        self.emitter = [self._emitters[k] for k in rows]
        if not _scalar():
            self.emitter = mi.UInt32(np.array(self.emitter, dtype=np.uint32))

    # ---- Directions ----

    def sample_direction(
        self, rank: mi.UInt32, it: mi.Interaction3f, u: mi.Point2f, active: mi.Mask
    ) -> tuple[mi.DirectionSample3f, mi.Spectrum]:
        """Answer of the member of this rank, which is asked for a light sample, of any member.

        The rank is a variable and no constant, so that all members have the same code.

        Raises
        ------
        RuntimeError
            While `dr.freeze` records: replays with changed lamps have ended in a crash.
        """
        if not _scalar() and dr.flag(dr.JitFlag.FreezingScope):
            raise RuntimeError(
                "group_lamps: dr.freeze cannot record grouped lamps; render this scene without it, "
                "or leave the lamps ungrouped"
            )
        it, asked = type(it)(it), take(mi.UInt32, self.slot, rank)
        *drawn, slot = branch(u, True, partial(self._draw, it, asked), _draw_nothing)
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
        if self._uniform and not dr.grad_enabled(self._values):
            return mi.depolarizer(take(mi.UnpolarizedSpectrum, self.radiance, slot))
        return ds.emitter.eval_direction(it, ds, lit)

    def _draw(self, it, asked, u):
        with dr.suspend_grad(), lookup(False):
            width = take(mi.Float, self.width, asked)
            x = dr.fma(width, u.x, take(mi.Float, self.start, asked))
            chosen = self._choose(it, dr.minimum(x, choice.LAST))
            u = mi.Point2f(chosen.u, u.y)
            *drawn, pdf = self._by_behaviour(draw_from, chosen.slot, chosen.root, it, u)
            return *drawn, pdf * (chosen.probability / width), chosen.slot

    def pdf_direction(
        self, rank: mi.UInt32, it: mi.Interaction3f, d: mi.Vector3f, active: mi.Mask
    ) -> mi.Float:
        """Density of a direction that meets the member of this rank."""
        slot = take(mi.UInt32, self.slot, rank)
        return branch(d, active, partial(self._density, type(it)(it), slot), _no_density)

    def _density(self, it, slot, d):
        with dr.suspend_grad(), lookup(False):
            if self.nodes is None:
                first, count = mi.UInt32(0), len(self._lamps)
                share, root = choice.probability(self.members, first, count, it, slot)
            else:
                share, root = self.nodes.probability(self.members, it, slot)
            pdf = self._by_behaviour(density_of, slot, root, it, d)
            width = take(mi.Float, self.width, slot)
            # A weight may have become 0: such a lamp is never asked, and never answers.
            return dr.select(width > 0, pdf * share / dr.select(width > 0, width, 1), 0)

    def _choose(self, it: mi.Interaction3f, u: mi.Float) -> Choice:
        if self.nodes is None:
            return choice.choose(self.members, mi.UInt32(0), len(self._lamps), it, u)
        return self.nodes.choose(self.members, it, u)

    def _by_behaviour(
        self, function: Callable, slot: mi.UInt32, root: mi.Float, it: mi.Interaction3f, argument
    ) -> Any:
        """Call a function of `lamp` with the strategy and the light of the lamp in a slot."""

        def call(kind, arrays, strategy, slot, root, it, argument):
            return function(strategy, take(kind, arrays, slot), root, it, argument)

        kinds = dict(self.members.kinds())
        calls = [partial(call, kind, kinds[kind], strategy) for kind, strategy in self._behaviours]
        arguments = slot, root, it, argument
        if len(calls) == 1:
            return calls[0](*arguments)
        return dr.switch(take(mi.UInt32, self.behaviour, slot), calls, *arguments)

    def _place_of(self, lamp: Lamp) -> int:
        return next(k for k, member in enumerate(self._lamps) if member is lamp)


@dataclass(frozen=True)
class _Row:
    """What a group needs of a lamp."""

    stored: StoredLight
    fields: dict[str, np.ndarray]  # Of the stored light, in NumPy
    brightness: float  # Mean of the radiance
    colour: mi.UnpolarizedSpectrum | None  # Radiance, if it is one colour, and no spectrum
    value: Any  # The colour's parameter, which derivatives may follow

    @classmethod
    def of(cls, lamp: Lamp) -> _Row:
        values = field_values(lamp.stored)
        fields = {name: np.array(value).reshape(-1) for name, value in values.items()}
        radiance = lamp.radiance
        if mi.is_spectral or radiance.is_spatially_varying():
            mean = float(np.array(dr.detach(radiance.mean())).ravel()[0])
            return cls(lamp.stored, fields, mean, None, None)
        colour = radiance.eval(dr.zeros(mi.SurfaceInteraction3f))
        mean = float(np.mean(np.array(dr.detach(colour), dtype=float)))
        return cls(lamp.stored, fields, mean, colour, mi.traverse(radiance)["value"])


def _members(rows: Sequence[_Row], power: np.ndarray) -> Members:
    """Arrays of the lights in the slots. Where the kind is wrong, one of the right kind repeats."""
    kinds = list(dict.fromkeys(type(row.stored) for row in rows))
    kind = np.array([kinds.index(type(row.stored)) for row in rows], dtype=np.uint32)
    lights = []
    for place, each in enumerate(kinds):
        other = rows[np.argmax(kind == place)]
        lights.append(_stack(each, [row if type(row.stored) is each else other for row in rows]))
    return Members(power=_array(mi.Float, power), lights=lights, kind=_array(mi.UInt32, kind))


def _stack(kind: type, rows: Sequence[_Row]) -> StoredLight | list[StoredLight]:
    """One record of arrays of many records; the records themselves in scalar variants."""
    if _scalar():
        return [row.stored for row in rows]
    types = {name: type(value) for name, value in field_values(rows[0].stored).items()}
    columns = {
        name: np.stack([row.fields[name] for row in rows], axis=-1) for name in rows[0].fields
    }
    return kind(
        **{
            name: types[name](column[0] if len(column) == 1 else column)
            for name, column in columns.items()
        }
    )


def _lights(rows: Sequence[_Row], brightness: np.ndarray) -> Lights:
    """Places, directions, sizes and powers of lamps. A solid shines all around."""
    centre = np.array([row.fields["centre"] for row in rows], dtype=float)
    ex, ey = (np.array([row.fields[name] for row in rows], dtype=float) for name in ("ex", "ey"))
    radius = np.array([row.fields["lx"][0] for row in rows], dtype=float)
    ratio = np.array([row.fields["ratio"][0] if "ratio" in row.fields else 1 for row in rows])
    solid = np.array([not row.stored.planar for row in rows])
    # What a solid shows of itself is about as large as its largest cross section.
    return Lights(
        centre=centre,
        normal=np.cross(ex, ey),
        all_around=solid,
        radius=radius,
        power=brightness * np.pi * radius**2 * ratio,
    )


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


def _distinct(lamps: Sequence[Lamp]) -> tuple[list[tuple[type, Strategy]], np.ndarray]:
    """Kinds of lights with strategies, each pair once, and the place of each lamp's in the list."""
    pairs: dict[Any, tuple[type, Strategy]] = {}
    keys = []
    for lamp in lamps:
        kind = type(lamp.stored)
        keys.append((kind, lamp.strategy if lamp.follows_texture else lamp.sampling))
        pairs.setdefault(keys[-1], (kind, lamp.strategy))
    places = {key: place for place, key in enumerate(pairs)}
    return list(pairs.values()), np.array([places[key] for key in keys], dtype=np.uint32)


def _array(dtype: type, values: np.ndarray) -> Any:
    """Dr.Jit array, or list in scalar variants."""
    return values.tolist() if _scalar() else dtype(values)
