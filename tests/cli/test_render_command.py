"""`mi-ellipse render` end to end."""

import dataclasses
import json
import os
import re
import signal
import subprocess
import sys
import time

import drjit as dr
import mi_ellipse
import mitsuba as mi
import numpy as np
import pytest
from commands import HEIGHT, LAMP, SCENE, WIDTH, files, invoke, read, samples, write_scene
from mi_ellipse.files import images
from mi_ellipse.rendering import job, passes, provenance
from mi_ellipse.rendering.provenance import scene_digest
from mi_ellipse.rendering.scene import load_scene
from mi_ellipse.sampling import STRATEGIES

STRATEGY = '<string name="sampling" value="$sampling"/>'

pytestmark = pytest.mark.usefixtures("llvm_ad_rgb")


# ---- What a render leaves ----


def test_render_writes_a_picture_with_the_settings_that_made_it(scene_file):
    result = invoke(
        "render", scene_file, "-o", "out.exr", "--spp", 8, "--seed", 2**32 - 1,
        "--sampling", "solid_angle", "-D", "sampling=nonsense", "-D", "sampler=independent",
    )  # fmt: skip
    assert result.exit_code == 0, result.output
    assert "8 spp, 1 pass" in result.stdout

    assert read("out.exr").shape == (HEIGHT, WIDTH, 3)
    assert read("out.png").dtype == np.uint8
    properties = mi.Bitmap("out.exr").metadata()
    metadata = {name: properties[name] for name in properties}
    assert float(metadata.pop("render_seconds")) > 0
    assert float(metadata.pop("png_exposure_stops")) * 2 % 1 == 0
    assert json.loads(metadata.pop("parameters")) == {
        "sampling": "nonsense",
        "sampler": "independent",
    }
    expected = {
        "scene": str(scene_file),
        "scene_digest": scene_digest(
            scene_file, {"sampling": "nonsense", "sampler": "independent"}
        ),
        "spp": "8",
        "passes": "1",
        "seed": str(2**32 - 1),
        "variant": "llvm_ad_rgb",
        "sampling": "solid_angle",
        "grouping": "yes",
        "machine": provenance.machine(),
        "convert_lamps": "no",
        "mi_ellipse_version": mi_ellipse.__version__,
        "mitsuba_version": mi.__version__,
        "drjit_version": dr.__version__,
    }
    assert expected.items() <= metadata.items()


def test_defaults(scene_file):
    assert invoke("render", scene_file).exit_code == 0
    assert files(scene_file.parent) == ["scene.exr", "scene.png", "scene.xml"]
    metadata = mi.Bitmap("scene.exr").metadata()
    assert (metadata["spp"], metadata["seed"], metadata["parameters"]) == ("4", "0", "{}")
    assert metadata["sampling"] == "as in the scene"


def test_render_is_the_picture_of_mitsuba(scene_file):
    invoke("render", scene_file, "--spp", 16, "--seed", 7)
    expected = mi.render(mi.load_file(str(scene_file)), spp=16, seed=7).numpy()
    # Not to the bit: threads add up the samples in another order each time.
    np.testing.assert_allclose(read("scene.exr"), expected, rtol=1e-5)
    invoke("render", scene_file, "--spp", 16, "--seed", 8)
    assert np.abs(read("scene.exr") / expected - 1).max() > 0.01


def test_half_precision(scene_file):
    assert invoke("render", scene_file, "--half").exit_code == 0
    bitmap = mi.Bitmap("scene.exr")
    assert bitmap.component_format() == mi.Struct.Type.Float16
    single = mi.render(mi.load_file(str(scene_file)), spp=4, seed=0).numpy()
    np.testing.assert_allclose(np.array(bitmap), single, rtol=2**-10)


def test_picture_too_bright_for_half_precision_is_kept_in_single(scene_file):
    radiance = '<rgb name="radiance" value="1000000"/><string name="sampling"'
    scene_file.write_text(scene_file.read_text().replace('<string name="sampling"', radiance))
    result = invoke("render", scene_file, "--half")
    assert result.exit_code == 0
    assert "single precision: half precision ends at 65504" in " ".join(result.stderr.split())
    assert 65504 < read("scene.exr").max() < np.inf


