"""Principal axes, local coordinates, point on the light: against NumPy and Mitsuba's disk."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from conftest import ellipses, lamp
from mi_ellipse.geometry import ellipse
from mi_ellipse.sampling import STRATEGIES

import oracles.ellipse as oracle
from oracles.ellipse import MIRROR, SHEAR, rotation, translation

pytestmark = pytest.mark.usefixtures("llvm_ad_rgb")

TURN = rotation([1, -2, 0.5], 77)
MATRICES = {
    "circle": np.eye(4),
    "turned circle": translation(3, 2, 1) @ TURN @ np.diag([2.0, 2, 2, 1]),
    "long x": np.diag([3.0, 0.5, 1, 1]),
    "long y": np.diag([0.5, 3.0, 1, 1]),
    "turned": translation(3, 2, 1) @ TURN @ np.diag([0.7, 3, 1, 1]),
    "sheared": translation(-1, 0, 5) @ TURN @ SHEAR @ np.diag([1.5, 0.4, 1, 1]),
    "mirrored": MIRROR @ TURN @ SHEAR @ np.diag([1.5, 0.4, 1, 1]),
    "point reflection": TURN @ SHEAR @ np.diag([-1.0, -1, -1, 1]),
    "upside down": TURN @ np.diag([1.5, 0.4, -1, 1]),
    "needle": translation(0.1, 0.2, 0.3) @ TURN @ np.diag([1, 1e-6, 1, 1]),
    "sheared needle": TURN @ SHEAR @ np.diag([1e-6, 1, 1, 1]),
    "tiny": TURN @ SHEAR @ np.diag([2e-6, 1e-6, 1e-6, 1]),
}


@pytest.fixture(params=MATRICES, ids=[name.replace(" ", "-") for name in MATRICES])
def matrix(request):
    return MATRICES[request.param]


def vector(v):
    return np.array(v).reshape(3)


def test_principal_axes(matrix):
    light = ellipse.from_transform(mi.ScalarAffineTransform4d(matrix))
    # A singular value decomposition knows the shorter length to rounding of the longer only.
    left, lengths, _ = np.linalg.svd(matrix[:3, :2], full_matrices=False)
    area = np.linalg.norm(np.cross(matrix[:3, 0], matrix[:3, 1]))
    np.testing.assert_allclose(light.lx[0], lengths[0], rtol=1e-7)  # Single precision
    np.testing.assert_allclose(light.ly[0], area / lengths[0], rtol=1e-7)
    np.testing.assert_allclose(light.area[0], np.pi * area, rtol=3e-7)
    ratio = area / lengths[0] ** 2
    np.testing.assert_allclose(light.ratio[0], ratio, rtol=1e-12)
    np.testing.assert_allclose(light.eccentricity2[0], 1 - ratio**2, rtol=1e-6, atol=1e-14)

    axes = np.array([vector(v) for v in (light.ex, light.ey, light.normal)])
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-14)
    assert np.linalg.det(axes) > 0
    if ratio < 0.999:  # A circle has no axes of its own
        assert abs(vector(light.ex) @ left[:, 0]) > 1 - 1e-14
        # Perpendicular to the double-precision normal; the decomposition rounds needles more.
        assert abs(vector(light.ey) @ left[:, 1]) > 1 - 1e-10
    np.testing.assert_array_equal(vector(light.centre), matrix[:3, 3])


def test_axes_span_the_image_of_the_disk(matrix):
    """Every principal (a, b) on the unit circle is the image of a point of the unit circle."""
    light = ellipse.from_transform(mi.ScalarAffineTransform4d(matrix))
    t = np.linspace(0, 2 * np.pi, 50)
    p = np.outer(np.cos(t), vector(light.ex) * light.lx[0]) + np.outer(
        np.sin(t), vector(light.ey) * light.ly[0]
    )
    parameter = np.linalg.lstsq(matrix[:3, :2], p.T)[0]
    ratio = light.ratio[0]
    # The lengths are rounded to 6e-8; a least-squares solution of a needle adds 1e-16 / ratio.
    np.testing.assert_allclose(np.hypot(*parameter), 1, atol=2e-7 + 1e-15 / ratio)


def test_single_precision_transform_is_enough_for_the_shape_of_a_circle():
    """After an update of the scene only float32 values are left."""
    light = ellipse.from_transform(mi.AffineTransform4f(mi.ScalarTransform4f(TURN)))
    assert abs(light.ratio[0] - 1) < 3e-7  # Three roundings to float32
    assert np.all(np.isfinite(vector(light.ex)))


@pytest.mark.parametrize("flip", [False, True])
def test_normal_and_uv_are_those_of_the_disk(matrix, flip):
    """At points of the light; what rays find on Mitsuba's `disk` is the reference."""
    shape_dict = lamp(matrix, "area", flip_normals=flip)
    disk = mi.load_dict({"type": "disk"} | {k: shape_dict[k] for k in ("to_world", "flip_normals")})
    matrix = np.float32(matrix).astype(float)  # What the disk keeps
    light = mi.load_dict({"type": "scene", "lamp": shape_dict}).emitters()[0].lamp.stored.light()
    lx, ly = light.lx[0], light.ly[0]

    rng = np.random.default_rng(1)
    r, t = np.sqrt(rng.uniform(0.01, 0.98, 500)), rng.uniform(0, 2 * np.pi, 500)
    offset = (matrix[:3, :2] @ [r * np.cos(t), r * np.sin(t)]).T
    a, b = offset @ vector(light.ex) / lx, offset @ vector(light.ey) / ly
    uv = light.uv(mi.Float(a), mi.Float(b)).numpy().T
    assert np.abs(uv[:, 0] - r).max() < 2e-6  # Some roundings to float32
    turn = uv[:, 1] - t / (2 * np.pi)
    assert np.abs(turn - np.round(turn)).max() < 2e-6
    assert uv[:, 1].min() >= 0

    if ly < 1e-4 * lx:
        return  # Float32 coordinates of a ray cannot be aimed at such a needle
    up = vector(light.normal) * lx
    ray = mi.Ray3f(mi.Point3f((matrix[:3, 3] + offset + up).T), mi.Vector3f(-up))
    si = disk.ray_intersect(ray)
    hit = si.is_valid().numpy()
    assert hit.mean() > 0.99
    normals = si.n.numpy().T[hit]
    np.testing.assert_allclose(normals, np.tile(up / lx, (len(normals), 1)), atol=2e-6)
    difference = (uv - si.uv.numpy().T)[hit]
    difference[:, 1] -= np.round(difference[:, 1])
    # The ray is rounded at its distance from the origin; the angle is r ≥ 0.1 times steeper.
    rounding = 6e-8 * (lx + np.linalg.norm(matrix[:3, 3])) / ly
    assert np.abs(difference).max() < 30 * rounding + 5e-6


