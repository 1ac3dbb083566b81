"""Group the lamps of a scene, so that they choose among themselves."""

from __future__ import annotations

from collections.abc import Sequence

import mitsuba as mi

from ..lamps.group import Group
from .names import ELLIPTICAL_AREA


def group_lamps(scene: mi.Scene, lamps: Sequence[mi.Emitter] | None = None) -> Group | None:
    """Let the lamps of a scene choose among themselves which one answers for a light sample.

    Mitsuba picks the lamp of a light sample at random, the same way at every point. In a group, the
    lamp that is picked answers for the lamp that gives most to the point, with exact densities. So
    most of the noise of picking is gone, and all of Mitsuba's integrators work as before.

    The group follows changes of its lamps through ``mi.traverse(scene)`` and ``update()``. A
    ``sampling_weight`` is a factor of the choice. A lamp of weight 0 stays out. A second call
    replaces the groups of the scene: lamps that are not in the new one act alone again.

    Parameters
    ----------
    scene
        The scene, after it was loaded.
    lamps
        Emitters of the scene that shall be grouped; by default all `ellipticalarea`.

    Returns
    -------
    Group or None
        None where fewer than two lamps are left, and nothing changes.

    Raises
    ------
    ValueError
        If one of `lamps` is no `ellipticalarea` of the scene.

    Notes
    -----
    The choice among many lamps is a tree, after A. Conty Estevez and C. Kulla, *Importance Sampling
    of Many Lights with Adaptive Tree Splitting* (HPG 2018).
    """
    own = every = [emitter for emitter in scene.emitters() if hasattr(emitter, "attachment")]
    if lamps is not None:
        chosen = list(lamps)
        for lamp in chosen:
            if lamp not in own:
                raise ValueError(
                    f"group_lamps: {lamp.class_name()} is no {ELLIPTICAL_AREA} of this scene"
                )
        own = [emitter for emitter in own if emitter in chosen]
    for emitter in every:
        emitter.group = None
    for emitter in own:
        emitter.attachment.ready(emitter.get_shape)
    weights = [float(emitter.sampling_weight()) for emitter in own]
    members = [(e, w) for e, w in zip(own, weights, strict=True) if w > 0]
    if len(members) < 2:
        return None
    emitters = [emitter for emitter, _ in members]
    group = Group([e.lamp for e in emitters], [w for _, w in members], emitters)
    for emitter, role in zip(emitters, group.roles, strict=True):
        emitter.group, emitter.role = group, role
    return group
