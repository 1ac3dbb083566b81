"""The public functions against quadrature in double precision, from NumPy and from Dr.Jit."""

import mi_ellipse
import mitsuba as mi
import numpy as np
import pytest

from oracles import ellipse as oracle
from oracles.ellipse import (
    MIRROR,
    SHEAR,
    cone,
    irradiance,
    rotation,
    seen_from,
    solid_angle,
    translation,
)

LIGHT = translation(0.3, 0.2, 0.7) @ rotation([1, 0.2, 0], 30) @ SHEAR @ np.diag([1.5, 0.4, 1, 1])

# Single precision resolves the coordinates of these points to 1e-7, and π sin α sin β to a few.
RELATIVE = 3e-6


def random_views(count, seed):
    rng = np.random.default_rng(seed)
    points = rng.uniform([-2, -2, -0.5], [2, 2, 0.5], (count, 3)).astype(np.float32)
    normals = rng.normal(size=(count, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return points, normals.astype(np.float32)


@pytest.mark.parametrize("matrix", [LIGHT, MIRROR @ LIGHT])
def test_numbers_of_a_light(variant, matrix):
    points, _ = random_views(12, 1)
    omega = mi_ellipse.solid_angle(matrix, points)
    tangent = mi_ellipse.tangent_ellipse(matrix, points)
    vector = mi_ellipse.vector_irradiance(matrix, points)
    for k, point in enumerate(points):
        frame, ta, tb = cone(*seen_from(matrix, point))
        assert omega[k] == pytest.approx(solid_angle(ta, tb), rel=RELATIVE)
        assert [tangent.ta[k], tangent.tb[k]] == pytest.approx([ta, tb], rel=RELATIVE)
        for axis, expected in zip(tangent[:3], frame, strict=True):
            # Axes have no sign; that of the cone has.
            assert abs(axis[k] @ expected) == pytest.approx(1, abs=1e-5)
        assert tangent.z[k] @ frame[2] > 0
        expected = np.pi * ta * tb / np.sqrt((1 + ta**2) * (1 + tb**2)) * frame[2]
        assert vector[k] == pytest.approx(expected, rel=RELATIVE, abs=RELATIVE)


def test_irradiance_is_clipped_at_the_horizon(llvm_ad_rgb):
    points, normals = random_views(300, 2)
    result = mi_ellipse.irradiance(LIGHT, points, normals)
    relations = {"above": 0, "below": 0, "divided": 0}
    for point, normal, value in zip(points, normals, result, strict=True):
        u, w, c = seen_from(LIGHT, point)
        normal = np.asarray(normal, float)
        reach = np.hypot(normal @ u, normal @ w)
        relation = "divided" if abs(normal @ c) < reach else "above" if normal @ c > 0 else "below"
        relations[relation] += 1
        # Relative to what the horizon leaves out as well: a thin rest is a difference of the two.
        whole = irradiance(u, w, c, normal) + irradiance(u, w, c, -normal)
        assert abs(value - irradiance(u, w, c, normal)) < RELATIVE * whole
    assert min(relations.values()) > 20


@pytest.mark.parametrize("height", [1e-1, 1e-2, 1e-3])
def test_irradiance_close_to_a_light_that_fills_the_hemisphere(llvm_ad_rgb, height):
    light = translation(0, 0, height) @ np.diag([1.0, 0.3, 1, 1])
    point = np.array([0.3, 0.1, 0], np.float32)
    for tilt in (0, 30, 60, 85):
        normal = (rotation([1, 0.5, 0], tilt) @ [0, 0, 1, 0])[:3].astype(np.float32)
        expected = irradiance(*seen_from(light, point), normal, nodes=200_000)
        assert mi_ellipse.irradiance(light, point, normal) == pytest.approx(expected, rel=1e-5)


def test_shapes_and_types(llvm_ad_rgb):
    points = np.zeros((2, 3, 3), np.float32)
    assert mi_ellipse.solid_angle(LIGHT, points).shape == (2, 3)
    assert mi_ellipse.vector_irradiance(LIGHT, points).shape == (2, 3, 3)
    up = np.array([0, 0, 1], np.float32)
    assert mi_ellipse.irradiance(LIGHT, points, up).shape == (2, 3)

    to_world = mi.ScalarTransform4f(LIGHT)
    result = mi_ellipse.solid_angle(to_world, mi.Point3f([0, 1], 0, 0))
    assert isinstance(result, mi.Float)
    assert np.allclose(result, mi_ellipse.solid_angle(LIGHT, np.array([[0, 0, 0], [1, 0, 0]])))


def test_far_beyond_the_squares_of_single_precision(llvm_ad_rgb):
    """There, a solid angle is the area times the cosine over the squared distance."""
    direction = np.array([0.48, 0.64, 0.6])
    for distance in (1e10, 1e12, 1e15):
        point = (distance * direction).astype(np.float32)
        cross = np.cross(LIGHT[:3, 0], LIGHT[:3, 1])
        expected = np.pi * abs(cross @ direction) / distance**2
        assert mi_ellipse.solid_angle(LIGHT, point) == pytest.approx(expected, rel=1e-6)
        flux = mi_ellipse.vector_irradiance(LIGHT, point)
        np.testing.assert_allclose(flux, -expected * direction, atol=1e-6 * expected)


def test_nothing_comes_from_beyond_single_precision(llvm_ad_rgb):
    far = np.array([[0, 0, 1e20], [1e22, 0, 1]], np.float32)
    up = np.array([0, 0, 1], np.float32)
    assert np.all(mi_ellipse.solid_angle(LIGHT, far) == 0)
    assert np.all(mi_ellipse.vector_irradiance(LIGHT, far) == 0)
    assert np.all(mi_ellipse.irradiance(LIGHT, far, up) == 0)


# ---- Tessellation ----


@pytest.mark.parametrize("segments", [3, 64])
@pytest.mark.parametrize("matrix", [LIGHT, MIRROR @ LIGHT])
def test_mesh_is_the_disk(variant, matrix, segments):
    mesh = mi_ellipse.tessellate(matrix, segments)
    disk = mi.load_dict({"type": "disk", "to_world": mi.ScalarTransform4f(matrix)})
    # The area is exact but for the rounding of single precision.
    assert np.allclose(mesh.surface_area(), disk.surface_area(), rtol=1e-5)
    assert mesh.face_count() == segments

    scenes = [mi.load_dict({"type": "scene", "shape": shape}) for shape in (mesh, disk)]
    local = np.array([[0.2, 0.3], [-0.4, 0.1], [0.0, -0.4]])
    for x, y in local:
        target = (matrix @ [x, y, 0, 1])[:3]
        normal = np.linalg.inv(matrix[:3, :3]).T[:, 2]
        ray = mi.Ray3f(mi.Point3f(target + normal), mi.Vector3f(-normal))
        si, expected = (scene.ray_intersect(ray) for scene in scenes)
        assert np.allclose(si.p, expected.p, atol=1e-5)
        assert np.allclose(si.n, expected.n, atol=1e-5)
        if segments == 64:
            # Linear interpolation over a segment: half a segment in angle, 0.04 % in radius
            assert np.allclose(si.uv, expected.uv, atol=0.6 / segments)


def test_mesh_carries_an_emitter(llvm_ad_rgb):
    props = mi.Properties()
    props["emitter"] = mi.load_dict({"type": "area"})
    assert mi_ellipse.tessellate(LIGHT, props=props).is_emitter()


def test_mesh_refuses_too_few_segments(llvm_ad_rgb):
    with pytest.raises(ValueError, match="segments=2 must be at least 3"):
        mi_ellipse.tessellate(LIGHT, 2)


# ---- One point, and the places where something is 0/0 ----

ON_TOP = np.diag([0.5, 0.3, 1.0, 1.0])
ON_TOP[2, 3] = 1
UP = np.array([0.0, 0, 1])

# On the axis, beside it, in the plane inside and outside, at the rim, above and far away
PLACES = [
    [0, 0, 0],
    [0.3, 0.1, 0],
    [0.1, 0.1, 1],
    [2, 0, 1],
    [0.5, 0, 1],
    [0, 0, 3],
    [40, 30, -200],
]


def test_numbers_of_one_point(variant):
    """A point and a normal without leading axes; closed forms, and quadrature for the second."""
    seen = ON_TOP, np.array([0.3, 0.1, 0])
    u, w, c = oracle.seen_from(*seen)
    _, ta, tb = oracle.cone(u, w, c)
    assert mi_ellipse.solid_angle(*seen) == pytest.approx(oracle.solid_angle(ta, tb), rel=2e-6)
    expected = oracle.irradiance(u, w, c, UP)
    assert mi_ellipse.irradiance(*seen, UP) == pytest.approx(expected, rel=2e-6)
    assert mi_ellipse.vector_irradiance(*seen).shape == (3,)
    assert mi_ellipse.tangent_ellipse(*seen).x.shape == (3,)

    circle = np.eye(4)
    circle[2, 3] = 1
    assert mi_ellipse.irradiance(circle, np.zeros(3), UP) == pytest.approx(np.pi / 2, rel=2e-6)
    on_axis = np.pi * 0.15 / np.sqrt(1.25 * 1.09)
    assert mi_ellipse.irradiance(ON_TOP, np.zeros(3), UP) == pytest.approx(on_axis, rel=2e-6)


def test_every_place_in_every_variant(variant):
    """Python's floats raise an error where Dr.Jit's arrays divide by zero."""
    places = np.array(PLACES, dtype=float)
    normals = np.array([UP, -UP, [1, 0, 0], [0.6, 0, 0.8]])
    for normal in normals:
        together = mi_ellipse.irradiance(ON_TOP, places, normal)
        for place, one in zip(places, together, strict=True):
            assert np.isfinite(one)
            alone = mi_ellipse.irradiance(ON_TOP, place, normal)
            assert alone == pytest.approx(float(one), rel=1e-5, abs=1e-9)
    omega = mi_ellipse.solid_angle(ON_TOP, places)
    assert np.isfinite(omega).all()
    # In its plane a light fills half of all directions inside, and none outside.
    assert omega[2] == pytest.approx(2 * np.pi, rel=1e-5)
    assert omega[3] == pytest.approx(0, abs=1e-9)


@pytest.mark.usefixtures("llvm_ad_rgb")
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((np.eye(4), np.zeros((6, 2))), r"solid_angle: points .* shape \(…, 3\), .* \(6, 2\)"),
        ((np.eye(4), np.zeros(())), r"solid_angle: points .* shape \(…, 3\), .* \(\)"),
        ((np.eye(3), np.zeros(3)), r"to_world: a matrix has the shape \(4, 4\), not \(3, 3\)"),
        ((mi_ellipse.Ellipsoid(np.eye(3)), np.zeros(3)), r"to_world: .* not \(3, 3\)"),
    ],
)
def test_arrays_of_another_shape_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        mi_ellipse.solid_angle(*arguments)
