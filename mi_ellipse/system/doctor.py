"""Find out what can run on this machine, in processes of their own that may die trying."""

import json
import subprocess
import sys
from dataclasses import dataclass

from . import llvm
from .messages import innermost_cause


@dataclass(frozen=True)
class Trial:
    """What happened when a variant rendered a small picture."""

    variant: str
    works: bool
    message: str  # why it does not work
    llvm: str  # version and path of the LLVM it used; empty without one


def try_variant(variant: str, command: tuple[str, ...] | None = None) -> Trial:
    """
    Render a small picture with a Mitsuba variant in a new Python process.

    Parameters
    ----------
    variant
        Name of the variant.
    command
        What to run instead of this module; the variant is appended.
    """
    command = command or (sys.executable, "-m", "mi_ellipse.system.doctor")
    # The child chooses its LLVM by itself, as any other process on this machine will.
    process = subprocess.run(
        [*command, variant], capture_output=True, text=True, env=llvm.user_environment()
    )
    if process.returncode < 0:
        complaint = (process.stderr.splitlines() or ["it left no message"])[0]
        return Trial(variant, False, f"died of signal {-process.returncode}: {complaint}", "")
    try:
        report = json.loads(process.stdout.splitlines()[-1])
        return Trial(variant, process.returncode == 0, report["error"], report["llvm"])
    except (IndexError, KeyError, TypeError, ValueError):  # The report is missing or something else
        # The last line of a traceback says what went wrong.
        complaint = (process.stderr.splitlines() or ["it left no message"])[-1]
        message = f"ended without a report (exit code {process.returncode}): {complaint}"
        return Trial(variant, False, message, "")


def representatives(variants: list[str]) -> list[str]:
    """Return the first variant of each backend, with the default ``llvm_ad_rgb`` for LLVM."""
    chosen = {name.split("_")[0]: name for name in reversed(variants)}
    if "llvm_ad_rgb" in variants:
        chosen["llvm"] = "llvm_ad_rgb"
    return sorted(chosen.values(), key=variants.index)


def _render_lamp(variant: str) -> str:
    """Render a lamp above a floor, and return the LLVM that compiled it."""
    import mitsuba as mi

    mi.set_variant(variant)
    up = mi.ScalarTransform4f()
    scene = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 2},
            "sensor": {
                "type": "perspective",
                "to_world": up.look_at([0, -3, 2], [0, 0, 0], [0, 0, 1]),
                "film": {"type": "hdrfilm", "width": 8, "height": 8},
            },
            "floor": {"type": "rectangle"},
            "lamp": {
                "type": "ellipse",
                "semi_axis_y": 0.5,
                "to_world": up.translate([0, 0, 1]).rotate([1, 0, 0], 180),
                "emitter": {"type": "ellipticalarea", "radiance": 1.0},
            },
        }
    )
    mi.render(scene, spp=4).numpy()
    if not variant.startswith("llvm"):
        return ""
    version = ".".join(map(str, llvm.loaded_version() or ()))
    return f"{version} ({llvm.loaded_library() or 'path unknown'})"


def _main(variant: str) -> int:
    """Print a report for :func:`try_variant` and return the exit code."""
    report = {"error": "", "llvm": ""}
    try:
        report["llvm"] = _render_lamp(variant)
    except Exception as error:
        report["error"] = innermost_cause(error)
    print(json.dumps(report))
    return 1 if report["error"] else 0


if __name__ == "__main__":
    sys.exit(_main(sys.argv[1]))