@pytest.mark.parametrize("variant", ["scalar_rgb", "llvm_ad_spectral"])
def test_other_variants(scene_file, variant):
    reference = mi.render(mi.load_file(str(scene_file)), spp=256).numpy()
    assert invoke("render", scene_file, "--variant", variant, "--spp", 64).exit_code == 0
    assert mi.Bitmap("scene.exr").metadata()["variant"] == variant
    assert read("scene.exr").mean() == pytest.approx(reference.mean(), rel=0.03)


def test_channels_keep_their_names(scene_file):
    text = scene_file.read_text()
    text = text.replace(
        '<integrator type="path">',
        '<integrator type="aov"><string name="aovs" value="d:depth,n:sh_normal"/>'
        '<integrator type="path" name="colour">',
    ).replace("</integrator>", "</integrator></integrator>")
    scene_file.write_text(text)
    assert invoke("render", scene_file).exit_code == 0

    bitmap = mi.Bitmap("scene.exr")
    names = [field.name for field in bitmap.struct_()]
    assert sorted(names) == ["B", "G", "R", "d.T", "n.X", "n.Y", "n.Z"]
    centre = np.array(bitmap)[HEIGHT // 2, WIDTH // 2]
    assert centre[names.index("d.T")] == pytest.approx(5, rel=0.1)
    assert centre[names.index("n.Z")] == pytest.approx(1, rel=0.01)


@pytest.mark.parametrize("pixel_format", ["luminance", "rgba"])
def test_png_of_other_pixel_formats(scene_file, pixel_format):
    assert invoke("render", scene_file, "-D", f"pixel_format={pixel_format}").exit_code == 0
    png = read("scene.png")
    assert png.shape == (HEIGHT, WIDTH, 3)
    assert png.max() > 100


# ---- The strategy from outside ----


def test_sampling_reaches_every_lamp(scene_file):
    (scene_file.parent / "more.xml").write_text(
        f'<scene version="3.0.0">{LAMP.replace("$sampling", "nonsense")}</scene>'
    )
    write_scene(scene_file, LAMP + LAMP + '<include filename="more.xml"/>')
    result = invoke("render", scene_file, "--sampling", "solid_angle", "-D", "sampling=also wrong")
    assert result.exit_code == 0, result.stderr
    assert len(load_scene(scene_file, sampling="solid_angle").emitters()) == 3


# ---- Errors ----


def assert_fails_in_one_line(result, *words):
    assert result.exit_code == 1
    lines = result.stderr.strip().splitlines()
    assert len(lines) == 1, result.stderr
    assert lines[0].startswith("mi-ellipse: ")
    for word in words:
        assert word in lines[0]
    assert result.stdout == ""


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--variant", "llvm_rgb"], ["unsupported variant", "llvm_rgb", "llvm_ad_rgb"]),
        (["--sampling", "nonsense"], ["nonsense", *STRATEGIES]),
        (
            ["-D", "width=3", "-D", "sampler=independent"],
            ["no parameter for width=3;", "known are: sampler, pixel_format, sampling"],
        ),
        (["--sensor", "left"], ['sensor="left"', "numbers 0 to 0"]),
        (["--sensor", "1"], ['sensor="1"', "numbers 0 to 0"]),
        (["--integrator", "nonsense"], ['integrator="nonsense"', "path", "prb"]),
        (["--integrator", "disk"], ['integrator="disk"', "path", "prb"]),
        (["--integrator", "aov"], ['integrator="aov"', "the scene must describe it"]),
        (["-o", "nowhere/out.exr"], ["cannot write nowhere/out.exr"]),
        (["-o", "folder.exr"], ["cannot write folder.exr", "folder"]),
        (["-o", "blocked.exr"], ["cannot write blocked.png"]),
        (["-o", "out.png"], ["out.png", ".exr"]),
        (["-o", ""], ["OpenEXR"]),
        (["--spp", "99999999999999999999"], ["spp=99999999999999999999", "4294967295"]),
    ],
)
def test_wrong_options(scene_file, options, words):
    (scene_file.parent / "folder.exr").mkdir()
    (scene_file.parent / "blocked.png").mkdir()
    before = files(scene_file.parent)
    assert_fails_in_one_line(invoke("render", scene_file, *options), *words)
    assert files(scene_file.parent) == before


