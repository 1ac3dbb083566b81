"""The reference: its two halves, its passes, and what an interruption leaves."""

import json
from concurrent.futures import Executor, Future

import mitsuba as mi
import numpy as np
import pytest
from comparisons import read, reference_of

pytestmark = pytest.mark.usefixtures("llvm_ad_rgb")


def test_reference_is_the_mean_of_two_halves_and_states_its_error(finished):
    folder = finished.folder / "reference"
    first, second = (read(folder / f"half_{i}.exr").astype(float) for i in (1, 2))
    np.testing.assert_allclose(read(folder / "reference.exr"), (first + second) / 2, rtol=1e-6)
    assert mi.Bitmap(str(folder / "reference.exr")).metadata()["spp"] == "64"
    assert mi.Bitmap(str(folder / "half_1.exr")).metadata()["spp"] == "32"

    difference = np.mean((first - second) ** 2)
    assert difference > 0
    stated = json.loads((finished.folder / "results.json").read_text())["reference"]
    assert stated["errors"]["mse"] == pytest.approx(difference / 4, rel=1e-5)
    assert stated["spp"] == 64


def test_reference_goes_on_after_an_interruption(small_scene, tmp_path, count_renders):
    whole = reference_of(small_scene, tmp_path / "whole", 24)
    passes, count_renders.made = count_renders.made, []
    assert [spp for spp, _ in passes] == [4] * 6
    assert len({seed for _, seed in passes}) == 6

    count_renders.stop_after = 3
    with pytest.raises(KeyboardInterrupt):
        reference_of(small_scene, tmp_path / "parts", 24)
    count_renders.stop_after, said = None, []
    parts = reference_of(small_scene, tmp_path / "parts", 24, said)
    assert said == ["Reference: continued from 12 of 24 spp"]
    assert count_renders.made == passes
    np.testing.assert_allclose(read(parts.file), read(whole.file), rtol=1e-5, atol=1e-6)
    assert parts.errors["mse"] == pytest.approx(whole.errors["mse"], rel=1e-4)


def test_reference_grows_and_is_reused_where_it_suffices(small_scene, tmp_path, count_renders):
    small = reference_of(small_scene, tmp_path, 10)
    assert (small.spp, [spp for spp, _ in count_renders.made]) == (10, [4, 4, 1, 1])
    large = reference_of(small_scene, tmp_path, 16)
    assert (large.spp, [spp for spp, _ in count_renders.made[4:]]) == (16, [3, 3])
    assert len({seed for _, seed in count_renders.made}) == 6
    assert mi.Bitmap(str(large.file)).metadata()["spp"] == "16"
    assert reference_of(small_scene, tmp_path, 8).spp == 16
    assert len(count_renders.made) == 6


class Backwards(Executor):
    """Runs the jobs of a `map` from the last to the first, as a busy cluster might."""

    def __init__(self):
        self.jobs = []

    def submit(self, function, /, *arguments):
        future = Future()
        future.set_result(function(*arguments))
        return future

    def map(self, function, jobs, **options):
        self.jobs += jobs
        results = [function(job) for job in reversed(jobs)]
        return reversed(results)


def test_reference_does_not_depend_on_where_and_when_its_passes_end(small_scene, tmp_path):
    executor = Backwards()
    elsewhere = reference_of(small_scene, tmp_path / "elsewhere", 24, executor=executor)
    here = reference_of(small_scene, tmp_path / "here", 24)
    assert [job.spp for job in executor.jobs] == [4] * 6
    # The threads of a render add samples in changing order, and so round differently.
    np.testing.assert_allclose(read(elsewhere.file), read(here.file), rtol=1e-5, atol=1e-6)
    for i in (1, 2):
        name = f"half_{i}.exr"
        np.testing.assert_allclose(
            read(elsewhere.file.with_name(name)), read(here.file.with_name(name)),
            rtol=1e-5, atol=1e-6,
        )  # fmt: skip
