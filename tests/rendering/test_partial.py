"""Interrupted renders in the files of their pictures."""

import dataclasses

import numpy as np
import pytest
from commands import samples
from mi_ellipse.files import images
from mi_ellipse.rendering import partial, passes
from mi_ellipse.rendering.job import RenderJob

pytestmark = pytest.mark.usefixtures("llvm_ad_rgb")


@pytest.fixture
def interrupted(scene_file, monkeypatch):
    """A job that was stopped after 4 of 12 samples per pixel, what it gave, and the file of it."""
    monkeypatch.setitem(passes.SHORT_PASS, "llvm", samples(4))
    job = RenderJob(scene_file, {"sampling": "area"}, spp=12, short_passes=True)
    rendering = job.run(stop=lambda: True)
    file = scene_file.with_suffix(".exr")
    partial.write(file, job, job.plan(), rendering)
    return job, rendering, file


def test_file_holds_what_is_finished_to_the_bit(interrupted):
    job, rendering, file = interrupted
    finished = partial.read(file, job, job.plan())
    assert (finished.spp, finished.passes) == (4, 1)
    assert finished.seconds == pytest.approx(rendering.seconds, abs=5e-4)  # stored in milliseconds
    assert finished.total.dtype == np.float64
    assert np.array_equal(finished.total, rendering.unfinished.total)
    assert np.array_equal(images.read_parts(file)["picture"], rendering.image)


def test_more_samples_are_the_same_render(interrupted):
    job, _, file = interrupted
    more = dataclasses.replace(job, spp=100)
    assert partial.read(file, more, more.plan()).spp == 4
    less = dataclasses.replace(job, spp=2)
    with pytest.raises(ValueError, match=r"scene.exr cannot be continued: spp=2: 4 samples"):
        partial.read(file, less, less.plan())


@pytest.mark.parametrize(
    ("changes", "name"),
    [
        ({"seed": 1}, "seed"),
        ({"sampling": "area"}, "sampling"),
        ({"grouping": False}, "grouping"),
        ({"parameters": {"sampling": "solid_angle"}}, "scene_digest, parameters"),
        ({"variant": "llvm_ad_spectral"}, "variant"),
    ],
)
def test_render_with_other_settings_is_left_alone(interrupted, changes, name):
    job, _, file = interrupted
    other = dataclasses.replace(job, **changes)
    message = rf"scene.exr holds an unfinished render of 4 .*\({name}.*\): remove it"
    with pytest.raises(ValueError, match=message):
        partial.read(file, other, other.plan())


def test_scene_that_was_edited_is_another_one(interrupted):
    job, _, file = interrupted
    job.scene.write_text(job.scene.read_text().replace('z="2"', 'z="1.9"'))
    with pytest.raises(ValueError, match="scene_digest"):
        partial.read(file, job, job.plan())


@pytest.mark.parametrize("content", [None, b"", b"earlier"])
def test_nothing_to_continue(scene_file, content):
    file = scene_file.with_suffix(".exr")
    if content is not None:
        file.write_bytes(content)
    job = RenderJob(scene_file)
    assert partial.read(file, job, job.plan()) is passes.NOTHING
    images.write_exr(file, np.ones((2, 2, 3)))
    assert partial.read(file, job, job.plan()) is passes.NOTHING
