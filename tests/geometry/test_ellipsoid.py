"""The ellipsoid: axes, cone, points, against NumPy, SciPy and eigen-solves of 60 digits."""

import drjit as dr
import mi_ellipse
import mitsuba as mi
import numpy as np
import pytest
from conftest import ellipses, ellipsoids
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mi_ellipse.geometry import cone, ellipsoid

from oracles import ellipse as oracle
from oracles.ellipse import MIRROR, SHEAR, rotation, translation

pytestmark = pytest.mark.usefixtures("llvm_ad_rgb")

TURN = rotation([1, -2, 0.5], 77)
MATRICES = {
    "sphere": np.eye(4),
    "turned sphere": translation(3, 2, 1) @ TURN @ np.diag([2.0, 2, 2, 1]),
    "in order": np.diag([3.0, 2, 0.5, 1]),
    "in reverse": translation(1, 0, 0) @ np.diag([0.5, 2, 3.0, 1]),
    "prolate": TURN @ np.diag([0.3, 0.3, 2, 1]),
    "oblate": TURN @ np.diag([2, 0.3, 2, 1]),
    "sheared": translation(-1, 0, 5) @ TURN @ SHEAR @ np.diag([1.5, 0.4, 0.7, 1]),
    "mirrored": MIRROR @ TURN @ SHEAR @ np.diag([1.5, 0.4, 0.7, 1]),
    "point reflection": TURN @ SHEAR @ np.diag([-1.0, -0.5, -2, 1]),
    "needle": translation(0.1, 0.2, 0.3) @ TURN @ np.diag([1e-6, 1, 1e-5, 1]),
    "sheared pancake": TURN @ SHEAR @ np.diag([1, 1e-6, 1, 1]),
    "blade": TURN @ np.diag([1, 1e-3, 1e-6, 1]),
}


@pytest.fixture(params=MATRICES, ids=[name.replace(" ", "-") for name in MATRICES])
def matrix(request):
    return MATRICES[request.param]


def rows(v):
    return v.numpy().T.astype(float)


def axes_of(light):
    """Semi-axis vectors as columns, and their lengths, in double precision."""
    lengths = np.array([1, light.ratio[0], light.flatness[0]]) / light.inv_lx[0]
    return np.array([rows(v)[0] for v in (light.ex, light.ey, light.ez)]).T, lengths


# ---- Principal axes ----


def test_principal_axes(matrix):
    """Those of a singular value decomposition."""
    light = ellipsoid.from_transform(mi.ScalarAffineTransform4d(matrix))
    frame, lengths = axes_of(light)
    np.testing.assert_allclose(frame.T @ frame, np.eye(3), atol=1e-14)
    assert np.linalg.det(frame) > 0
    # NumPy's knows each singular value to the rounding of the largest.
    expected = np.linalg.svd(matrix[:3, :3], compute_uv=False)
    np.testing.assert_allclose(lengths, expected, rtol=1e-14, atol=1e-15 * expected[0])
    volume = abs(np.linalg.det(matrix[:3, :3]))
    np.testing.assert_allclose(lengths.prod(), volume, rtol=1e-12)
    np.testing.assert_array_equal(rows(light.centre)[0], matrix[:3, 3])
    np.testing.assert_allclose(light.inv_ratio[0] * light.ratio[0], 1, rtol=1e-7)
    np.testing.assert_allclose(light.inv_flatness[0] * light.flatness[0], 1, rtol=1e-7)


def test_unit_sphere_is_that_before_the_transform(matrix):
    """Axes, lengths and the turn of the parameter together are the transform."""
    light = ellipsoid.from_transform(mi.ScalarAffineTransform4d(matrix))
    frame, lengths = axes_of(light)
    names = ("parameter_x", "parameter_y", "parameter_z")
    turn = np.array([rows(getattr(light, name))[0] for name in names])
    got = (frame * lengths) @ turn.T
    # The parameter is in single precision.
    np.testing.assert_allclose(got, matrix[:3, :3], atol=2e-7 * lengths[0])


