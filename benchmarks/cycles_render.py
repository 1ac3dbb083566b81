"""Blender's side of `benchmarks.cycles` and `cycles_lamps`: renders what it is asked for.

Runs in an interpreter of its own that has `bpy`. Each request is one JSON line: the first describes
the scene, each further one a render. Replies are JSON lines as well, on what was standard output at
the start.
"""

from __future__ import annotations

import json
import math
import os
import sys
import tempfile
import time
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix, Vector

RIM = 256  # Corners of what stands for a lamp in the way of another one's light
BEHIND = 1e-4  # Its distance from the lamp


def build(description: dict) -> None:
    """Make floor, boxes, lamps and camera; the matrix of a lone lamp is set with each render."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene

    half = description["floor_half_width"]
    corners = [(x * half, y * half, 0) for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    material = lambertian(description["albedo"])
    add_mesh("floor", corners, [(0, 1, 2, 3)], material)
    for box in description.get("boxes", []):
        add_box(box, material)

    if "lamps" in description:
        for lamp in description["lamps"]:
            add_lamp(lamp).matrix_world = Matrix(lamp["to_world"]) @ Matrix.Rotation(
                math.pi, 4, "X"
            )
        add_blockers(description["lamps"])
    else:
        add_lamp(description)

    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    camera.data.sensor_fit = "HORIZONTAL"
    camera.data.angle = math.radians(description["fov"])
    origin, target = Vector(description["origin"]), Vector(description["target"])
    turn = (target - origin).to_track_quat("-Z", "Y")  # -Z ahead, +Y up, world's Z upright
    camera.matrix_world = Matrix.LocRotScale(origin, turn, None)
    scene.collection.objects.link(camera)
    scene.camera = camera

    configure(scene, description)


def add_mesh(
    name: str, corners: list[tuple], faces: list[tuple], material: bpy.types.Material
) -> bpy.types.Object:
    """Add a mesh to the scene."""
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(corners, [], faces)
    mesh.materials.append(material)
    thing = bpy.data.objects.new(name, mesh)
    bpy.context.scene.collection.objects.link(thing)
    return thing


def add_box(box: dict, material: bpy.types.Material) -> None:
    """Add an upright box that stands on the floor."""
    (x, y), (a, b, c) = box["center"], box["half_sides"]
    corners = [
        (x + i * a, y + j * b, z)
        for z in (0, 2 * c)
        for i, j in ((-1, -1), (1, -1), (1, 1), (-1, 1))
    ]
    sides = [(k, (k + 1) % 4, (k + 1) % 4 + 4, k + 4) for k in range(4)]
    add_mesh("box", corners, [(0, 3, 2, 1), (4, 5, 6, 7), *sides], material)


def add_lamp(description: dict) -> bpy.types.Object:
    """Add an elliptical area lamp that the camera does not see."""
    light = bpy.data.lights.new("lamp", "AREA")
    light.shape = "ELLIPSE"
    light.size, light.size_y = (2 * axis for axis in description["semi_axes"])
    light.spread = math.pi
    area = math.pi * math.prod(description["semi_axes"])
    radiance = description["radiance"]
    light.energy = math.pi * area * max(radiance)  # `color` is kept within 1
    light.color = [value / max(radiance) for value in radiance]
    lamp = bpy.data.objects.new("lamp", light)
    lamp.visible_camera = False
    bpy.context.scene.collection.objects.link(lamp)
    return lamp


def add_blockers(lamps: list[dict]) -> None:
    """Add black ellipses right behind the lamps; in Cycles a lamp itself casts no shadow."""
    corners, faces = [], []
    for lamp in lamps:
        to_world, (a, b) = Matrix(lamp["to_world"]), lamp["semi_axes"]
        faces.append(tuple(range(len(corners), len(corners) + RIM)))
        for k in range(RIM):
            angle = 2 * math.pi * k / RIM
            corners.append(to_world @ Vector((a * math.cos(angle), b * math.sin(angle), -BEHIND)))
    add_mesh("blockers", corners, faces, lambertian(0)).visible_camera = False


def lambertian(albedo: float) -> bpy.types.Material:
    """Diffuse material without roughness."""
    material = bpy.data.materials.new("lambertian")
    material.use_nodes = True
    nodes = material.node_tree.nodes
    nodes.clear()
    diffuse, output = (nodes.new(f"ShaderNode{n}") for n in ("BsdfDiffuse", "OutputMaterial"))
    diffuse.inputs["Color"].default_value = (albedo, albedo, albedo, 1)
    diffuse.inputs["Roughness"].default_value = 0
    material.node_tree.links.new(diffuse.outputs["BSDF"], output.inputs["Surface"])
    return material


def configure(scene: bpy.types.Scene, description: dict) -> None:
    """Direct light alone, box filter, nothing that trades bias for noise; full floats on disk."""
    render, cycles = scene.render, scene.cycles
    render.engine = "CYCLES"
    render.resolution_x = render.resolution_y = description["size"]
    render.resolution_percentage = 100
    render.threads_mode, render.threads = "FIXED", description["threads"]
    render.use_persistent_data = False  # kept data would miss a change of the lamp's estimator
    render.use_compositing = render.use_sequencer = False
    render.image_settings.file_format = "OPEN_EXR"
    render.image_settings.color_depth = "32"
    render.image_settings.exr_codec = "ZIP"

    cycles.device = "CPU"
    cycles.max_bounces = 0
    cycles.pixel_filter_type = "BOX"
    cycles.use_adaptive_sampling = False
    cycles.use_denoising = False
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = 0
    cycles.light_sampling_threshold = 0
    cycles.sampling_pattern = "TABULATED_SOBOL"
    scene.view_layers[0].use_pass_z = False


def place(request: dict) -> None:
    """Choose the estimator, and put a lone lamp at the request's height."""
    lamps = [thing for thing in bpy.data.objects if thing.type == "LIGHT"]
    for lamp in lamps:
        lamp.data.cycles.use_multiple_importance_sampling = request["mis"]
    bpy.context.scene.cycles.use_light_tree = request.get("light_tree", False)
    if "height" in request:
        tilt = Matrix.Rotation(math.radians(-request["tilt"]), 4, "X")  # a lamp shines along its -Z
        lamps[0].matrix_world = Matrix.Translation((0, 0, request["height"])) @ tilt


