"""Lamps that choose among themselves which one answers for a light sample."""

from __future__ import annotations

import weakref
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar

import drjit as dr
import mitsuba as mi
import numpy as np

from ..geometry.tracing import branch, lookup, table, take
from . import choice, tree
from .choice import Choice, Members
from .estimate import Outlines
from .lamp import Lamp, density_of, draw_from
from .records import Records
from .sharing import Member, Once, member
from .tree import Tree

# Up to this number every lamp is estimated at every point. `python -m benchmarks groups` tells what
# a tree loses from there on: its figures beside those of the exact choice.
FEW = 8


@dataclass
class Tables:
    """The numbers of a group that its code reads. An element stands for a slot."""

    members: Members
    lights: dict[str, Any]  # By the name of their kind
    nodes: Tree | None  # None for few lamps
    radiance: mi.UnpolarizedSpectrum
    behaviour: mi.UInt32  # Place in the list of the group's behaviours
    number: mi.UInt32  # `Member.number`
    slot: mi.UInt32  # By `Member.number`
    start: mi.Float  # Sum of the weights of the lamps before, of a sum of 1
    width: mi.Float  # Weight, of a sum of 1


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

    Parameters
    ----------
    lamps
        The members, at least two.
    weights
        Their sampling weights, positive.
    emitters
        Their emitters.
    """

    # What `dr.freeze` has to find. It asks for the tables at each call, so they are up to date.
    DRJIT_STRUCT: ClassVar[dict[str, type]] = {"tables": Tables}

    def __init__(
        self, lamps: Sequence[Lamp], weights: Sequence[float], emitters: Sequence[mi.Emitter]
    ):
        self._records = Records(lamps)
        self._weights = np.array(weights, dtype=float)
        # Weak, since each emitter holds the group
        self._emitters = [weakref.ref(emitter) for emitter in emitters]
        self.roles = [member(place, emitter) for place, emitter in enumerate(emitters)]
        self._draw_once, self._density_once = Once(len(lamps), self._plain), Once(len(lamps))
        self._tables: Tables | None = None

    def __len__(self) -> int:
        return len(self._weights)

    # ---- Parameters ----

    def refresh(self, role: Member, weight: float) -> None:
        """Follow a change of a member's parameters."""
        self._records.update(role.place)
        self._weights[role.place] = weight
        self._tables = None

    @property
    def tables(self) -> Tables:
        """The numbers of the lamps as they are now.

        They are made when they are next needed, as an update may change many lamps. That may be
        within a trace: nothing here evaluates a kernel.
        """
        if self._tables is None:
            self._tables = self._arrange()
        return self._tables

    def _arrange(self) -> Tables:
        """Put the lamps into slots and make the arrays."""
        records = self._records
        shapes, brightness = records.shapes(), records.brightness * self._weights
        if len(self) > FEW:
            slots = tree.arrange(shapes)
            nodes = tree.build(shapes, records.planar, brightness, slots)
        else:
            slots, nodes = np.arange(len(self)), None
        places = np.where(slots >= 0, slots, 0)  # An empty slot has the numbers of some lamp

        self._behaviours, behaviours = records.behaviours()
        share = self._weights / self._weights.sum()
        slot, number = self._numbers(slots, places)
        return Tables(
            members=Members(
                power=table(mi.Float, np.where(slots >= 0, brightness[places], 0)),
                outlines=Outlines.of(shapes[places]),
            ),
            lights=records.stacks(places),
            nodes=nodes,
            radiance=self._radiances(places),
            behaviour=table(mi.UInt32, behaviours[places]),
            number=number,
            slot=slot,
            start=table(mi.Float, (np.cumsum(share) - share)[places]),
            width=table(mi.Float, share[places]),
        )

    def _radiances(self, places: np.ndarray) -> Any:
        """Radiance of a slot, zero for a lamp of more than one colour."""
        nothing = np.zeros(dr.size_v(mi.UnpolarizedSpectrum))
        colours = [colour.value for colour in self._records.colours]
        values = np.array([nothing if value is None else value for value in colours])
        return table(mi.UnpolarizedSpectrum, values[places].T)

    def _numbers(self, slots: np.ndarray, places: np.ndarray) -> tuple[Any, Any]:
        """Slot of a number, and number of the member in a slot."""
        numbers = np.array([role.number for role in self.roles])
        there = np.flatnonzero(slots >= 0)
        slot = np.zeros(numbers.max() + 1, dtype=np.uint32)
        slot[numbers[slots[there]]] = there
        return table(mi.UInt32, slot), table(mi.UInt32, numbers[places])

    # ---- Directions ----

    def sample_direction(
        self, role: Member, it: mi.Interaction3f, u: mi.Point2f, active: mi.Mask
    ) -> tuple[mi.DirectionSample3f, mi.Spectrum]:
        """Answer of a member that is asked for a light sample, of any member."""
        return self._draw_once(self._sample_direction, role, it, u, active)

    def pdf_direction(
        self, role: Member, it: mi.Interaction3f, d: mi.Vector3f, active: mi.Mask
    ) -> mi.Float:
        """Density of a direction that meets this member."""
        return self._density_once(self._pdf_direction, role, it, d, active)

    def _sample_direction(self, number, it, u, active):
        asked = take(mi.UInt32, self.tables.slot, number)
        *drawn, slot = branch(u, True, partial(self._draw, it, asked), _draw_nothing)
        ds = mi.DirectionSample3f()
        ds.p, ds.n, ds.uv, ds.d, ds.dist, pdf = drawn
        ds.pdf = dr.select(active, pdf, 0)
        ds.time, ds.delta = it.time, False
        if _scalar():
            ds.emitter = self._emitters[self.tables.number[slot]]()
        else:
            chosen = dr.gather(mi.UInt32, self.tables.number, slot, active)
            ds.emitter = dr.reinterpret_array(mi.EmitterPtr, chosen)
        lit = active & (ds.pdf > 0)
        inverse = dr.select(lit, dr.rcp(dr.select(lit, ds.pdf, 1)), 0)
        if self._plain():
            radiance = mi.depolarizer(take(mi.UnpolarizedSpectrum, self.tables.radiance, slot))
        else:
            radiance = ds.emitter.eval_direction(it, ds, lit)
        return ds, radiance * inverse

    def _plain(self) -> bool:
        """Tell whether the radiance is a number of the group.

        If not, each emitter has to be called for it. Such a call within a call has data of its own
        for each member, so the members cannot share a trace.
        """
        colours = self._records.colours
        return all(c.value is not None and not dr.grad_enabled(c.parameters) for c in colours)

    def _draw(self, it, asked, u):
        with dr.suspend_grad(), lookup(False):
            width = take(mi.Float, self.tables.width, asked)
            x = dr.fma(width, u.x, take(mi.Float, self.tables.start, asked))
            chosen = self._choose(it, dr.minimum(x, choice.LAST))
            u = mi.Point2f(chosen.u, u.y)
            *drawn, pdf = self._by_behaviour(draw_from, chosen.slot, it, u)
            return *drawn, pdf * (chosen.probability / width), chosen.slot

    def _pdf_direction(self, number, it, d, active):
        slot = take(mi.UInt32, self.tables.slot, number)
        return branch(d, active, partial(self._density, it, slot), _no_density)

    def _density(self, it, slot, d):
        with dr.suspend_grad(), lookup(False):
            if self.tables.nodes is None:
                first, count = mi.UInt32(0), len(self)
                share = choice.probability(self.tables.members, first, count, it, slot)
            else:
                share = self.tables.nodes.probability(self.tables.members, it, slot)
            pdf = self._by_behaviour(density_of, slot, it, d)
            width = take(mi.Float, self.tables.width, slot)
            # A weight may have become 0: such a lamp is never asked, and never answers.
            return dr.select(width > 0, pdf * share / dr.select(width > 0, width, 1), 0)

    def _choose(self, it: mi.Interaction3f, u: mi.Float) -> Choice:
        if self.tables.nodes is None:
            return choice.choose(self.tables.members, mi.UInt32(0), len(self), it, u)
        return self.tables.nodes.choose(self.tables.members, it, u)

    def _by_behaviour(
        self, function: Callable, slot: mi.UInt32, it: mi.Interaction3f, argument: Any
    ) -> Any:
        """Call a function of `lamp` with the strategy and the light of the lamp in a slot."""

        tables = self.tables

        def call(kind, strategy, slot, it, argument):
            return function(strategy, take(kind, tables.lights[kind.__name__], slot), it, argument)

        calls = [partial(call, *behaviour) for behaviour in self._behaviours]
        return _one_of(calls, take(mi.UInt32, tables.behaviour, slot), (slot, it, argument))


def _one_of(calls: Sequence[Callable], number: mi.UInt32, arguments: tuple) -> Any:
    """Call the function of this number, by branches. `dr.switch` would be a call within a call."""
    first, *others = calls
    if not others:
        return first(*arguments)

    def rest(*values):
        return _one_of(others, number - mi.UInt32(1), values)

    return dr.if_stmt(arguments, number == 0, first, rest)


def _draw_nothing(u):
    zero = mi.Float(0)
    nowhere = mi.Point3f(0), mi.Normal3f(zero), mi.Point2f(zero), mi.Vector3f(zero)
    return *nowhere, zero, zero, mi.UInt32(0)


def _no_density(d):
    return mi.Float(0)


def _scalar() -> bool:
    return not dr.is_jit_v(mi.Float)
