"""A cluster: a scheduler and two workers, each a process of its own, on this machine's loopback."""

import json
import os
import platform
import re
import signal
import subprocess
import sys
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace

import mi_ellipse
import mitsuba as mi
import numpy as np
import pytest
from commands import invoke
from comparisons import read, reference_of, run
from conftest import SMALL_SCENE, SMALL_SIZE

distributed = pytest.importorskip("distributed")

from mi_ellipse.rendering import cluster, provenance, worker  # noqa: E402
from mi_ellipse.rendering.executor import LocalExecutor  # noqa: E402
from mi_ellipse.rendering.job import RenderJob  # noqa: E402

pytestmark = pytest.mark.usefixtures("llvm_ad_rgb")

ROOT = Path(mi_ellipse.__file__).parent.parent


def launch(folder, name, *arguments):
    """Start a process of Dask whose folder is empty."""
    (folder / name).mkdir()
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    with (folder / f"{name}.log").open("w") as log:
        return subprocess.Popen(
            [sys.executable, "-m", "dask", *arguments],
            cwd=folder / name, env=environment, stdout=log, stderr=subprocess.STDOUT,
        )  # fmt: skip


def wait_for(condition, seconds=30):
    """Return what a condition gives as soon as it is true."""
    end = time.monotonic() + seconds
    while True:
        late = time.monotonic() > end
        if result := condition():
            return result
        assert not late, "timed out"
        time.sleep(0.05)


@pytest.fixture(scope="module")
def scheduler(tmp_path_factory):
    """Address of a scheduler with two workers of one thread each; Dask replaces killed ones."""
    folder = tmp_path_factory.mktemp("cluster")
    file = folder / "scheduler.json"
    host = ("--host", "127.0.0.1", "--no-dashboard")
    processes = [
        launch(
            folder, "scheduler", "scheduler", *host, "--port", "0", "--scheduler-file", str(file)
        )
    ]
    try:
        written = wait_for(lambda: file.exists() and file.read_text())  # It is empty at first.
        address = json.loads(written)["address"]
        processes += [
            launch(
                folder, name, "worker", address, *host, "--nthreads", "1", "--name", name,
                "--local-directory", str(folder / name),
            )
            for name in ("first", "second")
        ]  # fmt: skip
        yield address
    finally:
        for process in reversed(processes):
            process.terminate()
            process.wait(timeout=20)


@pytest.fixture(scope="module")
def executor(scheduler):
    """Jobs on that cluster, when both workers are there."""
    with cluster.connect(scheduler) as executor:
        executor.client.wait_for_workers(2, timeout=30)
        yield executor


def addresses(executor):
    """Addresses of the workers, as the scheduler knows them; nothing is sent to a worker."""
    return executor.client.nthreads().keys()


def pids(executor):
    """Addresses of the workers and their process ids; all of them must be alive."""
    return executor.client.run(os.getpid)


def kill(executor, *killed):
    """
    End workers as a crash would, and wait until the scheduler knows.

    Dask tries for half a minute to reach a worker that has ended unnoticed.
    """
    alive = pids(executor)
    for address in killed:
        os.kill(alive[address], signal.SIGKILL)
    wait_for(lambda: addresses(executor).isdisjoint(killed))


@pytest.fixture
def both(executor):
    """Wait until both workers are there, whatever the test before has done to them."""
    wait_for(lambda: len(addresses(executor)) == 2)
    return executor


# ---- Jobs ----


def test_jobs_of_a_cluster_are_those_of_this_process(both, small_scene):
    jobs = [
        RenderJob(small_scene, {"radiance": "2"}, "llvm_ad_rgb", strategy, 8, seed)
        for strategy in ("area", "solid_angle")
        for seed in (1, 2)
    ]
    with LocalExecutor() as local:
        here = list(local.map(RenderJob.run, jobs))
    there = list(both.map(RenderJob.run, jobs))
    for one, other in zip(here, there, strict=True):
        np.testing.assert_array_equal(one.image, other.image)
        assert one.scene_digest == other.scene_digest
        assert other.machine == f"{provenance.processor()}, 1 threads, on {platform.node()}"
    assert both.submit(jobs[0].plan).result() == jobs[0].plan()
    assert both.submit(divmod, 7, 2).result() == (3, 1)


