"""Bad input of the two plugins: an exception that helps, or a finite picture.

The fuzzing runs in a process of its own, so that a crash of it fails a test and not the test run.
"""

import json
import math
import os
import subprocess
import sys

import mitsuba as mi
import numpy as np
import pytest
from conftest import floor_and
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from mi_ellipse.sampling import STRATEGIES
from mi_ellipse.system.messages import innermost_cause

EXAMPLES = 150


# ---- What is tried ----

NAN, INF = float("nan"), float("inf")
ODD = st.sampled_from([0.0, -0.0, -1.0, NAN, INF, -INF, 1e-40, 1e-30, 1e30, 1e38, 1e300])
AXIS = st.one_of(st.floats(0.01, 10), ODD, st.just("wide"), st.just(True), st.integers(-2, 3))
ENTRY = st.one_of(st.floats(-2, 2), ODD)
RADIANCE = st.one_of(
    st.floats(0, 10),
    ODD,
    st.lists(st.one_of(st.floats(0, 10), ODD), min_size=3, max_size=3),
    st.just("red"),
    st.sampled_from(["black", "white", "one texel", "nan", "infinite", "negative", "wide"]),
)
NAME = st.sampled_from([*STRATEGIES, "", "solid", "SOLID_ANGLE", "area ", "ünïcode"])
SURPRISE = st.sampled_from(
    ["semi_axis_z", "radius", "to_world", "samplin", "center", "flip_normal", "normal"]
)


@st.composite
def lamps(draw):
    """Parameters of a lamp as plain values; most are sound."""
    seldom = st.integers(0, 5).map(lambda n: n == 0)
    case = {"shape": {}, "emitter": {}, "matrix": None}
    for name in ("semi_axis_x", "semi_axis_y"):
        if draw(seldom):
            case["shape"][name] = draw(AXIS)
    if draw(seldom):
        case["shape"]["flip_normals"] = draw(st.one_of(st.booleans(), st.floats(), st.just("no")))
    if draw(seldom):
        case["matrix"] = draw(st.lists(ENTRY, min_size=12, max_size=12))
    if draw(st.booleans()):
        # Not None: the parser of Mitsuba 3.9.1 crashes at such a value, in any plugin.
        case["emitter"]["sampling"] = draw(st.one_of(NAME, st.integers()))
    if draw(st.booleans()):
        case["emitter"]["radiance"] = draw(RADIANCE)
    if draw(seldom):
        case[draw(st.sampled_from(["shape", "emitter"]))][draw(SURPRISE)] = draw(st.floats(0, 1))
    return case


def texture(kind):
    values = {
        "black": np.zeros((4, 4, 3)),
        "white": np.ones((4, 4, 3)),
        "one texel": np.ones((1, 1, 3)),
        "nan": np.full((4, 4, 3), NAN),
        "infinite": np.full((4, 4, 3), INF),
        "negative": np.full((4, 4, 3), -1.0),
        "wide": np.ones((1, 64, 3)),
    }[kind]
    return {"type": "bitmap", "bitmap": mi.Bitmap(values.astype(np.float32)), "raw": True}


def dictionary(case):
    emitter = {"type": "ellipticalarea"} | case["emitter"]
    radiance = emitter.get("radiance")
    if isinstance(radiance, list):
        emitter["radiance"] = {"type": "rgb", "value": radiance}
    elif isinstance(radiance, str) and radiance != "red":
        emitter["radiance"] = texture(radiance)
    matrix = np.diag([1.0, 1, 1, 1])
    if case["matrix"]:
        matrix[:3] = np.reshape(case["matrix"], (3, 4))
    down = mi.ScalarTransform4f().translate([0, 0, 1]).rotate([1, 0, 0], 180)
    to_world = down @ mi.ScalarTransform4f(mi.ScalarMatrix4f(matrix.tolist()))
    shape = {"type": "ellipse", "to_world": to_world, "emitter": emitter} | case["shape"]
    return floor_and({"lamp": shape}, 4)


# ---- What may come of it ----


def emits(case):
    """Whether there must be light: sound values, and a lamp that is not edge-on, tiny or far."""
    radiance = case["emitter"].get("radiance", 1.0)
    bright = radiance in ("white", "one texel", "wide") or (
        isinstance(radiance, float) and 1e-3 < radiance < 1e3
    )
    axes = [case["shape"].get(k, 1.0) for k in ("semi_axis_x", "semi_axis_y")]
    sound = all(isinstance(a, float | int) and 0.01 <= a <= 10 for a in axes)
    flipped = case["shape"].get("flip_normals")
    return bright and sound and case["matrix"] is None and not flipped


def unsound(case):
    """Whether a number of the radiance is itself not finite or beyond single precision."""
    radiance = case["emitter"].get("radiance", 1.0)
    if radiance in ("nan", "infinite"):
        return True
    numbers = radiance if isinstance(radiance, list) else [radiance]
    return any(isinstance(r, float) and not abs(r) < 1e30 for r in numbers)


def outcome(case):
    """ "error" with its text, or "picture"; raises an AssertionError for everything else."""
    mi.set_log_level(mi.LogLevel.Error)
    try:
        picture = np.array(mi.render(mi.load_dict(dictionary(case)), spp=8))
    except Exception as error:
        message = innermost_cause(error)
        assert "ellipse" in message or "ellipticalarea" in message
        assert len(message.split()) > 5
        return f"error: {message}"
    # Mitsuba takes a radiance that is no number, and shows it.
    if not unsound(case):
        assert np.isfinite(picture).all(), "not finite"
    if emits(case):
        assert picture.max() > 0, "black"
    return "picture"


def fuzz(variant):
    mi.set_variant(variant)
    count = {"picture": 0, "error": 0}

    @settings(
        max_examples=EXAMPLES,
        derandomize=True,
        deadline=None,
        database=None,
        suppress_health_check=list(HealthCheck),
    )
    @given(lamps())
    @example({"shape": {}, "emitter": {}, "matrix": None})
    @example({"shape": {}, "emitter": {"radiance": "black"}, "matrix": None})
    @example({"shape": {}, "emitter": {"radiance": "nan"}, "matrix": None})
    @example({"shape": {"semi_axis_x": 1e38, "semi_axis_y": 1e-38}, "emitter": {}, "matrix": None})
    @example({"shape": {}, "emitter": {}, "matrix": [1e300, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0]})
    def run(case):
        count[outcome(case).split(":")[0]] += 1

    run()
    return count


@pytest.mark.parametrize("variant", ["llvm_ad_rgb", "scalar_rgb"])
def test_fuzz(variant):
    program = f"import test_bad_input as t, json; print(json.dumps(t.fuzz({variant!r})))"
    process = subprocess.run(
        [sys.executable, "-c", f"import mi_ellipse; {program}"],
        env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert process.returncode == 0, process.stdout[-2000:] + process.stderr[-4000:]
    count = json.loads(process.stdout.splitlines()[-1])
    # Both happen, or the test says nothing.
    assert count["picture"] > EXAMPLES / 5
    assert count["error"] > EXAMPLES / 5


@pytest.mark.parametrize("axis", ["semi_axis_x", "semi_axis_y"])
@pytest.mark.parametrize("value", [0.0, -1.0, NAN, INF])
def test_message_names_everything(axis, value):
    mi.set_variant("llvm_ad_rgb")
    message = outcome({"shape": {axis: value}, "emitter": {}, "matrix": None})
    shown = str(value) if not math.isfinite(value) else f"{value:g}"
    assert message.endswith(f"ellipse: {axis}={shown} must be positive and finite")
