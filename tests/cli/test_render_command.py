"""The command line end to end, and the rendering behind it."""

import dataclasses
import hashlib
import json
import os
import signal
import subprocess
import sys
import time

import drjit as dr
import mi_ellipse
import mitsuba as mi
import numpy as np
import pytest
from mi_ellipse import cli, doctor, render
from mi_ellipse.system.messages import innermost_cause
from mi_ellipse.sampling import STRATEGIES
from mi_ellipse.scene import load_scene
from typer.testing import CliRunner

WIDTH, HEIGHT = 16, 12

LAMP = """
<shape type="disk">
    <transform name="to_world"><rotate x="1" angle="180"/><translate z="2"/></transform>
    <emitter type="ellipticalarea"><string name="sampling" value="$sampling"/></emitter>
</shape>
"""

SCENE = f"""
<scene version="3.0.0">
    <default name="sampler" value="independent"/>
    <default name="sampling" value="solid_angle"/>
    <default name="pixel_format" value="rgb"/>
    <integrator type="path"><integer name="max_depth" value="2"/></integrator>
    <sensor type="perspective">
        <transform name="to_world"><lookat origin="0,-4,3" target="0,0,0" up="0,0,1"/></transform>
        <sampler type="$sampler"><integer name="sample_count" value="4"/></sampler>
        <film type="hdrfilm">
            <integer name="width" value="{WIDTH}"/>
            <integer name="height" value="{HEIGHT}"/>
            <string name="pixel_format" value="$pixel_format"/>
        </film>
    </sensor>
    <shape type="rectangle"><transform name="to_world"><scale value="3"/></transform></shape>
    {{lamps}}
</scene>
"""


@pytest.fixture(autouse=True)
def _variant():
    mi.set_variant("llvm_ad_rgb")


@pytest.fixture
def scene_file(tmp_path, monkeypatch):
    """A scene in the current directory, which is a temporary one."""
    monkeypatch.chdir(tmp_path)
    return write_scene(tmp_path / "scene.xml", LAMP)


def write_scene(path, lamps):
    path.write_text(SCENE.format(lamps=lamps))
    return path


def invoke(*arguments):
    return CliRunner().invoke(cli.app, [str(argument) for argument in arguments])


def read(path):
    return np.array(mi.Bitmap(str(path)))


def files(folder):
    return sorted(path.name for path in folder.iterdir())


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
        "scene_sha256": hashlib.sha256(scene_file.read_bytes()).hexdigest(),
        "spp": "8",
        "passes": "1",
        "seed": str(2**32 - 1),
        "variant": "llvm_ad_rgb",
        "sampling": "solid_angle",
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


def test_exposure_shows_a_grey_picture_at_four_fifths(tmp_path):
    image = np.full((4, 4, 3), 0.2)
    exposure = render.choose_exposure(image)
    assert exposure == 2
    render.write_png(tmp_path / "grey.png", image, exposure)
    srgb = 255 * (1.055 * 0.8 ** (1 / 2.4) - 0.055)  # IEC 61966-2-1
    np.testing.assert_allclose(read(tmp_path / "grey.png"), srgb, atol=1)
    assert render.choose_exposure(np.zeros((4, 4, 3))) == 0


# ---- The strategy from outside ----


def test_sampling_reaches_every_lamp(scene_file):
    (scene_file.parent / "more.xml").write_text(
        f'<scene version="3.0.0">{LAMP.replace("$sampling", "nonsense")}</scene>'
    )
    write_scene(scene_file, LAMP + LAMP + '<include filename="more.xml"/>')
    result = invoke("render", scene_file, "--sampling", "solid_angle", "-D", "sampling=also wrong")
    assert result.exit_code == 0, result.stderr
    assert len(load_scene(scene_file, sampling="solid_angle").emitters()) == 3