@pytest.mark.skipif(os.name != "posix", reason="needs a folder that nobody can write to")
def test_output_is_tried_before_rendering(scene_file, monkeypatch):
    monkeypatch.setattr(job, "parse_scene", lambda *_: pytest.fail("began to work"))
    assert_fails_in_one_line(invoke("render", scene_file, "-o", "/proc/out.exr"), "/proc/out.exr")


@pytest.mark.parametrize("name", [".", ""])
def test_scene_that_is_a_folder(scene_file, name):
    assert_fails_in_one_line(invoke("render", name), ". is a folder", "XML file")


@pytest.mark.parametrize(
    ("before", "after", "options", "words"),
    [
        (f'value="{WIDTH}"', 'value="0"', [], ["scene.xml (line", "width=0", "1 pixel"]),
        (f'value="{WIDTH}"', 'value="400000"', ["--spp", 2**32 - 1], ["spp=4294967295", "passes"]),
        ('<string name="sampling"', '<rgb name="radiance" value="1,-2,1"/>\\g<0>', [],
         ["radiance=1, -2, 1", "not negative"]),
        ('<string name="sampling"', '<rgb name="radiance" value="nan"/>\\g<0>', [],
         ["radiance=nan", "finite"]),
    ],
)  # fmt: skip
def test_scene_that_cannot_be_rendered(scene_file, before, after, options, words):
    scene_file.write_text(re.sub(before, after, scene_file.read_text(), count=1))
    assert_fails_in_one_line(invoke("render", scene_file, *options), *words)
    assert files(scene_file.parent) == ["scene.xml"]


@pytest.mark.skipif(dr.has_backend(dr.JitBackend.CUDA), reason="needs a machine without a GPU")
def test_variant_that_needs_a_gpu(scene_file):
    result = invoke("render", scene_file, "--variant", "cuda_ad_rgb")
    assert_fails_in_one_line(result, "variant=cuda_ad_rgb", "GPU", "llvm")
    assert mi.variant() == "llvm_ad_rgb"


def test_words_of_mitsuba_are_plain_lines_on_stderr(scene_file, monkeypatch):
    original = passes.render

    def warning(*arguments):
        mi.set_log_level(mi.LogLevel.Warn)  # Other tests are content with errors.
        mi.Log(mi.LogLevel.Warn, "two\nlines")
        return original(*arguments)

    monkeypatch.setattr(passes, "render", warning)
    result = invoke("render", scene_file)
    said = [line for line in result.stderr.splitlines() if "two lines" in line]
    assert len(said) == 1
    assert said[0].startswith("WARN: ")
    assert "\x1b" not in result.output
    assert "two" not in result.stdout


def test_missing_scene_file(scene_file):
    assert_fails_in_one_line(invoke("render", "nope.xml"), "nope.xml", "not found")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('<scene version="3.0.0"><shape></scene>', ["mismatch", "line 1"]),
        ("", ["scene.xml"]),
        ('<shape version="3.0.0" type="disk"/>', ["no <scene>"]),
        ('<scene version="3.0.0"><shape type="blob"/></scene>', ['"blob" not found']),
        (
            '<scene version="3.0.0"><shape type="ply">'
            '<string name="filename" value="gone.ply"/></shape></scene>',
            ["gone.ply", "not found"],
        ),
        ('<scene version="3.0.0"/>', ["sensor"]),
    ],
)
def test_malformed_scene(scene_file, text, words):
    scene_file.write_text(text)
    assert_fails_in_one_line(invoke("render", scene_file), *words)