def test_light_coordinates():
    """In double precision, along a right-handed frame, in units of the longer semi-axis."""
    matrix = MATRICES["sheared"]
    light = ellipse.from_transform(mi.ScalarAffineTransform4d(matrix))
    point = np.random.default_rng(2).normal(0, 5, (100, 3)).astype(np.float32)
    got = light.light_coordinates(mi.Point3f(point.T)).numpy()
    frame = np.array([vector(v) for v in (light.ex, light.ey, light.normal)])
    expected = (
        frame @ (matrix[:3, 3] - point).T / np.linalg.norm(np.linalg.svd(matrix[:3, :2])[1][0])
    )
    np.testing.assert_allclose(got, expected, rtol=1e-12, atol=1e-12)


def test_a_point_in_the_plane_keeps_its_side():
    light = ellipse.from_transform(mi.ScalarAffineTransform4d())
    z = light.light_coordinates(mi.Point3f([0, 0, 0], [0, 0, 0], [0.0, -0.0, 1e-20])).z.numpy()
    assert np.all(np.abs(z) == ellipse.PLANE_FLOOR)


def test_point_from_direction_is_where_the_ray_meets_the_plane():
    """Ordinary configurations, against a double-precision intersection."""
    rng = np.random.default_rng(3)
    for name in ("circle", "sheared", "mirrored"):
        matrix = MATRICES[name]
        light = ellipse.from_transform(mi.ScalarAffineTransform4d(matrix))
        u, w, centre = oracle.seen_from(matrix, np.zeros(3))
        normal = vector(light.normal)
        r, t = np.sqrt(rng.uniform(0, 0.98, 1000)), rng.uniform(0, 2 * np.pi, 1000)
        target = centre + np.outer(r * np.cos(t), u) + np.outer(r * np.sin(t), w)
        # On the emitting side at all distances down to a hundredth of the light
        offset = rng.normal(size=(1000, 3)) * rng.choice([0.05, 1, 20], (1000, 1))
        height = offset @ normal
        offset += np.outer(np.maximum(0.01, np.abs(height)) - height, normal)
        reference = (target + offset).astype(np.float32)
        d = target - reference
        distance = np.linalg.norm(d, axis=1)
        coordinates = mi.Vector3f(light.light_coordinates(mi.Point3f(reference.T)))
        local = light.to_light(mi.Vector3f((d / distance[:, None]).T))
        a, b, got = light.point_from_direction(coordinates, local)
        p = light.point(a, b).numpy().T
        # Rounding of the direction, enlarged by the slope of the ray
        slope = distance / np.abs(d @ normal) * (1 + distance)
        np.testing.assert_array_less(np.linalg.norm(p - target, axis=1), 2e-6 * slope)
        np.testing.assert_array_less(np.abs(got.numpy() - distance), 2e-6 * slope)


