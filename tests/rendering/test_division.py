"""Renders that are divided into passes, each a job."""

import dataclasses
from concurrent.futures import Future

import numpy as np
import pytest
from mi_ellipse.rendering import division
from mi_ellipse.rendering.executor import JobExecutor, LocalExecutor
from mi_ellipse.rendering.job import Plan, RenderJob

pytestmark = pytest.mark.usefixtures("llvm_ad_rgb")


def test_passes_as_jobs_are_the_render_bit_for_bit(small_scene):
    job = RenderJob(small_scene, spp=11, seed=3, pass_spp=3)
    whole = job.run()
    calls = []
    with LocalExecutor() as executor:
        plan = executor.submit(job.plan).result()
        parts = division.render(job, plan.sizes, executor, lambda *call: calls.append(call))
    assert plan.sizes == (3, 3, 3, 2)
    assert calls == [(1, 4), (2, 4), (3, 4), (4, 4)]
    np.testing.assert_array_equal(parts.image, whole.image)
    for name in ("channels", "spp", "passes", "scene_digest", "machine"):
        assert getattr(parts, name) == getattr(whole, name)
    timing = parts.timing
    assert timing.total == pytest.approx(timing.tracing + timing.compilation + timing.execution)


def test_times_are_sums_and_machines_are_named_once(small_scene):
    class Elsewhere(LocalExecutor):
        """Renders in turn on three machines, two of which have one name."""

        def map(self, fn, jobs, **options):
            for name, rendering in zip("bab", super().map(fn, jobs), strict=True):
                times = dataclasses.replace(rendering.timing, total=2.0)
                yield dataclasses.replace(rendering, machine=name, timing=times)

    with Elsewhere() as executor:
        result = division.render(RenderJob(small_scene, seed=1), (1, 1, 1), executor)
    assert (result.machine, result.seconds, result.spp) == ("a, b", 6.0, 3)


def test_the_size_of_passes_depends_on_the_picture_alone(small_scene):
    class Elsewhere(JobExecutor):
        """Plans a picture of some size."""

        alone = machine = None

        def __init__(self, size):
            self._size = size

        def submit(self, fn, /, *arguments):
            future = Future()
            future.set_result(Plan((4, 4), self._size, loses_stratification=False))
            return future

    sizes = {(64, 16): 2**14, (640, 480): 32, (8, 8): 2**14, (8192, 8192): 1}
    for size, pass_spp in sizes.items():
        assert division.with_passes(RenderJob(small_scene), Elsewhere(size)).pass_spp == pass_spp
    job = RenderJob(small_scene)
    assert division.with_passes(job, LocalExecutor()) is job
