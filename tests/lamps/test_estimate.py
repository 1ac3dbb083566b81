"""The estimate of a lamp's irradiance, against a quadrature over the lamp's surface."""

import mitsuba as mi
import numpy as np
import pytest
from mi_ellipse.geometry import ellipse, ellipsoid, sphere
from mi_ellipse.lamps import estimate
from mi_ellipse.lamps.lamp import Lamp
from mi_ellipse.lamps.records import Records

pytestmark = pytest.mark.usefixtures("llvm_ad_rgb")

NODES = 200  # along each axis of the disk


def sides(half_axes, centre, normal):
    """Irradiance over π on both sides of a surface at the origin, by the midpoint rule.

    The light lies across the z axis at `centre` and shines downwards.
    """
    radius = np.sqrt((np.arange(NODES) + 0.5) / NODES)
    angle = 2 * np.pi * (np.arange(NODES) + 0.5) / NODES
    x = half_axes[0] * np.outer(radius, np.cos(angle)).ravel() + centre[0]
    y = half_axes[1] * np.outer(radius, np.sin(angle)).ravel() + centre[1]
    distance2 = x * x + y * y + centre[2] ** 2
    cosine = (normal[0] * x + normal[1] * y + normal[2] * centre[2]) / np.sqrt(distance2)
    weight = half_axes[0] * half_axes[1] * centre[2] / distance2**1.5
    return np.mean(np.maximum(cosine, 0) * weight), np.mean(np.maximum(-cosine, 0) * weight)


def guess(light, point, normal):
    """The estimate for a light."""
    lamp = Lamp(mi.load_dict({"type": "uniform", "value": 1.0}), "solid_angle")
    lamp.place(light)
    outlines = estimate.Outlines.of(Records([lamp]).shapes())
    got = outlines.irradiance(mi.UInt32(0), mi.Point3f(point), mi.Normal3f(normal))
    return np.array(got).item()


def ratios(half_angles, shortest, seed=3):
    """Estimate over truth for random lights and normals: with the horizon through them or not."""
    rng = np.random.default_rng(seed)
    divided, whole = [], []
    for _ in range(400):
        longest = np.tan(rng.uniform(*half_angles))
        axes = longest, longest * rng.uniform(*shortest)
        centre = np.array([*rng.normal(size=2) * 0.5, 1.0])
        normal = rng.normal(size=3)
        normal /= np.linalg.norm(normal)
        near, far = sides(axes, centre, normal)
        transform = mi.ScalarTransform4f().translate(centre).rotate([1, 0, 0], 180)
        light = ellipse.from_transform(transform.scale([*axes, 1]))
        ratio = guess(light, [0, 0, 0], normal) / (near + estimate.FAR_SIDE * far)
        (divided if min(near, far) > 0 else whole).append(ratio)
    return np.array(divided), np.array(whole)


# Bounds: twice the root mean squares that the docstring states, for the few lights here.
@pytest.mark.parametrize(
    ("half_angles", "shortest", "spread"),
    [((0.01, 0.2), (0.3, 1), 0.02), ((0.2, 1.2), (0.3, 1), 0.15), ((1.2, 1.5), (0.3, 1), 0.25)],
    ids=["small", "middle", "large"],
)
def test_estimate_where_the_horizon_divides_the_light(half_angles, shortest, spread):
    divided, whole = ratios(half_angles, shortest)
    assert len(divided) > 10
    assert np.sqrt(np.mean((divided - 1) ** 2)) < spread
    # The rule of the truth has an error of up to 1e-3 for lights that are 10 times their distance.
    if len(whole):
        np.testing.assert_allclose(whole, 1, atol=2e-3)


def test_light_that_nearly_fills_the_view_is_not_overrated():
    transform = mi.ScalarTransform4f().translate([0, 0, 1e-3]).rotate([1, 0, 0], 180)
    got = guess(ellipse.from_transform(transform), [0, 0, 0], [1, 0, 0])
    # Half of the hemisphere on each side: π/2 over π, up to the gap of a thousandth
    assert got == pytest.approx(0.5 * (1 + estimate.FAR_SIDE), rel=0.01)


def solid_sides(axes, centre, normal):
    """Irradiance over π on both sides of a surface at the origin, from an ellipsoid."""
    z = 2 * (np.arange(2 * NODES) + 0.5) / (2 * NODES) - 1
    angle = 2 * np.pi * (np.arange(NODES) + 0.5) / NODES
    z, angle = (v.ravel() for v in np.meshgrid(z, angle))
    across = np.sqrt(1 - z * z)
    unit = np.stack([across * np.cos(angle), across * np.sin(angle), z])
    axes = np.array(axes)[:, None]
    points = axes * unit + np.array(centre)[:, None]
    area = np.prod(axes) * unit / axes  # Normal times area, for the area of the unit sphere
    distance2 = (points**2).sum(0)
    seen = np.maximum(-(area * points).sum(0), 0) / distance2**1.5
    cosine = np.array(normal) @ points / np.sqrt(distance2)
    return 4 * np.mean(np.maximum(cosine, 0) * seen), 4 * np.mean(np.maximum(-cosine, 0) * seen)


@pytest.mark.parametrize("kind", ["ellipsoid", "sphere"])
def test_estimate_of_solids(kind):
    """Points from 0.2 to 10 sizes away, half-angles up to 55°: 1 % where the horizon is clear."""
    rng = np.random.default_rng(4)
    divided, whole = [], []
    for _ in range(150):
        axes = np.sort(rng.uniform(0.1, 1, 3))[::-1] if kind == "ellipsoid" else np.full(3, 0.5)
        direction = rng.normal(size=3)
        direction /= np.linalg.norm(direction)
        # On the surface of the ellipsoid that is larger by a factor
        centre = axes * direction * 10 ** rng.uniform(np.log10(1.2), 1)
        normal = rng.normal(size=3)
        normal /= np.linalg.norm(normal)
        near, far = solid_sides(axes, centre, normal)
        make = {"ellipsoid": ellipsoid, "sphere": sphere}[kind].from_transform
        light = make(mi.ScalarTransform4f().translate(centre).scale(axes))
        ratio = guess(light, [0, 0, 0], normal) / (near + estimate.FAR_SIDE * far)
        (divided if min(near, far) > 0 else whole).append(ratio)
    assert min(len(divided), len(whole)) > 20
    # The rule of the truth has an error of some 1e-3, as parts of its cells are not seen.
    np.testing.assert_allclose(whole, 1, atol=0.01)
    assert np.sqrt(np.mean((np.array(divided) - 1) ** 2)) < 0.25
