"""Jobs: values that travel, and the scene that they share."""

import dataclasses
import gc
import multiprocessing
import os
import pickle
from concurrent.futures import ProcessPoolExecutor

import mitsuba as mi
import numpy as np
import pytest
from commands import HEIGHT, LAMP, WIDTH, write_scene
from mi_ellipse.plugins.grouping import group_lamps
from mi_ellipse.rendering import job as job_module
from mi_ellipse.rendering import passes
from mi_ellipse.rendering.changes import Changes
from mi_ellipse.rendering.executor import LocalExecutor
from mi_ellipse.rendering.job import RenderJob
from mi_ellipse.rendering.provenance import scene_digest

pytestmark = pytest.mark.usefixtures("llvm_ad_rgb")


@pytest.fixture
def loads(monkeypatch):
    """The sampling strategies of the scenes loaded from now on."""
    made = []
    load = job_module.instantiate

    def counting(parsed, sampling, changes):
        made.append(sampling)
        return load(parsed, sampling, changes)

    monkeypatch.setattr(job_module, "instantiate", counting)
    return made


# ---- A value ----


def test_a_job_is_a_value(scene_file):
    parameters = {"sampler": "stratified"}
    job = RenderJob(scene_file, parameters, "llvm_ad_rgb", "area", 4, 7)
    assert job == RenderJob(str(scene_file), dict(parameters), "llvm_ad_rgb", "area", 4, 7)
    assert len({job, pickle.loads(pickle.dumps(job)), dataclasses.replace(job, seed=8)}) == 2
    assert job != dataclasses.replace(job, changes=Changes(convert_lamps=True))
    assert job != dataclasses.replace(job, parameters={})
    parameters["sampler"] = "independent"
    assert job.parameters == {"sampler": "stratified"}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"spp": 0}, "spp=0: .* from 1 to"),
        ({"seed": -1}, "seed=-1: .* from 0 to 4294967295"),
        ({"seed": 2**32}, "seed=4294967296"),
    ],
)
def test_impossible_jobs_are_refused(scene_file, changes, message):
    with pytest.raises(ValueError, match=message):
        RenderJob(scene_file, **changes)


def test_a_job_is_the_picture_of_mitsuba(scene_file):
    rendering = RenderJob(scene_file, {"sampling": "area"}, "llvm_ad_rgb", None, 16, 7).run()
    scene = mi.load_file(str(scene_file), sampling="area")
    expected = mi.render(scene, spp=16, seed=7).numpy()
    # Not to the bit: threads add up the samples in another order each time.
    np.testing.assert_allclose(rendering.image, expected, rtol=1e-5)
    assert (rendering.spp, rendering.passes, rendering.channels) == (16, 1, ("R", "G", "B"))
    assert rendering.scene_digest == scene_digest(scene_file, {"sampling": "area"})


def test_a_job_gives_the_same_pixels_in_another_process(scene_file):
    job = RenderJob(scene_file, {}, "llvm_ad_rgb", "area", 8, 3)
    here = job.run()
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=context) as pool:
        there = pool.submit(RenderJob.run, job).result(timeout=120)
        assert pool.submit(os.getpid).result(timeout=120) != os.getpid()
    np.testing.assert_allclose(there.image, here.image, rtol=1e-5)
    for name in ("channels", "spp", "passes", "scene_digest"):
        assert getattr(there, name) == getattr(here, name)


@pytest.mark.parametrize("variant", ["scalar_rgb", "llvm_ad_spectral"])
def test_a_job_has_its_own_variant_and_leaves_that_of_the_caller(scene_file, variant):
    expected = RenderJob(scene_file, spp=256).run().image.mean()
    image = RenderJob(scene_file, variant=variant, spp=64).run().image
    assert image.mean() == pytest.approx(expected, rel=0.03)
    assert mi.variant() == "llvm_ad_rgb"


def test_the_variant_of_the_caller_is_set_again_after_an_error(scene_file):
    with pytest.raises(ValueError, match="nonsense"):
        RenderJob(scene_file, variant="scalar_rgb", sampling="nonsense").run()
    assert mi.variant() == "llvm_ad_rgb"


def test_plan(scene_file):
    parameters = {"sampler": "stratified"}
    plan = RenderJob(scene_file, parameters, spp=5).plan()
    digest = scene_digest(scene_file, parameters)
    assert plan == job_module.Plan((9,), (WIDTH, HEIGHT), False, digest, sensors=("0",))
    assert plan.spp == 9


# ---- Times ----


def test_times_add_up_and_the_warm_up_compiles(scene_file):
    # A strategy's kernel is new to Dr.Jit unless another test had it: a scene of its own.
    text = scene_file.read_text().replace(
        'name="max_depth" value="2"', 'name="max_depth" value="3"'
    )
    scene_file.write_text(text)
    rendering = RenderJob(scene_file, spp=4, warm_up=True).run()
    for timing in (rendering.timing, rendering.warm_up):
        parts = (timing.tracing, timing.compilation, timing.execution)
        assert all(part >= 0 for part in parts)
        assert sum(parts) == pytest.approx(timing.total)
        assert timing.execution > 0
    assert rendering.timing.compilation == 0
    assert rendering.seconds == rendering.timing.total
    assert RenderJob(scene_file, spp=4).run().warm_up is None


def test_scalar_variants_only_execute(scene_file):
    timing = RenderJob(scene_file, variant="scalar_rgb", spp=1).run().timing
    assert (timing.tracing, timing.compilation) == (0, 0)
    assert timing.execution == timing.total > 0


# ---- The scene in memory ----