def test_workers_find_the_scene_where_its_folder_is_not(both, tmp_path):
    """Two files, one of them named by a path that only this process can have."""
    mi.load_dict({"type": "cube"}).write_ply(str(tmp_path / "cube.ply"))
    mesh = '<shape type="ply"><string name="filename" value="../cube.ply"/></shape></scene>'
    (tmp_path / "scene").mkdir()
    scene = tmp_path / "scene" / "scene.xml"
    scene.write_text(SMALL_SCENE.replace("</scene>", mesh))
    job = RenderJob(scene, spp=4)
    expected = job.run().image
    assert both.submit(job.run).result().spp == 4
    (tmp_path / "cube.ply").rename(tmp_path / "elsewhere.ply")
    (tmp_path / "cube.ply").symlink_to(tmp_path / "elsewhere.ply")
    np.testing.assert_array_equal(both.submit(job.run).result().image, expected)


def test_files_are_sent_once_and_again_when_they_change(both, small_scene):
    for strategy in ("area", "solid_angle"):
        both.submit(RenderJob(small_scene, sampling=strategy, spp=1).run).result()
    sent = len(both._plugins)
    first = both.submit(RenderJob(small_scene, {"radiance": "3"}, spp=1).run).result()
    assert len(both._plugins) == sent  # Parameters travel with the job.
    small_scene.write_text(SMALL_SCENE.replace("0,-4,3", "0,-5,3"))
    second = both.submit(RenderJob(small_scene, {"radiance": "3"}, spp=1).run).result()
    assert len(both._plugins) == sent + 1
    assert first.scene_digest != second.scene_digest


def test_errors_name_the_files_of_this_machine(both, tmp_path):
    scene = tmp_path / "wrong.xml"
    scene.write_text(SMALL_SCENE.replace('type="rectangle"', 'type="nonsense"'))
    with pytest.raises(RuntimeError, match=rf"{re.escape(str(scene))} \(line \d+") as caught:
        both.submit(RenderJob(scene, spp=1).run).result()
    assert "dask" not in str(caught.value)
    with pytest.raises(RuntimeError, match=r"File not found: gone\.xml"):
        both.submit(RenderJob("gone.xml").run).result()


# ---- What the workers are ----


def test_a_worker_with_other_code_renders_nothing(both, small_scene, monkeypatch):
    monkeypatch.setattr(provenance, "picture_digest", lambda: "0" * 64)
    worker._code.cache_clear()
    try:
        with pytest.raises(RuntimeError, match=r"tcp://\S+ renders with picture_digest \w+ inst"):
            cluster.connect(both.client.scheduler.address)
        monkeypatch.setattr(both, "_here", worker.identity())
        with pytest.raises(RuntimeError, match="install the same packages"):
            both.submit(RenderJob(small_scene, spp=1).run).result()
    finally:
        worker._code.cache_clear()


def test_differences_in_digits_are_said(both, monkeypatch):
    said = []
    monkeypatch.setattr(provenance, "processor", lambda: "another one")
    with cluster.connect(both.client.scheduler.address, said.append):
        pass
    assert re.match(r"Cluster: 2 worker\(s\) with 2 thread\(s\) on ", said[0])
    assert said[1].startswith("2 of the workers have another processor or LLVM")


def test_missing_schedulers_and_workers_are_errors(tmp_path, monkeypatch):
    monkeypatch.setattr(cluster, "PATIENCE", 0.5)
    with pytest.raises(ConnectionError, match=r"no Dask scheduler answers at tcp://127.0.0.1:9"):
        cluster.connect("tcp://127.0.0.1:9")
    with (
        distributed.LocalCluster(
            n_workers=0, dashboard_address="127.0.0.1:0", host="127.0.0.1"
        ) as empty,
        pytest.raises(ConnectionError, match="no worker has joined the scheduler at tcp"),
    ):
        cluster.connect(empty.scheduler_address)


# ---- Workers that die, and Ctrl-C ----


class Disturbed(LocalExecutor):
    """Jobs of another executor; something happens after so many results of a `map`."""

    def __init__(self, executor, after, disturb):
        super().__init__()
        self._executor, self._after, self._disturb = executor, after, disturb

    def submit(self, fn, /, *arguments):
        return self._executor.submit(fn, *arguments)

    def map(self, fn, jobs, **options):
        for done, result in enumerate(self._executor.map(fn, jobs)):
            if done == self._after:
                self._disturb()
            yield result