@pytest.mark.parametrize("name", STRATEGIES)
def test_drawn_points_lie_on_the_light_at_the_extremes(name):
    """From its own plane, far away, at its rim: of directions drawn inside the cone."""
    data = oracle.extreme_ellipses()
    count = len(data["U"])
    per_light = 256
    index = dr.repeat(dr.arange(mi.UInt32, count), per_light)
    pick = index.numpy()
    light = ellipses(data["U"][pick], data["W"][pick], data["centre"][pick])
    u = np.random.default_rng(4).random((2, count * per_light), dtype=np.float32)
    reference = mi.Point3f(data["reference"][pick].T)
    strategy = STRATEGIES[name].make()
    record = strategy.prepare(light.seen_from(reference), mi.Normal3f(0, 0, 1))
    d, _, valid = strategy.sample(record, mi.Point2f(u))
    centre = light.light_coordinates(reference)
    a, b, distance = light.point_from_direction(mi.Vector3f(centre), d)
    p = light.point(a, b).numpy().T
    a, b, distance = a.numpy(), b.numpy(), distance.numpy()
    valid = np.broadcast_to(valid.numpy(), a.shape)
    assert np.isfinite(p).all()
    assert np.isfinite(distance).all()
    assert (distance >= 0).all()
    # Beyond one semi-axis clamped; nearer, needles narrower than the rounding of a direction are
    # missed by some draws.
    radius = np.hypot(a, b)[valid]
    assert (radius <= 1 + 1e-6).mean() > 0.9
    assert (radius <= 1 + 1e-3).mean() > 0.998

    # The distance is that of the point, to a few roundings of the coordinates and of the light.
    offset = p.astype(float) - data["reference"][pick]
    lx = light.lx.numpy()
    size = np.abs(p).max(1) + np.abs(data["reference"][pick]).max(1) + lx
    error = np.abs(np.linalg.norm(offset, axis=1) - distance)
    assert (error <= 1e-6 * size).mean() > 0.9999
