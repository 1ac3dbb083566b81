"""The sphere: cone and points, against closed forms of 60 digits and Mitsuba's own sphere."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from conftest import spheres
from mi_ellipse.geometry import cone, ellipsoid, sphere

from oracles import ellipse as oracle
from oracles.ellipse import MIRROR, rotation, translation

pytestmark = pytest.mark.usefixtures("llvm_ad_rgb")

TURN = rotation([1, -2, 0.5], 77)
MATRIX = translation(0.3, 0.2, 0.1) @ TURN @ np.diag([0.7, 0.7, 0.7, 1])


def rows(v):
    return v.numpy().T.astype(float)


class Extremes:
    """Spheres and points of all strata, the truth, and what the package makes of them."""

    def __init__(self):
        data = oracle.extreme_spheres()
        self.centre, self.reference = data["centre"], data["reference"]
        self.axes, self.ta, self.solid_angle = data["axes"], data["ta"], data["solid_angle"]
        self.radius = np.linalg.norm(data["axes"][:, :, 0], axis=1)
        self.label = data["labels"][data["stratum"]]
        self.light = spheres(data["axes"], self.centre)
        self.view = self.light.seen_from(mi.Point3f(self.reference.T))


@pytest.fixture(scope="module")
def extremes():
    mi.set_variant("llvm_ad_rgb")
    return Extremes()


# ---- Cone ----


def test_cone_at_the_extremes(extremes):
    """Each of its numbers within a few roundings: Ω 3e-7, where 1e-6 is promised."""
    seen = extremes.view.cone
    error = np.abs(cone.solid_angle(seen).numpy() / extremes.solid_angle - 1)
    worst = np.argmax(error)
    assert error[worst] < 5e-7, extremes.label[worst]
    assert extremes.view.lit.numpy().all()
    np.testing.assert_allclose(seen.ta.numpy(), extremes.ta, rtol=3e-7)
    np.testing.assert_allclose(seen.tb.numpy(), extremes.ta, rtol=3e-7)
    np.testing.assert_allclose(seen.inv_ta2.numpy() * extremes.ta**2, 1, rtol=5e-7)
    sine2 = extremes.ta**2 / (1 + extremes.ta**2)
    np.testing.assert_allclose(seen.sine2.numpy(), sine2, rtol=3e-7)
    np.testing.assert_allclose(seen.cosine2.numpy() * (1 + extremes.ta**2), 1, rtol=6e-7)
    towards = extremes.centre - extremes.reference
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    np.testing.assert_allclose(rows(seen.z), towards, atol=3e-7)


def test_frame_is_orthonormal(extremes):
    seen = extremes.view.cone
    x, y, z = rows(seen.x), rows(seen.y), rows(seen.z)
    for a, b, expected in ((x, x, 1), (y, y, 1), (x, y, 0), (x, z, 0), (y, z, 0)):
        np.testing.assert_allclose(np.sum(a * b, 1), expected, atol=6e-7)
    np.testing.assert_allclose(np.cross(x, y), z, atol=6e-7)
    v = mi.Vector3f(np.random.default_rng(1).normal(size=(3, len(x))))
    back = rows(seen.from_local(seen.to_local(v)))
    np.testing.assert_allclose(back, rows(v), atol=3e-6)


def test_frame_along_the_axes_of_the_world():
    """Also where the axis of the cone is -z, and where it is across z."""
    for direction in np.concatenate([np.eye(3), -np.eye(3)]):
        view = spheres([0.5 * np.eye(3)], [3 * direction]).seen_from(mi.Point3f(0, 0, 0))
        frame = np.array([rows(v)[0] for v in (view.cone.x, view.cone.y, view.cone.z)])
        np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=3e-7)
        np.testing.assert_allclose(frame[2], direction, atol=1e-7)


def test_inside_is_dark():
    """Points at .999 and 1.001 of the surface, and the centre."""
    light = sphere.from_transform(mi.ScalarAffineTransform4d(MATRIX))
    q = np.random.default_rng(3).normal(size=(100, 3))
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    for scale, outside in ((0, False), (0.999, False), (1.001, True)):
        view = light.seen_from(mi.Point3f((scale * q @ MATRIX[:3, :3].T + MATRIX[:3, 3]).T))
        assert np.all(view.lit.numpy() == outside)
        assert np.all(view.outside.numpy() == outside)
        seen = view.cone
        for v in (seen.z, seen.ta2, seen.inv_ta2, seen.sine2, cone.solid_angle(seen)):
            assert np.isfinite(v.numpy()).all()


# ---- Points ----


def test_hit_is_the_nearer_intersection(extremes):
    """Of directions to the interior of the cone, against the quadratic in double precision."""
    rng = np.random.default_rng(2)
    count = len(extremes.ta)
    towards = extremes.centre - extremes.reference
    away = np.linalg.norm(towards, axis=1)
    z = towards / away[:, None]
    across = np.cross(z, rng.normal(size=(count, 3)))
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    sine = 0.9 * rng.random(count) * extremes.radius / away
    d = np.sqrt(1 - sine**2)[:, None] * z + sine[:, None] * across
    got = extremes.light.hit(extremes.view, mi.Vector3f(d.T))

    half = np.sqrt(extremes.radius**2 - (sine * away) ** 2)
    distance = (away**2 - extremes.radius**2) / (np.sqrt(1 - sine**2) * away + half)
    p = extremes.reference + distance[:, None] * d
    normal = (p - extremes.centre) / extremes.radius[:, None]
    # A rounding of the direction, 1e-7, is enlarged by the distance in radii, and at the surface by
    # one over the cosine there, which is 0.43 at least.
    moved = 3e-7 * (1 + away / extremes.radius)
    np.testing.assert_array_less(np.linalg.norm(rows(got.n) - normal, axis=1), 5 * moved)
    size = moved * extremes.radius + 2e-7 * np.abs(extremes.centre).max(1)
    np.testing.assert_array_less(np.linalg.norm(rows(got.p) - p, axis=1), 5 * size)
    np.testing.assert_array_less(np.abs(got.distance.numpy() - distance), 5 * size)


def test_distance_close_to_the_surface_keeps_its_digits():
    """From 1e-5 above, straight down: what single precision loses is formed in double."""
    height = np.float32(1.00001) - 1.0
    view = spheres([np.eye(3)], np.zeros((1, 3))).seen_from(mi.Point3f([0], [0], [1.00001]))
    hit = view.light.hit(view, mi.Vector3f(0, 0, -1))
    assert hit.distance[0] == pytest.approx(height, rel=3e-7)


@pytest.mark.parametrize("mirrored", [False, True])
def test_point_normal_and_uv_are_those_of_mitsubas_sphere(mirrored):
    """Under a turn, or a mirror, where rays meet Mitsuba's own."""
    matrix = MATRIX @ MIRROR if mirrored else MATRIX
    to_world = mi.ScalarTransform4f(matrix)
    scene = mi.load_dict({"type": "scene", "sphere": {"type": "sphere", "to_world": to_world}})
    light = sphere.from_transform(mi.ScalarAffineTransform4d(matrix))
    rng = np.random.default_rng(4)
    origin = rng.normal(size=(500, 3)) * 3 + 4
    target = matrix[:3, 3] + 0.4 * rng.uniform(-1, 1, (500, 3))
    d = target - origin
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    ray = mi.Ray3f(mi.Point3f(origin.T), mi.Vector3f(d.T))
    si = scene.ray_intersect(ray)
    assert si.is_valid().numpy().all()
    got = light.hit(light.seen_from(ray.o), ray.d)
    np.testing.assert_allclose(rows(got.p), rows(si.p), atol=2e-5)
    # A mirror turns the normals of Mitsuba's sphere inwards.
    np.testing.assert_allclose(rows(got.n), (-1 if mirrored else 1) * rows(si.n), atol=3e-5)
    np.testing.assert_allclose(got.distance.numpy(), si.t.numpy(), rtol=3e-6)
    difference = rows(got.uv) - rows(si.uv)
    difference[:, 0] -= np.round(difference[:, 0])
    near_pole = np.minimum(rows(si.uv)[:, 1], 1 - rows(si.uv)[:, 1]) < 0.05
    assert np.abs(difference[~near_pole]).max() < 1e-4