def interrupt():
    """Do what Ctrl-C does."""
    raise KeyboardInterrupt


def test_a_reference_is_the_local_one_bit_for_bit_when_a_worker_dies(both, small_scene, tmp_path):
    """4096 samples, in passes of 64; the local one has all threads of this process."""
    width, height = SMALL_SIZE
    options = {"samples_per_pass": width * height * 64}
    before = pids(both)
    disturbed = Disturbed(both, 10, lambda: kill(both, min(before)))
    there = reference_of(small_scene, tmp_path / "there", 4096, executor=disturbed, **options)
    here = reference_of(small_scene, tmp_path / "here", 4096, **options)
    wait_for(lambda: len(addresses(both)) == 2)
    assert len(pids(both).items() - before.items()) == 1
    assert there.spp == here.spp == 4096
    for name in ("reference", "half_1", "half_2"):
        files = [one.file.with_name(f"{name}.exr") for one in (there, here)]
        np.testing.assert_array_equal(*(read(file) for file in files))
    assert there.errors == here.errors


def test_an_interrupted_reference_goes_on_elsewhere(both, small_scene, tmp_path, count_renders):
    """Begun on the cluster and ended in this process, it is that of one run, bit for bit."""
    with pytest.raises(KeyboardInterrupt):
        reference_of(small_scene, tmp_path / "parts", 24, executor=Disturbed(both, 2, interrupt))
    assert count_renders.made == []
    wait_for(lambda: not any(both.client.processing().values()))
    parts = reference_of(small_scene, tmp_path / "parts", 24)
    assert [spp for spp, _ in count_renders.made] == [4, 4, 4, 4]
    whole = reference_of(small_scene, tmp_path / "whole", 24)
    np.testing.assert_array_equal(read(parts.file), read(whole.file))


def test_a_new_worker_gets_the_files_of_before(both, small_scene):
    job = RenderJob(small_scene, spp=1)
    expected = both.submit(job.run).result().image
    sent = len(both._plugins)
    kill(both, *addresses(both))
    wait_for(lambda: len(addresses(both)) == 2)
    np.testing.assert_array_equal(both.submit(job.run).result().image, expected)
    assert len(both._plugins) == sent


def test_a_job_that_ends_workers_is_an_error(both):
    last = SimpleNamespace(address="tcp://10.0.0.8:1234")
    error = both.explain(distributed.KilledWorker("run-1", last, 3))
    assert str(error).startswith("a job has ended 4 workers, the last one at tcp://10.0.0.8:1234")


# ---- Jobs that are timed ----


def test_timed_jobs_run_on_one_worker_while_the_others_hold_still(both, small_scene):
    jobs = [RenderJob(small_scene, spp=4, seed=seed, warm_up=True) for seed in range(3)]
    address, machine = both.timing_worker()
    assert both.machine() == machine
    with both.alone() as alone:
        held = both.client.processing()
        assert [one for one, keys in held.items() if keys] == [other(both, address)]
        # What anybody sends there waits.
        waiting = both.client.submit(time.time, workers=[other(both, address)], pure=False)
        results = list(alone.map(RenderJob.run, jobs))
        assert {alone.submit(os.getpid).result() for _ in range(4)} == {pids(both)[address]}
        end = time.time()
    for one in results:
        assert (one.machine, one.warm_up) == (machine, results[0].warm_up)
    assert waiting.result(timeout=10) > end
    wait_for(lambda: not any(both.client.processing().values()))


def other(executor, address):
    """The worker that is not this one."""
    (found,) = addresses(executor) - {address}
    return found


def test_two_commands_do_not_time_at_once(both):
    said = []
    with cluster.connect(both.client.scheduler.address, said.append) as another:
        with both.alone():
            waiting = ThreadPoolExecutor(1).submit(enter, another)
            wait_for(lambda: said[1:])
            assert not waiting.done()
        assert waiting.result(timeout=20) == another.timing_worker()
    assert said[1].startswith("Waiting: another command times jobs on this cluster")


def enter(executor):
    """Begin to time, and end at once."""
    with executor.alone():
        return executor.timing_worker()


