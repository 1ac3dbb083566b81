"""Make the plugins known to Mitsuba's variants."""

from __future__ import annotations

from importlib import import_module

import mitsuba as mi

from . import emitter, shape
from .names import ELLIPSE, ELLIPSOID, ELLIPTICAL_AREA

# Mitsuba asks under this variant for the type of a plugin, whichever variant is set. Without an
# answer it merges equal shapes of a dictionary and cannot write XML.
TYPES_VARIANT = "scalar_rgb"

_registered: set[str] = set()


def install() -> None:
    """Register the plugins under the variant that is set, and under each one that will be."""
    mi.detail.add_variant_callback(_on_variant_change)
    _on_variant_change(None, mi.variant())


def _on_variant_change(old: str | None, new: str | None) -> None:
    if new is None:
        return
    for variant in {new, TYPES_VARIANT} - _registered:
        if variant in mi.variants():
            module = import_module(f"mitsuba.{variant}")
            module.register_shape(ELLIPSE, shape.create_ellipse)
            module.register_shape(ELLIPSOID, shape.create_ellipsoid)
            module.register_emitter(ELLIPTICAL_AREA, emitter.define(variant))
            _registered.add(variant)