def test_jobs_in_a_row_share_scene_and_warm_up(scene_file, loads, monkeypatch):
    rendered = []
    render = passes.render

    def counting(scene, spp, seed, *arguments):
        rendered.append((spp, seed))
        return render(scene, spp, seed, *arguments)

    monkeypatch.setattr(passes, "render", counting)
    jobs = [
        RenderJob(scene_file, {}, "llvm_ad_rgb", sampling, spp, 5, warm_up=True)
        for sampling in ("area", "solid_angle")
        for spp in (2, 8)
    ]
    with LocalExecutor() as executor:
        results = list(executor.map(RenderJob.run, jobs))
    assert loads == ["area", "solid_angle"]
    assert rendered == [(2, 5), (2, 5), (8, 5)] * 2
    assert results[0].warm_up == results[1].warm_up != results[2].warm_up == results[3].warm_up
    for job, result in zip(jobs, results, strict=True):
        alone = dataclasses.replace(job, warm_up=False).run()
        np.testing.assert_allclose(result.image, alone.image, rtol=1e-5)


@pytest.mark.parametrize("change", ["parameters", "variant", "sampling", "file", "mesh", "changes"])
def test_what_makes_another_scene_loads_it(scene_file, loads, change):
    mi.load_dict({"type": "cube"}).write_ply("cube.ply")
    mesh = '<shape type="ply"><string name="filename" value="cube.ply"/></shape>'
    text = scene_file.read_text().replace("</scene>", f"{mesh}</scene>")
    scene_file.write_text(text)
    job = RenderJob(scene_file, {}, "llvm_ad_rgb", "area", 1)
    changes = {
        "parameters": {"parameters": {"sampler": "stratified"}},
        "variant": {"variant": "llvm_ad_mono"},
        "sampling": {"sampling": "solid_angle"},
        "changes": {"changes": Changes(resolution=(3, 2))},
    }
    with LocalExecutor() as executor:
        executor.submit(job.run).result()
        executor.submit(dataclasses.replace(job, seed=1, spp=2).run).result()
        assert len(loads) == 1
        if change == "file":
            scene_file.write_text(text.replace("0,-4,3", "0,-4,4"))
        if change == "mesh":
            mi.load_dict({"type": "rectangle"}).write_ply("cube.ply")
        executor.submit(dataclasses.replace(job, **changes.get(change, {})).run).result()
    assert len(loads) == 2


def lamps_alive():
    """Number of emitters of this package in memory."""
    gc.collect()
    return sum(type(thing).__name__ == "EllipticalArea" for thing in gc.get_objects())


def test_one_scene_lives_at_a_time_and_none_afterwards(scene_file, monkeypatch):
    before, alive = lamps_alive(), []
    parse = job_module.parse_scene

    def watch(*arguments):
        alive.append(lamps_alive() - before)
        return parse(*arguments)

    monkeypatch.setattr(job_module, "parse_scene", watch)
    RenderJob(scene_file, spp=1).run()
    assert lamps_alive() == before
    with LocalExecutor() as executor:
        for sampling in ("area", "solid_angle"):
            executor.submit(RenderJob(scene_file, sampling=sampling, spp=1).run).result()
            assert lamps_alive() == before + 1
    assert alive == [0, 0, 0]
    assert lamps_alive() == before


def test_a_missing_file_is_named(scene_file):
    write_scene(scene_file, '<shape type="ply"><string name="filename" value="gone.ply"/></shape>')
    with pytest.raises(FileNotFoundError, match=r'scene.xml \(line \d+.*"gone.ply" is not found'):
        RenderJob(scene_file).run()


# ---- Lamps that choose among themselves ----


def two_lamps(folder):
    """A near and bright lamp, and one that is far away and small."""
    far = LAMP.replace('<translate z="2"/>', '<scale value="0.2"/><translate x="2" z="3"/>')
    return write_scene(folder / "two.xml", LAMP + far)


def noise(job, reference):
    return np.mean((job.run().image - reference) ** 2)


def test_a_job_groups_lamps_unless_it_says_no(tmp_path):
    job = RenderJob(two_lamps(tmp_path), spp=64, seed=1)
    ungrouped = dataclasses.replace(job, grouping=False)
    reference = dataclasses.replace(ungrouped, spp=2**14, seed=2).run().image
    scene = mi.load_file(str(job.scene))
    np.testing.assert_allclose(ungrouped.run().image, mi.render(scene, spp=64, seed=1), rtol=1e-5)
    # Of the picked lamp nearly all noise is gone; a group that is not made leaves it as it is.
    assert noise(job, reference) < 0.5 * noise(ungrouped, reference)


def test_jobs_of_either_way_share_no_scene(tmp_path, loads):
    job = RenderJob(two_lamps(tmp_path), spp=4)
    with LocalExecutor() as executor:
        jobs = [job, dataclasses.replace(job, grouping=False)]
        first, second = (rendering.image for rendering in executor.map(RenderJob.run, jobs))
    assert len(loads) == 2
    assert not np.allclose(first, second, rtol=1e-3)


def test_recorded_passes_of_grouped_lamps(tmp_path):
    """Three passes, two of which are replayed, have the mean of a single one."""
    job = RenderJob(two_lamps(tmp_path), spp=192, seed=3)
    whole = job.run()
    scene = mi.load_file(str(job.scene))
    group_lamps(scene)
    split = passes.render(scene, 192, 3, max_samples=WIDTH * HEIGHT * 64)
    assert (whole.passes, split.passes) == (1, 3)
    error = np.abs(split.image.mean() / whole.image.mean() - 1)
    # Some 37 000 samples of a relative deviation near 1 in each: 5 standard errors.
    assert error < 5 * np.sqrt(2 / (192 * WIDTH * HEIGHT))