def test_axes_from_an_array_of_transforms():
    """Random maps of condition up to 1e6, all at once."""
    rng = np.random.default_rng(1)
    linear = rng.normal(size=(500, 3, 3)) * 10.0 ** rng.uniform(-6, 0, (500, 1, 3))
    light = ellipsoids(linear, np.zeros((500, 3)))
    lengths = np.stack([np.ones(500), light.ratio.numpy(), light.flatness.numpy()], 1)
    lengths /= light.inv_lx.numpy()[:, None]
    expected = np.linalg.svd(linear, compute_uv=False)
    np.testing.assert_allclose(lengths[:, 0], expected[:, 0], rtol=1e-13)
    volume = np.abs(np.linalg.det(linear))
    np.testing.assert_allclose(lengths.prod(1), volume, rtol=1e-11)
    assert np.abs(np.sum(rows(light.ex) * rows(light.ey), 1)).max() < 1e-14


# ---- Cone ----


class Extremes:
    """Lights and points of all strata, the truth, and what the package makes of them."""

    def __init__(self):
        data = oracle.extreme_ellipsoids()
        self.axes, self.centre, self.reference = (data[k] for k in ("axes", "centre", "reference"))
        self.frame, self.ta, self.tb = (data[k] for k in ("frame", "ta", "tb"))
        self.solid_angle = data["solid_angle"]
        self.label = data["labels"][data["stratum"]]
        self.light = ellipsoids(self.axes, self.centre)
        self.view = self.light.seen_from(mi.Point3f(self.reference.T))


@pytest.fixture(scope="module")
def extremes():
    mi.set_variant("llvm_ad_rgb")
    return Extremes()


def test_solid_angle_at_the_extremes(extremes):
    """Within 1e-6 in every stratum, what rounding the input costs aside: measured 5e-7."""
    got = cone.solid_angle(extremes.view.cone).numpy()
    error = np.abs(got / extremes.solid_angle - 1)
    worst = np.argmax(error)
    assert error[worst] < 1e-6, extremes.label[worst]
    assert extremes.view.lit.numpy().all()


def test_frame_at_the_extremes(extremes):
    seen = extremes.view.cone
    x, y, z = (rows(extremes.light.to_world(v)) for v in (seen.x, seen.y, seen.z))
    np.testing.assert_allclose(seen.ta.numpy(), extremes.ta, rtol=1e-6)
    np.testing.assert_allclose(seen.tb.numpy(), extremes.tb, rtol=1e-6)
    truth = extremes.frame[:, 2]
    off_axis = np.linalg.norm(z - truth * np.sum(z * truth, 1)[:, None], axis=1)
    assert off_axis.max() < 3e-7 * 2  # Three axes of single precision are rounded, each thrice
    # A turn about z displaces the rim by (ta² - tb²)/(ta tb) of the smaller half-angle.
    turned = np.abs(np.sum(x * extremes.frame[:, 1], 1))
    ta, tb = extremes.ta, extremes.tb
    assert (turned * (ta - tb) / (ta + tb)).max() < 3e-7
    np.testing.assert_allclose(np.cross(x, y), z, atol=6e-7)


def test_flat_ellipsoid_has_the_cone_of_the_ellipse():
    """A third semi-axis of 1e-9: the planar formulas, from another derivation."""
    rng = np.random.default_rng(8)
    u, w = rng.normal(size=(2, 300, 3))
    n = np.cross(u, w)
    centre = rng.normal(size=(300, 3)) * 2
    flat = ellipsoids(np.stack([u, w, 1e-9 * n], 2), centre)
    planar = ellipses(u, w, centre)
    here = mi.Point3f(0, 0, 0)
    solid, plane = flat.seen_from(here).cone, planar.seen_from(here).cone
    np.testing.assert_allclose(solid.ta.numpy(), plane.ta.numpy(), rtol=2e-6)
    np.testing.assert_allclose(solid.tb.numpy(), plane.tb.numpy(), rtol=2e-6, atol=1e-7)
    z = rows(flat.to_world(solid.z))
    np.testing.assert_allclose(z, rows(planar.to_world(plane.z)), atol=2e-6)


