"""`mi-ellipse doctor`: tell what can run on this machine."""

from __future__ import annotations

import platform

import mitsuba as mi
import typer

from ..rendering.provenance import versions
from ..system import doctor, llvm
from .options import DEFAULT_VARIANT


def run() -> None:
    """Print versions, the LLVM in use and what can run; fail if llvm_ad_rgb cannot."""
    for name, version in versions().items():
        print(f"{name.removesuffix('_version'):<11} {version}")
    print(f"python      {platform.python_version()}")
    print(f"platform    {platform.platform()}")
    print(f"variants    {', '.join(mi.variants())}")

    trials = {name: doctor.try_variant(name) for name in doctor.representatives(mi.variants())}
    default = trials.get(DEFAULT_VARIANT)
    print(f"LLVM        {default.llvm if default and default.works else _llvm_that_fails()}")
    for trial in trials.values():
        print(f"{trial.variant:<11} {'works' if trial.works else 'fails: ' + trial.message}")

    if default is None or not default.works:
        raise typer.Exit(1)


def _llvm_that_fails() -> str:
    version = llvm.loaded_version()
    if version is None:
        return "none found"
    return f"{'.'.join(map(str, version))} ({llvm.loaded_library() or 'path unknown'})"
