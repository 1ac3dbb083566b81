"""Every code example of the documentation of the plugins runs."""

import re
import subprocess
import sys
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from mi_ellipse.sampling import DEFAULT, STRATEGIES

PAGE = (Path(__file__).parents[2] / "docs" / "plugins.md").read_text(encoding="utf-8")
EXAMPLES = re.findall(r"^```(\w+)\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)


def of(language):
    return [code for name, code in EXAMPLES if name == language]


def test_all_examples_are_run():
    assert {name for name, _ in EXAMPLES} == {"python", "xml"}
    assert PAGE.count("```") == 2 * len(EXAMPLES) == 10


@pytest.mark.parametrize("code", of("python"), ids=["shape", "emitter", "freeze"])
def test_python(code):
    """In a process of its own, as a reader would; pictures are finite and not black."""
    check = """
import numpy as np
for result in ([picture] if "picture" in globals() else globals().get("pictures", [])):
    result = np.array(result)
    assert np.isfinite(result).all() and result.max() > 0
"""
    subprocess.run([sys.executable, "-c", code + check], check=True, timeout=120)


@pytest.mark.parametrize("code", of("xml"), ids=["shape", "emitter"])
def test_xml(code):
    mi.set_variant("llvm_ad_rgb")
    loaded = mi.load_string(code if "<scene" in code else f'<scene version="3.0.0">{code}</scene>')
    if "<scene" in code:
        picture = np.array(mi.render(loaded, spp=16))
        assert np.isfinite(picture).all()
        assert picture.max() > 0
    else:
        assert loaded.shapes()[0].surface_area()[0] == pytest.approx(np.pi * 0.6, rel=1e-6)


def test_frozen_frames_are_those_of_a_plain_loop():
    code = of("python")[2]
    frozen, plain = {}, {}
    exec(code, frozen)
    exec(code.replace("@dr.freeze\n", ""), plain)
    for got, expected in zip(frozen["pictures"], plain["pictures"], strict=True):
        np.testing.assert_allclose(np.array(got), np.array(expected), rtol=1e-4, atol=1e-5)
    assert frozen["frame"].n_recordings < len(frozen["pictures"])
    assert not np.array_equal(np.array(plain["pictures"][0]), np.array(plain["pictures"][4]))
    dr.sync_thread()


def test_parameters_are_documented():
    """What a lamp exposes, and the strategies."""
    mi.set_variant("llvm_ad_rgb")
    scene = mi.load_dict({"type": "ellipse", "emitter": {"type": "ellipticalarea"}})
    for key in mi.traverse(scene).keys():  # noqa: SIM118
        name = key.removesuffix(".value").split(".")[-1]
        assert name == "reflectance" or f"`{name}`" in PAGE
    for name in STRATEGIES:
        assert f"`{name}`" in PAGE
    assert f"(Default: `{DEFAULT}`)" in PAGE