@pytest.mark.parametrize("name", sorted(STRATEGIES))
def test_sampling_is_the_parameter_of_the_scene(scene_file, name):
    chosen = mi.render(load_scene(scene_file, sampling=name), spp=4).numpy()
    written = mi.render(load_scene(scene_file, {"sampling": name}), spp=4).numpy()
    np.testing.assert_allclose(chosen, written, rtol=1e-5)


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
        (["-D", "width=3"], ["unused", "$width=3"]),
        (["-o", "nowhere/out.exr"], ["cannot write nowhere/out.exr"]),
        (["-o", "folder.exr"], ["cannot write folder.exr", "folder"]),
        (["-o", "blocked.exr"], ["cannot write blocked.png"]),
        (["-o", "out.png"], ["out.png", ".exr"]),
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
    monkeypatch.setattr(cli, "load_scene", lambda *_: pytest.fail("began to work"))
    assert_fails_in_one_line(invoke("render", scene_file, "-o", "/proc/out.exr"), "/proc/out.exr")


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
        (LAMP.replace('"disk"', '"sphere"'), ["ellipticalarea", "Sphere"]),
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


def test_innermost_cause():
    outer = RuntimeError("(see above)")
    outer.__context__ = ValueError("the\n  cause")
    assert innermost_cause(outer) == "the cause"
    outer.__suppress_context__ = True
    assert innermost_cause(outer) == "(see above)"
    outer.__cause__ = KeyError("explicit")
    assert innermost_cause(outer) == "'explicit'"

    quoted = 'Traceback (most recent call last):\n  File "a.py", line 1, in f\n    x()\nKeyError: y'
    assert innermost_cause(RuntimeError(f"[a.cpp:1] At b: {quoted}")) == "At b: KeyError: y"
    assert innermost_cause(KeyboardInterrupt()) == "KeyboardInterrupt"


def test_invalid_pixels_are_announced(scene_file, monkeypatch):
    original = render.render

    def broken(*arguments):
        rendering = original(*arguments)
        image = rendering.image.copy()
        image[0, 0, 1], image[2, 3, :] = np.nan, np.inf
        return dataclasses.replace(rendering, image=image)

    monkeypatch.setattr(render, "render", broken)
    result = invoke("render", scene_file)
    assert "WARNING: 2 pixels are NaN or infinite" in result.stderr
    assert result.exit_code == 0
    assert np.isnan(read("scene.exr")[0, 0, 1])
    assert read("scene.png")[2, 3].tolist() == [0, 0, 0]


# ---- Passes ----


def samples(spp):
    """Number of samples of the test scene's film, without border, at `spp`."""
    return WIDTH * HEIGHT * spp


@pytest.mark.parametrize(
    ("sampler", "spp", "limit", "expected"),
    [
        ("independent", 4096, render.MAX_SAMPLES_PER_PASS, (4096,)),
        ("independent", 100, samples(100), (100,)),
        ("independent", 101, samples(100), (51, 50)),
        ("independent", 7, samples(2) + 1, (2, 2, 2, 1)),
        ("independent", None, samples(3), (2, 2)),
        ("stratified", 5, samples(100), (9,)),
        ("stratified", 50, samples(30), (25, 25)),
    ],
)
def test_plan_passes(scene_file, sampler, spp, limit, expected):
    scene = load_scene(scene_file, {"sampler": sampler})
    assert render.plan_passes(scene, spp, limit) == expected


def test_plan_passes_refuses_a_film_beyond_the_limit(scene_file):
    with pytest.raises(ValueError, match="more than 191 samples"):
        render.plan_passes(load_scene(scene_file), 1, samples(1) - 1)