def test_sphere_is_seen_as_a_cap():
    """sin α = r / distance, Ω = 2π (1 - cos α)."""
    rng = np.random.default_rng(9)
    radius, centre = rng.uniform(0.1, 2, 200), rng.normal(size=(200, 3)) * 3
    light = ellipsoids(radius[:, None, None] * np.eye(3), centre)
    view = light.seen_from(mi.Point3f(0, 0, 0))
    distance = np.linalg.norm(centre, axis=1)
    outside = distance > radius
    np.testing.assert_array_equal(view.lit.numpy(), outside)
    sine2 = (radius / distance)[outside] ** 2
    expected = 2 * np.pi * sine2 / (1 + np.sqrt(1 - sine2))
    got = cone.solid_angle(view.cone).numpy()[outside]
    # The centre is the input in double precision here; near the surface its rounding is enlarged.
    np.testing.assert_allclose(got, expected, rtol=1e-6)


@settings(
    max_examples=100,
    deadline=None,
    derandomize=True,
    database=None,
    suppress_health_check=[HealthCheck.too_slow],  # A busy machine is no failure
)
@given(
    lengths=st.tuples(*[st.floats(-3, 0).map(lambda e: 10**e)] * 3),
    direction=st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda v: np.linalg.norm(v) > 0.1),
    height=st.floats(-3, 3).map(lambda e: 10**e),
    turn=st.floats(-180, 180),
)
def test_tangent_rays_are_on_the_rim_of_the_cone(lengths, direction, height, turn):
    """The ray along a rim direction touches the ellipsoid: its discriminant vanishes."""
    mi.set_variant("llvm_ad_rgb")
    axes = rotation([1, 2, 3], turn)[:3, :3] * np.array(lengths)
    q = np.array(direction) / np.linalg.norm(direction)
    normal = np.linalg.inv(axes).T @ q
    point = np.float32(axes @ q + height * normal / np.linalg.norm(normal)).astype(float)
    light = ellipsoids([axes], np.zeros((1, 3)))
    view = light.seen_from(mi.Point3f(point[:, None]))
    seen = view.cone
    frame = [rows(light.to_world(v))[0] for v in (seen.x, seen.y, seen.z)]
    t = np.linspace(0, 2 * np.pi, 32, endpoint=False)
    rim = frame[2] + np.outer(np.cos(t) * seen.ta[0], frame[0])
    rim += np.outer(np.sin(t) * seen.tb[0], frame[1])
    o, d = np.linalg.solve(axes, point), np.linalg.solve(axes, rim.T).T
    # Distance of the ray's line from the centre of the unit sphere; where it touches, that is 1.
    nearest = np.linalg.norm(np.cross(o, d), axis=1) / np.linalg.norm(d, axis=1)
    # A rounding of the rim is enlarged by the distance on the unit sphere, and by the ratios.
    tolerance = 2e-6 * (1 + np.linalg.norm(o)) * max(lengths) / min(lengths)
    assert np.abs(nearest - 1).max() < tolerance


# ---- Inside and outside ----


def test_inside_is_dark(matrix):
    """Points at .999 and 1.001 of the surface, where coordinates of single precision resolve it."""
    lengths = np.linalg.svd(matrix[:3, :3], compute_uv=False)
    light = ellipsoid.from_transform(mi.ScalarAffineTransform4d(matrix))
    q = np.random.default_rng(3).normal(size=(100, 3))
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    if lengths[2] < 1e-3 * lengths[0]:
        q[:] = 0  # Only the centre is sure to stay inside
    for scale, outside in ((0.999, False), (1.001, True)):
        points = scale * q @ matrix[:3, :3].T + matrix[:3, 3]
        if outside and not q.any():
            continue
        view = light.seen_from(mi.Point3f(points.T))
        assert np.all(view.lit.numpy() == outside)
        assert np.all(view.outside.numpy() == outside)


# ---- Points ----


