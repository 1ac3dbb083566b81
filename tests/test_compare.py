"""Comparisons end to end on a tiny scene: what they leave, what they reuse, what they refuse."""

import csv
import dataclasses
import json
import subprocess
import sys
from types import SimpleNamespace

import mitsuba as mi
import numpy as np
import pytest
from conftest import SMALL_SCENE, SMALL_SIZE
from mi_ellipse import cli
from mi_ellipse.rendering import passes, provenance
from mi_ellipse.rendering.job import RenderJob, Timing
from mi_ellipse.study import compare, figures
from mi_ellipse.study.compare import match_samples
from mi_ellipse.study.pictures import Gallery, Task
from mi_ellipse.study.reference import render_reference
from mi_ellipse.study.results import EQUAL_SAMPLES, EQUAL_TIME
from typer.testing import CliRunner

STRATEGIES = ("area", "solid_angle")
SPP = (2, 8)
SEEDS = 2
WIDTH, HEIGHT = SMALL_SIZE


@pytest.fixture(autouse=True)
def _variant():
    mi.set_variant("llvm_ad_rgb")


@pytest.fixture
def scene_file(tmp_path):
    file = tmp_path / "scene.xml"
    file.write_text(SMALL_SCENE)
    return file


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A comparison made by the command: its folder, its arguments and what it printed."""
    folder = tmp_path_factory.mktemp("comparison")
    (folder / "scene.xml").write_text(SMALL_SCENE)
    arguments = [
        "compare", folder / "scene.xml", "--sampling", ",".join(STRATEGIES), "--spp", "8,2",
        "--reference-spp", 64, "--seeds", SEEDS, "-o", folder / "out", "-D", "radiance=2",
        "--inset", "1,2,6,5",
    ]  # fmt: skip
    result = CliRunner().invoke(cli.app, [str(argument) for argument in arguments])
    assert result.exit_code == 0, result.output
    return SimpleNamespace(folder=folder / "out", scene_file=folder / "scene.xml", result=result)


def run(scene_file, folder, said=None, **changes):
    settings = {"strategies": STRATEGIES, "spp": SPP, "reference_spp": 16, "seeds": SEEDS}
    say = (said if said is not None else []).append
    return compare(scene_file, folder, **(settings | changes), say=say)


def read(file):
    return np.array(mi.Bitmap(str(file)))


@pytest.fixture
def count_renders(monkeypatch):
    """The (spp, seed) of every render from now on; `stop_after` ones, the next is interrupted."""
    calls = SimpleNamespace(made=[], stop_after=None)
    original = passes.render

    def counting(scene, spp=None, seed=0, *arguments):
        if calls.stop_after is not None and len(calls.made) >= calls.stop_after:
            raise KeyboardInterrupt
        calls.made.append((spp, seed))
        return original(scene, spp, seed, *arguments)

    monkeypatch.setattr(passes, "render", counting)
    return calls


# ---- What a comparison leaves ----


def test_files(finished):
    found = {file.relative_to(finished.folder).as_posix() for file in finished.folder.rglob("*")}
    expected = {"results.csv", "results.json", "report.html", "reference/reference.exr"}
    expected |= {"reference/reference.png", "figures/time.pdf", "figures/mse_against_time.png"}
    expected |= {
        f"figures/pictures_{k}_{n}spp.pdf" for k in ("equal_samples", "equal_time") for n in SPP
    }
    for sampling in STRATEGIES:
        for spp in SPP:
            expected.add(f"pictures/{sampling}_{spp}spp_seed1.png")
            expected |= {f"pictures/{sampling}_{spp}spp_seed{i}.exr" for i in (1, 2)}
    assert expected <= found
    assert not any("/." in name or name.startswith(".") for name in found)  # nothing half-written


def test_pictures_are_those_of_mitsuba_and_say_how_they_were_made(finished):
    file = finished.folder / "pictures" / "area_8spp_seed2.exr"
    metadata = mi.Bitmap(str(file)).metadata()
    assert (metadata["sampling"], metadata["spp"], metadata["seed"]) == ("area", "8", "2")
    assert json.loads(metadata["parameters"]) == {"radiance": "2"}
    scene = mi.load_string(
        SMALL_SCENE.replace(
            '"ellipticalarea">', '"ellipticalarea"><string name="sampling" value="area"/>'
        ),
        radiance="2",
    )
    np.testing.assert_allclose(
        read(file), mi.render(scene, spp=8, seed=2).numpy(), rtol=1e-5, atol=1e-6
    )


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


def test_results_follow_from_the_pictures(finished):
    with open(finished.folder / "results.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 2 * len(STRATEGIES) * len(SPP)
    reference = read(finished.folder / "reference" / "reference.exr")

    by_key = {(row["kind"], row["sampling"], row["first_spp"]): row for row in rows}
    for row in rows:
        images = [
            read(finished.folder / "pictures" / f"{row['sampling']}_{row['spp']}spp_seed{seed}.exr")
            for seed in (1, 2)
        ]
        mse = [np.mean((image.astype(float) - reference) ** 2) for image in images]
        assert float(row["mse"]) == pytest.approx(np.mean(mse))
        assert float(row["mse_standard_error"]) == pytest.approx(abs(mse[0] - mse[1]) / 2)
        assert float(row["rmse"]) == pytest.approx(np.mean(np.sqrt(mse)))
        assert 0 < float(row["flip"]) < 1
        parts = [float(row[f"{part}_seconds"]) for part in ("tracing", "execution", "compilation")]
        assert all(part >= 0 for part in parts)
        assert parts[1] > 0
        assert float(row["seconds"]) > parts[1] / 2

        first = by_key[row["kind"], "area", row["first_spp"]]
        cost, first_cost = (float(one["mse"]) * float(one["seconds"]) for one in (row, first))
        assert float(row["efficiency_mse"]) == pytest.approx(first_cost / cost)
    assert float(by_key[EQUAL_SAMPLES, "solid_angle", "8"]["efficiency_mse"]) != 1


def test_results_in_json_know_no_nan(scene_file, tmp_path):
    run(scene_file, tmp_path / "out", seeds=1, spp=(2,))

    def refuse(constant):
        pytest.fail(f"{constant} is no JSON")

    document = json.loads((tmp_path / "out" / "results.json").read_text(), parse_constant=refuse)
    assert "standard_error" not in document["measurements"][0]["errors"]["mse"]


def test_insufficient_reference_is_announced(finished):
    assert "WARNING: The reference's own" in finished.result.stderr
    assert json.loads((finished.folder / "results.json").read_text())["warnings"]


def test_sufficient_reference_is_not(scene_file, tmp_path):
    assert run(scene_file, tmp_path / "out", spp=(2,), reference_spp=4096).warnings() == []


# ---- Reuse ----


def test_second_run_reuses_everything(finished, count_renders):
    before = (finished.folder / "results.csv").read_bytes()
    said = []
    run(finished.scene_file, finished.folder, said, reference_spp=64, parameters={"radiance": "2"})
    assert count_renders.made == []
    assert said[0] == "Pictures at equal samples: 8 of 8 reused"
    assert said[-1] == "Reference: reused, 64 spp"
    assert (finished.folder / "results.csv").read_bytes() == before


def test_other_seeds_and_counts_are_missing(finished):
    gallery = Gallery(finished.folder / "pictures", finished.scene_file, {"radiance": "2"})
    assert gallery.find(Task(2, "area", 8))
    assert gallery.find(Task(3, "area", 8)) is None
    assert gallery.find(Task(2, "area", 4)) is None


@pytest.mark.parametrize("change", ["parameters", "scene", "variant", "code"])
def test_other_settings_do_not_fit(finished, tmp_path, monkeypatch, change):
    parameters, scene_file = {"radiance": "2"}, finished.scene_file
    if change == "parameters":
        parameters["radiance"] = "3"
    elif change == "scene":
        scene_file = tmp_path / "scene.xml"
        scene_file.write_text(SMALL_SCENE.replace("0,-4,3", "0,-5,3"))
    elif change == "variant":
        mi.set_variant("llvm_ad_spectral")
    else:
        monkeypatch.setattr(provenance, "picture_digest", lambda: "other")
    gallery = Gallery(finished.folder / "pictures", scene_file, parameters)
    assert gallery.holds(Task(1, "area", 8))
    assert gallery.find(Task(1, "area", 8)) is None


def test_comments_and_the_name_of_the_file_do_not_matter(finished, tmp_path):
    scene_file = tmp_path / "other.xml"
    scene_file.write_text(SMALL_SCENE.replace("<sensor", "<!-- a comment --> <sensor"))
    gallery = Gallery(finished.folder / "pictures", scene_file, {"radiance": "2"})
    assert gallery.find(Task(1, "area", 8))


def test_outdated_pictures_are_replaced_and_an_outdated_reference_is_refused(scene_file, tmp_path):
    folder = tmp_path / "out"
    run(scene_file, folder, spp=(2,), seeds=1)
    before = read(folder / "pictures" / "area_2spp_seed1.exr")
    said = []
    with pytest.raises(ValueError, match=r"other settings \(scene_digest\)"):
        run(scene_file, folder, said, spp=(2,), seeds=1, parameters={"radiance": "2"})
    assert "Pictures at equal samples: 2 were made with other settings and are replaced" in said
    after = read(folder / "pictures" / "area_2spp_seed1.exr")
    np.testing.assert_allclose(after, 2 * before, rtol=1e-5, atol=1e-6)


# ---- Interruptions ----


def test_pictures_go_on_after_an_interruption(scene_file, tmp_path, count_renders):
    # A warm-up and two counts for each strategy and seed: 12 renders.
    count_renders.stop_after = 5
    with pytest.raises(KeyboardInterrupt):
        run(scene_file, tmp_path / "out")
    kept = [file.name for file in (tmp_path / "out" / "pictures").iterdir()]
    assert len(kept) == 3

    count_renders.stop_after, count_renders.made = None, []
    said = []
    run(scene_file, tmp_path / "out", said)
    assert said[0] == "Pictures at equal samples: 3 of 8 reused"


def reference_of(scene_file, folder, spp, said=None):
    return render_reference(
        folder,
        scene_file,
        {},
        spp,
        lambda done, total: None,
        (said if said is not None else []).append,
        samples_per_pass=WIDTH * HEIGHT * 4,
    )


def test_reference_goes_on_after_an_interruption(scene_file, tmp_path, count_renders):
    whole = reference_of(scene_file, tmp_path / "whole", 24)
    passes, count_renders.made = count_renders.made, []
    assert [spp for spp, _ in passes] == [4] * 6
    assert len({seed for _, seed in passes}) == 6

    count_renders.stop_after = 3
    with pytest.raises(KeyboardInterrupt):
        reference_of(scene_file, tmp_path / "parts", 24)
    count_renders.stop_after, said = None, []
    parts = reference_of(scene_file, tmp_path / "parts", 24, said)
    assert said == ["Reference: continued from 12 of 24 spp"]
    assert count_renders.made == passes
    np.testing.assert_allclose(read(parts.file), read(whole.file), rtol=1e-5, atol=1e-6)
    assert parts.errors["mse"] == pytest.approx(whole.errors["mse"], rel=1e-4)


def test_reference_grows_and_is_reused_where_it_suffices(scene_file, tmp_path, count_renders):
    small = reference_of(scene_file, tmp_path, 10)
    assert (small.spp, [spp for spp, _ in count_renders.made]) == (10, [4, 4, 1, 1])
    large = reference_of(scene_file, tmp_path, 16)
    assert (large.spp, [spp for spp, _ in count_renders.made[4:]]) == (16, [3, 3])
    assert len({seed for _, seed in count_renders.made}) == 6
    assert mi.Bitmap(str(large.file)).metadata()["spp"] == "16"
    assert reference_of(scene_file, tmp_path, 8).spp == 16
    assert len(count_renders.made) == 6


# ---- Equal time ----


@pytest.mark.parametrize(
    ("seconds", "measured", "expected"),
    [
        (1.0, [0.5, 1.0, 2.0], 20),
        (1.1, [0.6, 1.1, 2.1], 20),  # 0.1 s whatever the samples
        (0.05, [0.6, 1.1, 2.1], 1),  # not even one sample fits
        (4.1, [0.6, 1.1, 2.1], 80),
        (1.0, [2.0, 1.9, 1.8], 22),  # noise alone: in proportion to the last
    ],
)
def test_match_samples(seconds, measured, expected):
    assert match_samples(seconds, [10, 20, 40], measured) == expected


def test_match_samples_from_a_single_count():
    assert match_samples(3.0, [16], [2.0]) == 24


def test_equal_time_takes_the_samples_that_match(scene_file, tmp_path, monkeypatch):
    """A strategy that takes twice as long gets half the samples."""
    original = RenderJob.run

    def run_timed(job):
        seconds = 0.01 * job.spp * (2 if job.sampling == "solid_angle" else 1)
        timing = Timing(seconds, 0.0, 0.0, seconds)
        return dataclasses.replace(original(job), timing=timing)

    def timed_or_reference(job):
        return run_timed(job) if job.sampling else original(job)

    monkeypatch.setattr(RenderJob, "run", timed_or_reference)
    comparison = run(scene_file, tmp_path / "out")
    for spp in SPP:
        first = comparison.find(EQUAL_TIME, "area", spp)
        second = comparison.find(EQUAL_TIME, "solid_angle", spp)
        assert (first.spp, second.spp, second.pictures[0].spp) == (spp, spp // 2, spp // 2)
        assert first.seconds == pytest.approx(second.seconds)
        slower = comparison.find(EQUAL_SAMPLES, "solid_angle", spp)
        assert slower.seconds == pytest.approx(2 * first.seconds)


# ---- Refusals ----


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_invalid_pixels_are_refused(scene_file, tmp_path, monkeypatch, value):
    original = passes.render

    def broken(*arguments):
        rendering = original(*arguments)
        image = rendering.image.copy()
        image[3, 5, 1] = value
        return dataclasses.replace(rendering, image=image)

    monkeypatch.setattr(passes, "render", broken)
    message = "area at 2 spp, seed 1: 1 pixel.* NaN or infinite, the first at x=5, y=3"
    with pytest.raises(ValueError, match=message):
        run(scene_file, tmp_path / "out")
    assert list((tmp_path / "out" / "pictures").iterdir()) == []
    with pytest.raises(ValueError, match="pass 0 of the reference's half 1: 1 pixel"):
        reference_of(scene_file, tmp_path / "reference", 8)


def test_black_reference_is_refused(scene_file, tmp_path):
    with pytest.raises(ValueError, match="reference is black"):
        run(scene_file, tmp_path / "out", spp=(2,), seeds=1, parameters={"radiance": "0"})


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--sampling", "area,nonsense", "--spp", "2"], ['"nonsense"', "solid_angle"]),
        (["--sampling", "area", "--spp", "0"], ["at least 1"]),
    ],
)
def test_errors_take_one_line(scene_file, tmp_path, options, words):
    arguments = ["compare", scene_file, *options, "--reference-spp", "4", "-o", tmp_path / "out"]
    result = CliRunner().invoke(cli.app, [str(argument) for argument in arguments])
    assert result.exit_code == 1
    assert result.stderr.startswith("mi-ellipse: ")
    assert result.stderr.count("\n") == 1
    for word in words:
        assert word in result.stderr


@pytest.mark.parametrize("option", [["--spp", "8,x"], ["--spp", "8", "--inset", "1,2,3"]])
def test_malformed_options(scene_file, option):
    arguments = ["compare", scene_file, "--sampling", "area", *option, "--reference-spp", "4"]
    result = CliRunner().invoke(cli.app, [str(a) for a in [*arguments, "-o", scene_file.parent]])
    assert result.exit_code == 2
    assert option[-2] in result.stderr


# ---- Figures ----


def test_insets_lie_where_the_strategies_differ():
    reference = np.full((60, 80, 3), 0.8)
    good, bad = reference.copy(), reference.copy()
    bad[10:20, 30:40] += 0.1
    bad[40:50, 60:70] += 0.05
    good[:, :10] += 0.2  # both are wrong here
    bad[:, :10] += 0.2
    comparison = SimpleNamespace(
        strategies=("good", "bad"),
        exposure=0.0,
        reference_image=lambda: reference,
        series=lambda name: [name],
        image=lambda name: {"good": good, "bad": bad}[name],
    )
    assert figures.choose_insets(comparison) == [(30, 10, 10, 10), (60, 40, 10, 10)]


@pytest.mark.parametrize(
    ("insets", "message"),
    [
        ([(20, 2, 5, 5)], "20,2,5,5 is not inside the picture of 24 × 16"),
        ([(1, 2, 5, 0)], "not inside"),
        ([(1, 2, 5, 5)] * 5, "5 insets"),
    ],
)
def test_impossible_insets_are_refused(finished, insets, message):
    comparison = run(
        finished.scene_file, finished.folder, reference_spp=64, parameters={"radiance": "2"}
    )
    with pytest.raises(ValueError, match=message):
        figures.write_figures(comparison, insets)


def test_missing_extra_is_announced_at_once():
    code = "import mi_ellipse, sys; sys.modules['flip_evaluator'] = None; import mi_ellipse.study"
    process = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert process.stderr.splitlines()[-1] == (
        "ImportError: comparisons need the package flip_evaluator: pip install 'mi_ellipse[study]'"
    )


def test_other_commands_do_not_load_the_study():
    code = "import mi_ellipse.cli, sys; print({'matplotlib', 'flip_evaluator'} & set(sys.modules))"
    process = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert process.stdout == "set()\n"


def test_labels_are_spread_no_further_than_needed():
    apart = np.array([0.1, 0.5, 0.9])
    np.testing.assert_allclose(figures._spread(apart, 0.1, 0, 1), apart)
    together = figures._spread(np.array([0.5, 0.5, 0.5]), 0.1, 0, 1)
    np.testing.assert_allclose(together, [0.4, 0.5, 0.6])
    low = figures._spread(np.array([0.0, 0.0, 0.5]), 0.1, 0, 1)
    np.testing.assert_allclose(low, [0, 0.1, 0.5])
    high = figures._spread(np.array([0.2, 1.0, 1.0]), 0.1, 0, 1)
    np.testing.assert_allclose(high, [0.2, 0.9, 1.0])