def read_linear(path: str) -> np.ndarray:
    """Linear RGB of an image file, top row first."""
    image = bpy.data.images.load(path)
    image.colorspace_settings.name = "Non-Color"  # as stored: scene-linear
    width, height = image.size
    pixels = np.empty(width * height * image.channels, np.float32)
    image.pixels.foreach_get(pixels)
    bpy.data.images.remove(image)
    return pixels.reshape(height, width, -1)[::-1, :, :3]


def render(request: dict, path: str) -> dict:
    """Render all seeds of a request; their pictures are stored where it says, if anywhere."""
    place(request)
    scene = bpy.context.scene
    scene.render.filepath = path
    scene.cycles.samples = request["spp"]
    pictures, wall, cpu = [], [], []
    for seed in request["seeds"]:
        scene.cycles.seed = seed
        start, start_cpu = time.perf_counter(), time.process_time()
        bpy.ops.render.render(write_still=True)
        wall.append(time.perf_counter() - start)
        cpu.append(time.process_time() - start_cpu)
        if request.get("output"):
            pictures.append(read_linear(path))
    if request.get("output"):
        np.save(request["output"], np.stack(pictures))
    return {"wall": wall, "cpu": cpu}


def main() -> None:
    """Answer requests until the input ends."""
    replies = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # Blender reports its progress on standard output
    build(json.loads(sys.stdin.readline()))
    print(json.dumps({"version": bpy.app.version_string}), file=replies, flush=True)
    with tempfile.TemporaryDirectory() as folder:
        for line in sys.stdin:
            reply = render(json.loads(line), str(Path(folder) / "picture.exr"))
            print(json.dumps(reply), file=replies, flush=True)


if __name__ == "__main__":
    main()