def test_hit_is_the_nearer_intersection(extremes):
    """Of directions to the interior of the cone, against the quadratic in double precision."""
    rng = np.random.default_rng(2)
    count = len(extremes.ta)
    direction = np.empty((count, 3))
    for k in range(count):
        local, _ = oracle.on_cone(extremes.ta[k], extremes.tb[k], rng.random(), 0.9 * rng.random())
        direction[k] = local @ extremes.frame[k]
    got = extremes.light.hit(extremes.view, extremes.light.to_light(mi.Vector3f(direction.T)))

    back = np.linalg.inv(extremes.axes)
    offset = extremes.reference - extremes.centre
    o = np.einsum("nij,nj->ni", back, offset)
    d = np.einsum("nij,nj->ni", back, direction)
    moment = np.cross(o, d)
    a = np.sum(d * d, 1)
    disc = a - np.sum(moment * moment, 1)
    assert (disc > 0).all()
    foot = np.cross(d, moment) / a[:, None]
    q = foot - d * (np.sqrt(disc) / a)[:, None]
    p = np.einsum("nij,nj->ni", extremes.axes, q) + extremes.centre
    distance = np.linalg.norm(p - extremes.reference, axis=1)

    # What rounding the direction by 1e-7 moves the point by: the slope at the surface
    slope = np.linalg.norm(d, axis=1) / np.sqrt(disc)
    size = distance + np.abs(extremes.centre).max(1) + np.linalg.norm(extremes.axes, axis=(1, 2))
    error = np.linalg.norm(rows(got.p) - p, axis=1) / size
    thin = np.linalg.norm(back, axis=(1, 2)) * distance
    assert np.quantile(error / (1 + slope), 0.99) < 1e-6
    assert (error < 3e-7 * (1 + slope) * (1 + thin)).all()
    normal = np.einsum("nji,nj->ni", back, q)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    fair = ~np.isin(extremes.label, ["needle", "beyond the tip", "pancake", "blade", "1e6 away"])
    away = np.linalg.norm(rows(got.n) - normal, axis=1)
    assert (away < 1e-4 * (1 + slope))[fair].all()


def test_point_normal_and_uv_are_those_of_mitsubas_sphere():
    """Under a turn, where rays meet Mitsuba's own."""
    matrix = translation(0.3, 0.2, 0.1) @ TURN @ np.diag([0.7, 0.7, 0.7, 1])
    to_world = mi.ScalarTransform4f(matrix)
    scene = mi.load_dict({"type": "scene", "sphere": {"type": "sphere", "to_world": to_world}})
    light = ellipsoid.from_transform(mi.ScalarAffineTransform4d(matrix))
    rng = np.random.default_rng(4)
    origin = rng.normal(size=(500, 3)) * 3 + 4
    target = matrix[:3, 3] + 0.4 * rng.uniform(-1, 1, (500, 3))
    d = target - origin
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    ray = mi.Ray3f(mi.Point3f(origin.T), mi.Vector3f(d.T))
    si = scene.ray_intersect(ray)
    assert si.is_valid().numpy().all()
    view = light.seen_from(ray.o)
    got = light.hit(view, light.to_light(ray.d))
    np.testing.assert_allclose(rows(got.p), rows(si.p), atol=2e-5)
    np.testing.assert_allclose(rows(got.n), rows(si.n), atol=3e-5)
    np.testing.assert_allclose(got.distance.numpy(), si.t.numpy(), rtol=3e-6)
    difference = rows(got.uv) - rows(si.uv)
    difference[:, 0] -= np.round(difference[:, 0])
    near_pole = np.minimum(rows(si.uv)[:, 1], 1 - rows(si.uv)[:, 1]) < 0.05
    assert np.abs(difference[~near_pole]).max() < 1e-4