def test_lamp_without_shape(scene_file):
    write_scene(scene_file, LAMP + '<emitter type="ellipticalarea"/>')
    assert_fails_in_one_line(invoke("render", scene_file), "scene.xml (line", "no shape")


def test_lamp_without_shape_in_an_included_file(scene_file):
    (scene_file.parent / "more.xml").write_text(
        '<scene version="3.0.0"><emitter type="ellipticalarea"/></scene>'
    )
    write_scene(scene_file, LAMP + '<include filename="more.xml"/>')
    assert_fails_in_one_line(invoke("render", scene_file), "more.xml (line", "no shape")


def test_lamp_that_a_shape_refers_to_is_fine(scene_file):
    write_scene(
        scene_file,
        '<emitter type="ellipticalarea" id="lamp"/><shape type="disk"><ref id="lamp"/></shape>',
    )
    assert invoke("render", scene_file).exit_code == 0


def test_sampling_without_a_lamp(scene_file):
    write_scene(scene_file, '<emitter type="constant"/>')
    result = invoke("render", scene_file, "--sampling", "solid_angle")
    assert_fails_in_one_line(result, "solid_angle", 'no "ellipticalarea"')


@pytest.mark.parametrize(
    ("lamps", "words"),
    [
        (LAMP.replace("$sampling", "nonsense"), ["scene.xml (line", "nonsense", *STRATEGIES]),
        (LAMP.replace('"disk"', '"rectangle"'), ["ellipticalarea", "Rectangle"]),
    ],
)
def test_error_inside_a_plugin_shows_its_cause(scene_file, lamps, words):
    write_scene(scene_file, lamps)
    # In a process of its own: a lamp from a failed scene may outlive it for a while, and every
    # living emitter is part of every render.
    process = subprocess.run(
        [sys.executable, "-m", "mi_ellipse", "render", "scene.xml"], capture_output=True, text=True
    )
    assert process.returncode == 1
    assert process.stderr.startswith("mi-ellipse: ")
    assert process.stderr.count("\n") == 1
    for word in words:
        assert word in process.stderr
    assert files(scene_file.parent) == ["scene.xml"]


def test_invalid_pixels_are_announced(scene_file, monkeypatch):
    original = passes.render

    def broken(*arguments):
        rendering = original(*arguments)
        image = rendering.image.copy()
        image[0, 0, 1], image[2, 3, :] = np.nan, np.inf
        return dataclasses.replace(rendering, image=image)

    monkeypatch.setattr(passes, "render", broken)
    result = invoke("render", scene_file)
    assert "WARNING: 2 pixels are NaN or infinite" in result.stderr
    assert result.exit_code == 0
    assert np.isnan(read("scene.exr")[0, 0, 1])
    assert read("scene.png")[2, 3].tolist() == [0, 0, 0]


# ---- What is announced ----


@pytest.mark.parametrize(("sampler", "warns"), [("independent", False), ("multijitter", True)])
def test_loss_of_stratification_is_announced(scene_file, monkeypatch, sampler, warns):
    plan = passes.plan_passes
    monkeypatch.setattr(
        passes, "plan_passes", lambda scene, spp=None, *_, **__: plan(scene, spp, samples(4))
    )
    result = invoke("render", scene_file, "--spp", 16, "-D", f"sampler={sampler}")
    assert "16 spp, 4 passes" in result.stdout
    assert ("Rendering in 4 passes" in result.stderr) == warns


def test_rounded_sample_count_is_announced(scene_file):
    result = invoke("render", scene_file, "--spp", 5, "-D", "sampler=stratified")
    assert "9 samples per pixel of 5" in " ".join(result.stderr.split())
    assert "9 spp" in result.stdout
    assert mi.Bitmap("scene.exr").metadata()["spp"] == "9"


# ---- An older good file ----