def test_a_timed_job_begins_again_when_its_worker_dies(both, small_scene):
    address, machine = both.timing_worker()
    job = RenderJob(small_scene, spp=4, seed=1)
    with both.alone() as alone:
        expected = alone.submit(job.run).result().image
        os.kill(pids(both)[address], signal.SIGKILL)  # The scheduler may not know yet.
        again = alone.submit(job.run).result()
    np.testing.assert_array_equal(again.image, expected)
    assert again.machine == machine


# ---- Commands ----


def test_render_on_a_cluster_is_the_local_render(both, small_scene, monkeypatch, tmp_path):
    """In three passes of 8192 samples per pixel."""
    monkeypatch.chdir(tmp_path)
    address = both.client.scheduler.address
    there = invoke("render", small_scene, "--spp", 24576, "-o", "a.exr", "--scheduler", address)
    assert there.exit_code == 0, there.output
    assert "24576 spp, 3 passes" in there.stdout
    assert "Cluster: 2 worker(s)" in there.stderr
    here = invoke("render", small_scene, "--spp", 24576, "-o", "b.exr")
    assert here.exit_code == 0, here.output
    np.testing.assert_array_equal(read("a.exr"), read("b.exr"))
    first, second = (mi.Bitmap(name).metadata() for name in ("a.exr", "b.exr"))
    for name in ("scene", "scene_digest", "spp", "passes", "seed", "parameters"):
        assert first[name] == second[name]
    assert first["machine"].endswith(f"1 threads, on {platform.node()}")


def test_a_comparison_on_a_cluster_has_the_errors_of_a_local_one(both, small_scene, tmp_path):
    few = {"spp": (2,), "seeds": 1}
    here = run(small_scene, tmp_path / "here", **few)
    there = run(small_scene, tmp_path / "there", executor=both, **few)
    assert there.machine == both.machine() != here.machine
    for strategy in here.strategies:
        assert here.series(strategy)[0].values == there.series(strategy)[0].values
    assert here.reference.errors == there.reference.errors
    said = []
    run(small_scene, tmp_path / "there", said, executor=both, **few)
    assert said[0] == "Pictures at equal samples: 2 of 2 reused"
    assert said[-1] == "Reference: reused, 16 spp"


def test_compare_takes_the_options_of_a_cluster(small_scene, tmp_path, monkeypatch):
    monkeypatch.setattr(cluster, "PATIENCE", 0.5)
    result = invoke(
        "compare", small_scene, "--sampling", "area", "--spp", 2, "--reference-spp", 2,
        "-o", tmp_path / "out", "--scheduler", "tcp://127.0.0.1:9",
    )  # fmt: skip
    assert result.exit_code == 1
    assert "no Dask scheduler answers at tcp://127.0.0.1:9" in result.stderr


def test_workers_of_this_machine(small_scene, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    options = ("--spp", 16)
    there = invoke("render", small_scene, *options, "-o", "a.exr", "--workers", 1)
    assert there.exit_code == 0, there.output
    assert "Cluster: 1 worker(s) with 1 thread(s)" in there.stderr
    assert invoke("render", small_scene, *options, "-o", "b.exr").exit_code == 0
    np.testing.assert_array_equal(read("a.exr"), read("b.exr"))


def test_one_place_at_a_time(small_scene):
    result = invoke("render", small_scene, "--scheduler", "tcp://x:1", "--workers", 2)
    assert result.exit_code == 1
    assert "--scheduler and --workers exclude each other" in result.stderr


def test_without_dask_the_error_says_what_to_install(small_scene):
    code = (
        "import sys; sys.modules['distributed'] = None\n"
        "from mi_ellipse import cli; sys.argv = ['mi-ellipse', 'render', "
        f"{str(small_scene)!r}, '--workers', '1']; cli.main()"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 1
    assert done.stderr == (
        "mi-ellipse: a cluster needs the package distributed: pip install 'mi_ellipse[cluster]'\n"
    )


# ---- The end ----


def test_nothing_stays_on_the_workers(both, small_scene):
    address = both.client.scheduler.address

    def left():
        folders = both.client.run(lambda dask_worker: os.listdir(dask_worker.local_directory))
        return Counter(name for names in folders.values() for name in names)

    before = left()
    with cluster.connect(address) as mine:
        mine.submit(RenderJob(small_scene, spp=1).run).result()
        assert left() - before == {f"mi_ellipse-{mine.session}": 2}
    assert left() == before