def test_surface_density_is_that_of_the_surface(matrix):
    """Over the surface its integral is one, and points of the surface follow it."""
    light = ellipsoid.from_transform(mi.ScalarAffineTransform4d(matrix))
    u = np.random.default_rng(6).random((2, 200_000), dtype=np.float32)
    p, n, _ = light.sample_surface(mi.Point2f(u))
    linear = matrix[:3, :3]
    q = (rows(p) - matrix[:3, 3]) @ np.linalg.inv(linear).T
    rounding = 2e-7 * np.abs(rows(p)).max() * np.linalg.norm(np.linalg.inv(linear))
    assert np.abs(np.linalg.norm(q, axis=1) - 1).max() < 1e-6 + rounding
    # Area of the image of an element of the unit sphere: det |A⁻ᵀ q|
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    normal = q @ np.linalg.inv(linear)
    stretch = abs(np.linalg.det(linear)) * np.linalg.norm(normal, axis=1)
    if rounding < 1e-3:
        density = light.surface_pdf(p).numpy()
        np.testing.assert_allclose(density, 1 / (4 * np.pi * stretch), rtol=1e-5 + 10 * rounding)
        away = rows(n) - normal / np.linalg.norm(normal, axis=1, keepdims=True)
        assert np.abs(away).max() < 1e-5 + 10 * rounding
    # Uniform on the unit sphere: mean 0 and second moments ⅓, six standard errors
    q = q @ np.linalg.svd(linear)[2].T
    assert np.abs(q.mean(0)).max() < 6 * np.sqrt(1 / 3 / len(q))
    assert np.abs((q**2).mean(0) - 1 / 3).max() < 6 * np.sqrt(4 / 45 / len(q))


# ---- Measures ----


def test_measures_of_an_ellipsoid():
    """NumPy and Dr.Jit in, the same out; irradiance by quadrature over the cone."""
    matrix = MATRICES["sheared"]
    light = mi_ellipse.Ellipsoid(matrix)
    rng = np.random.default_rng(7)
    q = rng.normal(size=(24, 3))
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    points = np.float32(rng.uniform(1.05, 4, (24, 1)) * q @ matrix[:3, :3].T + matrix[:3, 3])
    normals = np.float32(q[::-1])
    omega = mi_ellipse.solid_angle(light, points)
    vector = mi_ellipse.vector_irradiance(light, points)
    clipped = mi_ellipse.irradiance(light, points, normals)
    tangent = mi_ellipse.tangent_ellipse(light, points)
    for k, point in enumerate(points.astype(float)):
        c = matrix[:3, 3] - point
        frame, ta, tb = oracle.solid_cone(matrix[:3, :3], c)
        d, weight = oracle.cone_grid(ta, tb)
        # Single precision resolves the coordinates to 3e-7 at this distance from the origin.
        assert omega[k] == pytest.approx(weight.sum(), rel=1e-5)
        assert tangent.ta[k] == pytest.approx(ta, rel=1e-5)
        np.testing.assert_allclose(vector[k], weight @ d @ frame, atol=1e-5 * omega[k])
        expected = oracle.solid_irradiance(matrix[:3, :3], c, normals[k])
        assert clipped[k] == pytest.approx(expected, abs=2e-5 * float(omega[k]))

    to_world = mi.ScalarAffineTransform4d(matrix)
    jit = mi_ellipse.solid_angle(mi_ellipse.Ellipsoid(to_world), mi.Point3f(points.T))
    np.testing.assert_array_equal(jit.numpy(), omega)


def test_measures_inside_are_zero(variant):
    light = mi_ellipse.Ellipsoid(np.diag([2.0, 1, 0.5, 1]))
    points = np.float32([[0, 0, 0], [1.9, 0, 0], [0, 0, 0.49], [0.1, 0.2, 0.3]])
    up = np.float32([0, 0, 1])
    assert np.all(mi_ellipse.solid_angle(light, points) == 0)
    assert np.all(mi_ellipse.vector_irradiance(light, points) == 0)
    assert np.all(mi_ellipse.irradiance(light, points, up) == 0)


def test_nothing_comes_from_beyond_single_precision():
    light = mi_ellipse.Ellipsoid(np.diag([1.0, 0.5, 0.2, 1]))
    far = np.array([[0, 0, 1e20], [1e22, 0, 1]], np.float32)
    assert np.all(mi_ellipse.solid_angle(light, far) == 0)
    near_limit = np.array([0, 0, 1e15], np.float32)
    expected = np.pi * 0.5 / 1e30
    assert mi_ellipse.solid_angle(light, near_limit) == pytest.approx(expected, rel=1e-6)


# ---- Mesh ----