def test_failed_write_leaves_the_old_file(scene_file):
    assert invoke("render", scene_file).exit_code == 0
    before = {name: (scene_file.parent / name).read_bytes() for name in files(scene_file.parent)}
    assert list(before) == ["scene.exr", "scene.png", "scene.xml"]
    # A limit on the size of files cuts the write off, like a full disk.
    code = (
        "import resource, sys; from mi_ellipse import cli; from mi_ellipse.files import images\n"
        "write = images.write_exr\n"
        "def limited(*arguments):\n"
        "    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))\n"
        "    write(*arguments)\n"
        "images.write_exr = limited\n"
        "sys.argv = 'mi-ellipse render scene.xml --seed 1'.split()\n"
        "cli.main()"
    )
    process = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert process.returncode == 1
    assert process.stderr.startswith("mi-ellipse: ")
    assert "too large" in process.stderr
    after = {name: (scene_file.parent / name).read_bytes() for name in files(scene_file.parent)}
    assert after == before


def test_interrupt_during_a_pass_ends_the_process_at_once(scene_file):
    (scene_file.parent / "scene.exr").write_text("earlier")
    # Announce that loading is over, then render for minutes.
    code = (
        "import sys; from mi_ellipse import cli; from mi_ellipse.rendering import passes\n"
        "original = passes.render\n"
        "def announced(*a): print('rendering', flush=True); return original(*a)\n"
        "passes.render = announced\n"
        "sys.argv = ['mi-ellipse', 'render', 'scene.xml', '--spp', '10000000']\n"
        "cli.main()"
    )
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as child:
        assert child.stdout.readline() == "rendering\n"
        time.sleep(1)  # into the kernel
        child.send_signal(signal.SIGINT)
        try:
            assert child.wait(timeout=5) == -signal.SIGINT
        finally:
            child.kill()
    assert files(scene_file.parent) == ["scene.exr", "scene.xml"]
    assert (scene_file.parent / "scene.exr").read_text() == "earlier"


# ---- Ctrl-C with --keep-partial ----


def start(*arguments):
    """Start a render of many passes of 4 samples per pixel, and wait for the first one."""
    code = (
        "import sys; from mi_ellipse import cli; from mi_ellipse.rendering import passes\n"
        f"passes.SHORT_PASS['llvm'] = {samples(4)}\n"
        "original = passes._timed\n"
        "def announced(*a): result = original(*a); print('pass', flush=True); return result\n"
        "passes._timed = announced\n"
        f"sys.argv = {['mi-ellipse', 'render', 'scene.xml', '--keep-partial', *arguments]}\n"
        "cli.main()"
    )
    child = subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert child.stdout.readline() == "pass\n"
    return child


def test_interrupted_render_is_kept_and_continued(scene_file, monkeypatch):
    child = start("--spp", "4000")
    child.send_signal(signal.SIGINT)
    _, said = child.communicate(timeout=60)
    assert child.returncode == 128 + signal.SIGINT
    assert files(scene_file.parent) == ["scene.exr", "scene.png", "scene.xml"]
    spp = int(images.read_metadata("scene.exr")["spp"])
    assert 4 <= spp < 4000
    assert spp % 4 == 0
    assert f"Interrupted: {spp} of 4000 samples" in " ".join(said.split())

    monkeypatch.setitem(passes.SHORT_PASS, "llvm", samples(4))
    refused = invoke("render", scene_file, "--spp", 4000, "--seed", 1)
    assert_fails_in_one_line(refused, f"{spp} samples per pixel", "(seed)", "another output")
    result = invoke("render", scene_file, "--spp", spp + 6)
    assert f"Continued from {spp} of {spp + 6} samples" in " ".join(result.stderr.split())
    assert f"{spp + 6} spp, {spp // 4 + 2} passes" in result.stdout
    whole = invoke("render", scene_file, "-o", "whole.exr", "--spp", spp + 6)
    assert whole.exit_code == 0
    # Not to the bit: threads add up the samples in another order each time.
    np.testing.assert_allclose(read("scene.exr"), read("whole.exr"), rtol=1e-5)


