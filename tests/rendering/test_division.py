"""Renders that are divided into passes, each a job."""

import dataclasses

import numpy as np
import pytest
from mi_ellipse.rendering import division, passes
from mi_ellipse.rendering.executor import LocalExecutor
from mi_ellipse.rendering.job import RenderJob

pytestmark = pytest.mark.usefixtures("llvm_ad_rgb")


@pytest.fixture
def job(small_scene, monkeypatch):
    """A render in passes of two samples per pixel."""
    monkeypatch.setitem(passes.SHORT_PASS, "llvm", 24 * 16 * 2)
    return RenderJob(small_scene, spp=7, seed=3, short_passes=True)


def test_passes_as_jobs_are_the_render_bit_for_bit(job):
    whole = job.run()
    calls = []
    with LocalExecutor() as executor:
        plan = executor.submit(job.plan).result()
        parts = division.render(job, plan.sizes, executor, lambda *call: calls.append(call))
    assert plan.sizes == (2, 2, 2, 1)
    assert calls == [(1, 4), (2, 4), (3, 4), (4, 4)]
    np.testing.assert_array_equal(parts.image, whole.image)
    for name in ("channels", "spp", "passes", "scene_digest", "machine", "unfinished"):
        assert getattr(parts, name) == getattr(whole, name)
    timing = parts.timing
    assert timing.total == pytest.approx(timing.tracing + timing.compilation + timing.execution)


def test_a_divided_render_stops_after_a_pass_and_goes_on(job):
    whole = job.run()
    answers = iter([False, True])
    with LocalExecutor() as executor:
        sizes = executor.submit(job.plan).result().sizes
        first = division.render(job, sizes, executor, stop=lambda: next(answers))
        assert (first.spp, first.passes, first.unfinished.passes) == (4, 2, 2)
        rest = division.render(job, sizes, executor, before=first.unfinished)
        assert rest.unfinished is None
        with pytest.raises(ValueError, match="all samples per pixel are finished already"):
            division.render(job, sizes, executor, before=passes.Finished(np.zeros(()), 7, 4))
    np.testing.assert_array_equal(rest.image, whole.image)
    assert rest.seconds == pytest.approx(first.seconds + rest.timing.total)


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


def test_the_size_of_passes_depends_on_the_picture_alone():
    sizes = {64 * 16: 2**14, 640 * 480: 32, 8 * 8: 2**14, 8192 * 8192: 1}
    assert {pixels: division.pass_size(pixels) for pixels in sizes} == sizes
