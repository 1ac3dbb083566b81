"""Variants, and the scenes and lights that many tests use."""

import drjit as dr
import mi_ellipse  # noqa: F401
import mitsuba as mi
import numpy as np
import pytest
from commands import LAMP, write_scene
from mi_ellipse.geometry import ellipse, ellipsoid
from mi_ellipse.geometry.sphere import Sphere

pytest_plugins = ["comparisons"]

# All variants of the wheel that can run without a GPU
VARIANTS = (
    "llvm_ad_rgb",
    "llvm_ad_spectral",
    "llvm_ad_mono_polarized",
    "llvm_ad_spectral_polarized",
    "scalar_rgb",
    "scalar_spectral",
)

# Width and height of the picture, and the file, of a scene that renders in no time
SMALL_SIZE = 24, 16
SMALL_SCENE = f"""
<scene version="3.0.0">
    <default name="radiance" value="1"/>
    <integrator type="path"><integer name="max_depth" value="2"/></integrator>
    <sensor type="perspective">
        <transform name="to_world"><lookat origin="0,-4,3" target="0,0,0" up="0,0,1"/></transform>
        <film type="hdrfilm">
            <integer name="width" value="{SMALL_SIZE[0]}"/>
            <integer name="height" value="{SMALL_SIZE[1]}"/>
            <rfilter type="box"/>
        </film>
    </sensor>
    <shape type="rectangle"><transform name="to_world"><scale value="3"/></transform></shape>
    <shape type="ellipse">
        <transform name="to_world"><rotate x="1" angle="180"/><translate z="1"/></transform>
        <emitter type="ellipticalarea"><rgb name="radiance" value="$radiance"/></emitter>
    </shape>
</scene>
"""


@pytest.fixture
def llvm_ad_rgb():
    """The variant that most tests run in."""
    mi.set_variant("llvm_ad_rgb")


@pytest.fixture
def scene_file(tmp_path, monkeypatch):
    """The scene of `commands`, in the current directory, which is a temporary one."""
    monkeypatch.chdir(tmp_path)
    return write_scene(tmp_path / "scene.xml", LAMP)


@pytest.fixture(params=["scalar_rgb", "scalar_spectral", "llvm_ad_rgb", "llvm_ad_spectral"])
def variant(request):
    """Each variant of the wheel that a picture could be made with."""
    mi.set_variant(request.param)
    return request.param


def lamp(matrix, sampling=None, radiance=1.0, shape="ellipse", **shape_parameters):
    """Dictionary of a lamp; `matrix` is the 4×4 transform of the unit disk.

    Without `sampling`, it is Mitsuba's `area` on a `disk`.
    """
    emitter = (
        {"type": "area"} if sampling is None else {"type": "ellipticalarea", "sampling": sampling}
    )
    if isinstance(radiance, float):
        radiance = {"type": "rgb", "value": radiance}
    return {
        "type": "disk" if sampling is None else shape,
        "to_world": mi.ScalarAffineTransform4d(np.asarray(matrix, float)),
        "emitter": emitter | {"radiance": radiance},
    } | shape_parameters


def floor_and(lamps: dict, size=16, depth=2, integrator=None):
    """Dictionary of a diffuse floor in z = 0 under lamps, seen from above."""
    to_world = mi.ScalarTransform4f().look_at([0, -4, 4], [0, 0, 0], [0, 0, 1])
    return {
        "type": "scene",
        "integrator": integrator or {"type": "path", "max_depth": depth},
        "sensor": {
            "type": "perspective",
            "fov": 45,
            "to_world": to_world,
            "film": {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}},
            "sampler": {"type": "independent"},
        },
        "floor": {
            "type": "rectangle",
            "to_world": mi.ScalarTransform4f().scale(3),
            "bsdf": {"type": "diffuse"},
        },
    } | lamps


def ellipses(u, w, centre):
    """A batch of lights from arrays of shape (n, 3)."""
    u, w, centre = (np.asarray(v, float) for v in (u, w, centre))
    matrix = np.zeros((len(u), 4, 4))
    for k, column in enumerate((u, w, np.cross(u, w), centre)):
        matrix[:, :3, k] = column
    matrix[:, 3, 3] = 1
    return ellipse.from_transform(mi.Matrix4d(np.moveaxis(matrix, 0, -1)))


def ellipsoids(linear, centre):
    """A batch of ellipsoids from arrays of shape (n, 3, 3), semi-axes as columns, and (n, 3)."""
    matrix = np.zeros((len(linear), 4, 4))
    matrix[:, :3, :3], matrix[:, :3, 3], matrix[:, 3, 3] = linear, centre, 1
    return ellipsoid.from_transform(mi.Matrix4d(np.moveaxis(matrix, 0, -1)))


def spheres(linear, centre):
    """A batch of spheres, as `ellipsoids`; the columns are orthogonal and of one length."""
    linear = np.asarray(linear, float)
    radius = np.linalg.norm(linear[:, :, 0], axis=1)
    axes = (mi.Vector3f((linear[:, :, k] / radius[:, None]).T) for k in range(3))
    place = mi.Point3d(np.asarray(centre, float).T)
    return Sphere(mi.Float64(1 / radius), mi.Float(radius), *axes, place)


def kernels_of(scene):
    """Operations and callables of the kernels that render a scene."""
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
        dr.kernel_history_clear()
        np.array(mi.render(scene, spp=1, seed=3))
        kernels = dr.kernel_history([dr.KernelType.JIT])
    return (
        sum(kernel["operation_count"] for kernel in kernels),
        sum(kernel["ir"].getvalue().count("define ") for kernel in kernels),
    )