def test_second_interrupt_ends_the_process_at_once():
    code = (
        "import time, os, signal, sys; from mi_ellipse.cli.process import interrupt_ends_pass\n"
        "with interrupt_ends_pass(print) as stop:\n"
        "    os.kill(os.getpid(), signal.SIGINT)\n"
        "    while not stop(): time.sleep(0.01)\n"
        "    os.kill(os.getpid(), signal.SIGINT)\n"
        "    time.sleep(60)"
    )
    process = subprocess.run([sys.executable, "-u", "-c", code], capture_output=True, timeout=30)
    assert process.returncode == 128 + signal.SIGINT
    assert process.stdout.count(b"Ctrl-C again") == 1


def test_one_pass_cannot_be_kept_in_part(scene_file):
    result = invoke("render", scene_file, "--keep-partial")
    assert "in one pass: Ctrl-C ends at once and keeps nothing" in " ".join(result.stderr.split())
    assert result.exit_code == 0


def test_grouping_can_be_left_to_mitsuba(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    far = LAMP.replace('<translate z="2"/>', '<scale value="0.2"/><translate x="2" z="3"/>')
    file = write_scene(tmp_path / "two.xml", LAMP + far)
    for name, options in (("grouped", []), ("plain", ["--no-grouping"])):
        result = invoke("render", file, "-o", f"{name}.exr", "--spp", 16, *options)
        assert result.exit_code == 0, result.output
    words = [mi.Bitmap(f"{name}.exr").metadata()["grouping"] for name in ("grouped", "plain")]
    assert words == ["yes", "no"]
    expected = mi.render(mi.load_file(str(file)), spp=16, seed=0).numpy()
    np.testing.assert_allclose(read("plain.exr"), expected, rtol=1e-5)
    assert not np.allclose(read("grouped.exr"), expected, rtol=1e-3)


# ---- Sensor, integrator and resolution ----

SENSOR = """
<sensor type="perspective" {}>
    <transform name="to_world"><lookat origin="0,{},3" target="0,0,0" up="0,0,1"/></transform>
    <film type="hdrfilm"><integer name="width" value="6"/><integer name="height" value="5"/></film>
</sensor>
"""


@pytest.fixture
def three_sensors(scene_file):
    """The scene with two more sensors, the last with an id that no file name may have."""
    return write_scene(scene_file, LAMP + SENSOR.format("", 3) + SENSOR.format('id="a/b"', 2))


def rendered(file, sensor):
    return mi.render(mi.load_file(str(file)), sensor=sensor, spp=4, seed=0).numpy()


def test_a_sensor_by_number_or_id(three_sensors):
    for name, number in (("1", 1), ("a/b", 2), ("2", 2)):
        result = invoke("render", three_sensors, "--sensor", name, "--spp", 4)
        assert result.exit_code == 0, result.output
        assert "sensors" not in result.stderr
        np.testing.assert_allclose(read("scene.exr"), rendered(three_sensors, number), rtol=1e-5)
        assert mi.Bitmap("scene.exr").metadata()["sensor"] == name


def test_the_first_of_several_sensors_is_announced(three_sensors):
    result = invoke("render", three_sensors, "--spp", 4)
    assert "3 sensors (0, 1, a/b)" in result.stderr
    np.testing.assert_allclose(read("scene.exr"), rendered(three_sensors, 0), rtol=1e-5)


def test_all_sensors(three_sensors):
    result = invoke("render", three_sensors, "--sensor", "all", "--spp", 4, "-o", "out.exr")
    assert result.exit_code == 0, result.output
    for name, number in (("0", 0), ("1", 1), ("a%2Fb", 2)):
        expected = rendered(three_sensors, number)
        np.testing.assert_allclose(read(f"out_{name}.exr"), expected, rtol=1e-5)
    assert files(three_sensors.parent) == sorted(
        [f"out_{name}.{kind}" for name in ("0", "1", "a%2Fb") for kind in ("exr", "png")]
        + ["scene.xml"]
    )


@pytest.mark.parametrize("integrator", ["prb", "direct", "volpath"])
def test_integrator_with_the_depth_of_the_scene(scene_file, integrator):
    """The scene says 2 bounces at most. `direct` knows no depth, which is no error."""
    result = invoke("render", scene_file, "--integrator", integrator)
    assert result.exit_code == 0, result.output
    depth = {} if integrator == "direct" else {"max_depth": 2}
    wanted = mi.load_dict({"type": integrator} | depth)
    expected = mi.render(mi.load_file(str(scene_file)), integrator=wanted, spp=4, seed=0).numpy()
    np.testing.assert_allclose(read("scene.exr"), expected, rtol=1e-5)
    assert mi.Bitmap("scene.exr").metadata()["integrator"] == integrator


def test_a_scene_without_integrator_or_film_gets_them(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "scene.xml").write_text(
        '<scene version="3.0.0"><sensor type="perspective"/><shape type="disk">'
        '<emitter type="area"/></shape></scene>'
    )
    result = invoke("render", "scene.xml", "--integrator", "depth", "--resolution", "7x3")
    assert result.exit_code == 0, result.output
    assert read("scene.exr").shape == (3, 7, 3)


def test_resolution(scene_file):
    assert invoke("render", scene_file, "--resolution", "9x7").exit_code == 0
    text = scene_file.read_text().replace(f'"{WIDTH}"', '"9"').replace(f'"{HEIGHT}"', '"7"')
    expected = mi.render(mi.load_string(text), spp=4, seed=0).numpy()
    assert expected.shape == (7, 9, 3)
    np.testing.assert_allclose(read("scene.exr"), expected, rtol=1e-5)
    assert mi.Bitmap("scene.exr").metadata()["resolution"] == "9x7"


@pytest.mark.parametrize("text", ["9", "9x", "axb", "0x5", "70000x2", "9x7x3", "-1x4"])
def test_impossible_resolutions(scene_file, text):
    result = invoke("render", scene_file, f"--resolution={text}")
    assert result.exit_code == 2
    assert "640x480" in result.stderr or "from 1 to 65536" in result.stderr


def test_resolution_of_a_part_of_the_picture_is_refused(scene_file):
    crop = '<integer name="crop_width" value="4"/><integer name="crop_height" value="3"/>'
    scene_file.write_text(scene_file.read_text().replace("</film>", crop + "</film>"))
    result = invoke("render", scene_file, "--resolution", "9x7")
    assert_fails_in_one_line(result, "resolution=9x7", "crop_width, crop_height")


@pytest.mark.parametrize("command", ["render", "compare"])
def test_help_names_the_strategies(command):
    text = " ".join(invoke(command, "--help").output.replace("│", " ").split())
    assert all(name in text for name in [*STRATEGIES, "built-in"])


# ---- Lamps of an existing scene ----


def test_built_in_lamps_are_converted_on_the_way_in(scene_file):
    text = SCENE.format(lamps=LAMP).replace('"disk"', '"disk" id="ceiling"')
    scene_file.write_text(text.replace("ellipticalarea", "area").replace(STRATEGY, ""))
    result = invoke("render", scene_file, "--convert-lamps", "--sampling", "ceiling=area")
    assert result.exit_code == 0, result.output
    assert '1 lamp converted to "ellipticalarea": ceiling\n' in result.stderr
    metadata = mi.Bitmap("scene.exr").metadata()
    assert (metadata["convert_lamps"], metadata["sampling"]) == ("yes", "ceiling=area")
    written = scene_file.with_name("written.xml")
    written.write_text(text)
    expected = mi.render(mi.load_file(str(written), sampling="area"), spp=4, seed=0).numpy()
    np.testing.assert_allclose(read("scene.exr"), expected, rtol=1e-5)


def test_built_in_is_a_choice(scene_file):
    assert invoke("render", scene_file, "--sampling", "built-in").exit_code == 0
    text = scene_file.read_text().replace("ellipticalarea", "area").replace(STRATEGY, "")
    expected = mi.render(mi.load_string(text), spp=4, seed=0).numpy()
    np.testing.assert_allclose(read("scene.exr"), expected, rtol=1e-5)