def test_passes_average_to_renders_of_mitsuba_and_are_recorded_once(scene_file, monkeypatch):
    frozen = []
    freeze = dr.freeze
    monkeypatch.setattr(dr, "freeze", lambda f: frozen.append(freeze(f)) or frozen[-1])
    scene = load_scene(scene_file)
    calls = []
    rendering = render.render(scene, 15, 5, lambda *call: calls.append(call), samples(4))

    assert calls == [(1, 4), (2, 4), (3, 4), (4, 4)]
    assert (rendering.spp, rendering.passes) == (15, 4)
    # One for 4, 4, 4, a second one where a lamp met its shape in the first, one for the 3.
    assert frozen[0].n_recordings <= 3

    seeds = render._pass_seeds(5, 4)
    assert len(set(seeds)) == 4
    expected = np.average(
        [mi.render(scene, spp=n, seed=s).numpy() for n, s in zip((4, 4, 4, 3), seeds, strict=True)],
        axis=0,
        weights=(4, 4, 4, 3),
    )
    np.testing.assert_allclose(rendering.image, expected, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("variant", ["llvm_ad_spectral", "llvm_ad_mono"])
def test_passes_in_other_variants(scene_file, variant):
    mi.set_variant(variant)
    scene = load_scene(scene_file)
    rendering = render.render(scene, 256, max_samples=samples(64))
    assert rendering.passes == 4
    whole = mi.render(scene, spp=256).numpy()
    assert rendering.image.mean() == pytest.approx(whole.mean(), rel=0.02)


def test_single_pass_is_not_recorded(scene_file, monkeypatch):
    monkeypatch.setattr(dr, "freeze", lambda _: pytest.fail("recorded a single pass"))
    assert render.render(load_scene(scene_file), 4).passes == 1


@pytest.mark.parametrize(("sampler", "warns"), [("independent", False), ("multijitter", True)])
def test_loss_of_stratification_is_announced(scene_file, monkeypatch, sampler, warns):
    plan = render.plan_passes
    monkeypatch.setattr(
        render, "plan_passes", lambda scene, spp=None, limit=0: plan(scene, spp, samples(4))
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
        "import resource, sys; from mi_ellipse import cli, render\n"
        "write = render.write_exr\n"
        "def limited(*arguments):\n"
        "    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))\n"
        "    write(*arguments)\n"
        "render.write_exr = limited\n"
        "sys.argv = 'mi-ellipse render scene.xml --seed 1'.split()\n"
        "cli.main()"
    )
    process = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert process.returncode == 1
    assert process.stderr.startswith("mi-ellipse: ")
    assert "too large" in process.stderr
    after = {name: (scene_file.parent / name).read_bytes() for name in files(scene_file.parent)}
    assert after == before


@pytest.mark.parametrize("write", [render.write_exr, render.write_png])
def test_interrupted_write_leaves_the_old_file(tmp_path, monkeypatch, write):
    path = tmp_path / f"picture.{write.__name__[-3:]}"
    write(path, np.zeros((4, 4, 3)))
    before = path.read_bytes()

    def interrupt(source, target):
        assert os.path.dirname(source) == os.path.dirname(target)
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(os, "replace", interrupt)
        with pytest.raises(KeyboardInterrupt):
            write(path, np.ones((4, 4, 3)))
    assert (files(tmp_path), path.read_bytes()) == ([path.name], before)
    write(path, np.ones((4, 4, 3)))
    assert path.read_bytes() != before


def test_interrupt_during_a_pass_ends_the_process_at_once(scene_file):
    (scene_file.parent / "scene.exr").write_text("earlier")
    # Announce that loading is over, then render for minutes.
    code = (
        "import sys; from mi_ellipse import cli, render\n"
        "original = render.render\n"
        "def announced(*a): print('rendering', flush=True); return original(*a)\n"
        "render.render = announced\n"
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


# ---- Doctor ----


def run_doctor(**environment):
    return subprocess.run(
        [sys.executable, "-m", "mi_ellipse", "doctor"],
        capture_output=True,
        text=True,
        env=os.environ | environment,
    )


def test_doctor():
    process = run_doctor()
    assert process.returncode == 0, process.stdout
    for word in (mi_ellipse.__version__, mi.__version__, dr.__version__, "llvm_ad_rgb works"):
        assert word in process.stdout


def test_doctor_fails_without_llvm():
    process = run_doctor(DRJIT_LIBLLVM_PATH="/nonexistent")
    assert process.returncode == 1
    assert "llvm_ad_rgb fails: " in process.stdout
    assert "scalar_rgb  works" in process.stdout
    assert "LLVM        none found" in process.stdout


def test_doctor_survives_an_abort():
    code = "import os, sys; print('LLVM ERROR: no', file=sys.stderr, flush=True); os.abort()"
    trial = doctor.try_variant("llvm_ad_rgb", (sys.executable, "-c", code))
    assert not trial.works
    assert trial.message == f"died of signal {int(signal.SIGABRT)}: LLVM ERROR: no"


def test_doctor_tries_one_variant_of_each_backend():
    variants = ["scalar_mono", "scalar_rgb", "llvm_mono", "llvm_ad_rgb", "cuda_rgb"]
    assert doctor.representatives(variants) == ["scalar_mono", "llvm_ad_rgb", "cuda_rgb"]
