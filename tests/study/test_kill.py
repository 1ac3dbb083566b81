"""A comparison that is killed at any moment ends as one that was left alone."""

import random
import subprocess
import sys
import time

import numpy as np
from comparisons import contents, read
from conftest import SMALL_SCENE, SMALL_SIZE

KILLS = 10
SEED = 20260101

# What is left to chance in a comparison are its times, and the order in which several threads add
# samples: one thread renders, and a clock tells the same time for the same job.
DRIVER = """
import dataclasses, functools, pathlib, sys
import drjit as dr
import mi_ellipse
import mitsuba as mi
from mi_ellipse.rendering.job import RenderJob, Timing
from mi_ellipse.study import compare, run

mi.set_variant("llvm_ad_rgb")
dr.set_thread_count(1)
original = RenderJob.run

def timed(job):
    rendering = original(job)
    seconds = 0.01 * job.spp * (1.5 if job.sampling == "solid_angle" else 1)
    timing = Timing(seconds, 0.0, 0.0, seconds)
    return dataclasses.replace(rendering, timing=timing, warm_up=timing)

RenderJob.run = timed
run.render_reference = functools.partial(run.render_reference, samples_per_pass=int(sys.argv[3]))
print("begins", flush=True)
compare(sys.argv[1], sys.argv[2], ("area", "solid_angle"), (2, 6), 96, 2, say=print)
print("ends", flush=True)
"""


def start(folder, name):
    """Begin a comparison in a process of its own."""
    width, height = SMALL_SIZE
    arguments = [folder / "scene.xml", folder / name, width * height * 4]
    process = subprocess.Popen(
        [sys.executable, "-c", DRIVER, *map(str, arguments)], stdout=subprocess.PIPE, text=True
    )
    assert process.stdout.readline() == "begins\n"
    return process


def finish(process):
    """Leave a comparison alone until its end, and return what it said and how long it took."""
    begin = time.monotonic()
    said = process.communicate(timeout=300)[0].splitlines()
    assert process.returncode == 0
    assert said[-1] == "ends"
    return said, time.monotonic() - begin


def test_ten_kills_change_nothing(tmp_path):
    (tmp_path / "scene.xml").write_text(SMALL_SCENE)
    _, seconds = finish(start(tmp_path, "alone"))

    moments = random.Random(SEED)
    killed = 0
    for _ in range(KILLS):
        process = start(tmp_path, "killed")
        time.sleep(moments.uniform(0, 0.6 * seconds))
        killed += process.poll() is None
        process.kill()
        process.communicate()
    assert killed >= KILLS / 2  # The others came to their end before, and the folder was whole.
    said, _ = finish(start(tmp_path, "killed"))
    assert any("reused" in sentence for sentence in said)
    assert not any("damaged" in sentence for sentence in said)

    alone, found = (contents(tmp_path / name) for name in ("alone", "killed"))
    assert set(found) == set(alone)  # nothing half-written either
    for name in ("results.csv", "results.json", "times.json", "made_from.json"):
        assert found[name] == alone[name], name
    for name in alone:
        if name.endswith(".exr") and "/all_" not in name:
            np.testing.assert_array_equal(
                read(tmp_path / "killed" / name), read(tmp_path / "alone" / name), err_msg=name
            )