def test_surface_samples_are_uniform():
    light = sphere.from_transform(mi.ScalarAffineTransform4d(MATRIX))
    u = np.random.default_rng(6).random((2, 200_000), dtype=np.float32)
    p, n, uv = light.sample_surface(mi.Point2f(u))
    q = (rows(p) - MATRIX[:3, 3]) / 0.7
    assert np.abs(np.linalg.norm(q, axis=1) - 1).max() < 1e-6
    np.testing.assert_allclose(rows(n), q, atol=1e-6)
    np.testing.assert_allclose(light.surface_pdf(p).numpy(), 1 / (4 * np.pi * 0.49), rtol=1e-6)
    # Mean 0 and second moments ⅓, six standard errors
    assert np.abs(q.mean(0)).max() < 6 * np.sqrt(1 / 3 / len(q))
    assert np.abs((q**2).mean(0) - 1 / 3).max() < 6 * np.sqrt(4 / 45 / len(q))
    assert ((rows(uv) >= 0) & (rows(uv) <= 1)).all()


# ---- Which transforms are spheres ----


@pytest.mark.parametrize("linear", [TURN[:3, :3], 1e-3 * MIRROR[:3, :3] @ TURN[:3, :3]])
def test_radius_of_a_similarity(linear):
    assert sphere.is_sphere(linear)
    matrix = np.eye(4)
    matrix[:3, :3] = linear
    light = sphere.from_transform(mi.ScalarAffineTransform4d(matrix))
    general = ellipsoid.from_transform(mi.ScalarAffineTransform4d(matrix))
    assert light.inv_lx[0] == pytest.approx(general.inv_lx[0], rel=1e-13)
    assert light.lx[0] == pytest.approx(general.lx[0], rel=1e-7)


def test_what_is_no_sphere():
    assert sphere.is_sphere(np.diag([1, 1, 1 + 5e-7]))
    assert not sphere.is_sphere(np.diag([1, 1, 1 + 2e-6]))
    assert not sphere.is_sphere(oracle.SHEAR[:3, :3])


def test_scalar_variants_at_degenerate_views():
    """Python's floats raise an error where Dr.Jit's arrays divide by zero."""
    mi.set_variant("scalar_rgb")
    light = sphere.from_transform(mi.ScalarAffineTransform4d())
    for point in np.concatenate([1.5 * np.eye(3), -1.5 * np.eye(3), [[1, 1, 1], [0, 0, 0]]]):
        view = light.seen_from(mi.Point3f(point))
        seen = view.cone
        assert view.lit == bool(np.any(point))
        hit = light.hit(view, mi.Vector3f(seen.z))
        assert np.isfinite([*seen.x, *seen.y, *seen.z, seen.ta, seen.tb]).all()
        assert np.isfinite([*hit.p, *hit.n, *hit.uv, hit.distance]).all()
        if view.lit:
            assert dr.norm(hit.p - mi.Point3f(point)) == pytest.approx(hit.distance, rel=1e-5)