@pytest.mark.parametrize("segments", [5, 40, 100])
@pytest.mark.parametrize("name", ["sheared", "mirrored"])
def test_mesh_is_inside_the_ellipsoid(name, segments):
    """Closed, outwards, corners on the surface, and no more inside than it says."""
    matrix = MATRICES[name]
    mesh = mi_ellipse.tessellate(mi_ellipse.Ellipsoid(matrix), segments)
    points = np.array(mesh.vertex_positions_buffer()).reshape(-1, 3)
    faces = np.array(mesh.faces_buffer()).reshape(-1, 3)
    edges = segments if segments < 100 else 160  # The next that it can do
    assert len(faces) == 20 * (edges / 5) ** 2
    q = (points - matrix[:3, 3]) @ np.linalg.inv(matrix[:3, :3]).T
    np.testing.assert_allclose(np.linalg.norm(q, axis=1), 1, atol=1e-5)
    a, b, c = (points[faces[:, k]] - matrix[:3, 3] for k in range(3))
    outward = np.cross(b - a, c - a)
    assert (np.sum(outward * (a + b + c), 1) > 0).all()
    a, b, c = (q[faces[:, k]] for k in range(3))
    across = np.cross(b - a, c - a)
    inside = 1 - np.abs(np.sum(across * a, 1)) / np.linalg.norm(across, axis=1)
    # Of an icosahedron itself, 1 - .795; the bound holds from 10 segments on.
    assert inside.max() < max(7.3 / edges**2, 1e-5) or edges == 5
    corners = np.unique(np.round(q, 4), axis=0, return_inverse=True)[1].reshape(-1)[faces]
    sides = np.sort(np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]]), 1)
    assert (np.unique(sides, axis=0, return_counts=True)[1] == 2).all()


def test_mesh_has_the_parameterisation_of_the_sphere():
    """Rays to its faces: uv within a face's linear interpolation of it, away from the poles."""
    shapes = {
        "mesh": mi_ellipse.tessellate(mi_ellipse.Ellipsoid(np.eye(4)), 160),
        "sphere": {"type": "sphere"},
    }
    rng = np.random.default_rng(3)
    q = rng.normal(size=(2000, 3))
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    ray = mi.Ray3f(mi.Point3f(2 * q.T), mi.Vector3f(-q.T))
    uv = {}
    for name, shape in shapes.items():
        scene = mi.load_dict({"type": "scene", "shape": shape})  # Lives until the rays are traced
        uv[name] = rows(scene.ray_intersect(ray).uv)
    difference = uv["mesh"] - uv["sphere"]
    difference[:, 0] -= np.round(difference[:, 0])
    away = np.abs(q[:, 2]) < 0.95
    # Squared edge over 8 times the curvature, 1e-4 of a turn
    assert np.abs(difference[away]).max() < 3e-4
    assert np.abs(difference[:, 1]).max() < 3e-4 * 3


def test_mesh_refuses_too_few_segments():
    with pytest.raises(ValueError, match="segments=4 must be at least 5"):
        mi_ellipse.tessellate(mi_ellipse.Ellipsoid(np.eye(4)), 4)


def test_scalar_variants_at_degenerate_views():
    """Python's floats raise an error where Dr.Jit's arrays divide by zero."""
    mi.set_variant("scalar_rgb")
    for lengths in ([1, 1, 1], [1, 1, 0.5], [1, 0.5, 0.5], [0.5, 1, 0.2]):
        to_world = mi.ScalarAffineTransform4d(np.diag([*lengths, 1.0]))
        light = ellipsoid.from_transform(to_world)
        for point in np.concatenate([1.5 * np.eye(3), [[1, 1, 0], [1, 1, 1], [0, 0, 0]]]):
            view = light.seen_from(mi.Point3f(point))
            seen = view.cone
            assert view.lit == bool(np.any(point))
            hit = light.hit(view, mi.Vector3f(seen.z))
            if view.lit:
                assert np.isfinite([*seen.x, *seen.y, *seen.z, seen.ta, seen.tb]).all()
                assert np.isfinite([*hit.p, *hit.n, *hit.uv, hit.distance]).all()
                assert dr.norm(hit.p - mi.Point3f(point)) == pytest.approx(hit.distance, rel=1e-5)
