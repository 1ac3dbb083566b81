"""Comparisons end to end on a tiny scene: what they leave and what they refuse."""

import csv
import dataclasses
import json
import subprocess
import sys

import matplotlib.figure
import mitsuba as mi
import numpy as np
import OpenEXR
import pytest
from comparisons import SEEDS, SPP, STRATEGIES, arguments_of, read, reference_of, run
from conftest import SMALL_SCENE
from mi_ellipse import cli
from mi_ellipse.files import images
from mi_ellipse.rendering import passes
from mi_ellipse.rendering.job import RenderJob, Timing
from mi_ellipse.study import compare, results
from mi_ellipse.study.report import write_report
from mi_ellipse.study.results import EQUAL_SAMPLES, EQUAL_TIME
from mi_ellipse.study.statistics import Spread
from typer.testing import CliRunner

# Grids of pictures for two kinds and two counts; curves of time, and of four metrics against two
FIGURES = 2 * 2 + 1 + 4 * 2

pytestmark = pytest.mark.usefixtures("llvm_ad_rgb")


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
        gain = float(first["mse"]) / float(row["mse"])
        # The median of reciprocal values of two seeds is not that of the values.
        low, high = (gain / float(row[f"time_ratio_{end}"]) for end in ("high", "low"))
        assert float(row["efficiency_mse"]) == pytest.approx((low + high) / 2)
    assert float(by_key[EQUAL_SAMPLES, "solid_angle", "8"]["efficiency_mse"]) != 1


@pytest.mark.parametrize("spp", SPP)
def test_one_file_of_several_parts_holds_what_a_viewer_steps_through(finished, spp):
    file = finished.folder / "pictures" / f"all_{spp}spp.exr"
    parts = images.read_parts(file)
    assert list(parts) == ["reference", *STRATEGIES, *(f"{s}_difference" for s in STRATEGIES)]
    reference = read(finished.folder / "reference" / "reference.exr")
    # Half precision has 11 significant bits, and steps of 2⁻²⁴ near zero.
    as_half = {"rtol": 2.0**-11, "atol": 2.0**-24}
    np.testing.assert_allclose(parts["reference"], reference, **as_half)
    for name in STRATEGIES:
        single = read(finished.folder / "pictures" / f"{name}_{spp}spp_seed1.exr")
        np.testing.assert_allclose(parts[name], single, **as_half)
        np.testing.assert_allclose(parts[f"{name}_difference"], single - reference, **as_half)
    channels = OpenEXR.File(str(file), separate_channels=True).parts[0].channels
    assert {channel.pixels.dtype for channel in channels.values()} == {np.dtype(np.float16)}
    metadata = images.read_metadata(file)
    assert (metadata["spp"], metadata["seed"]) == (str(spp), "1")


def test_a_bright_picture_is_kept_whole_in_single_precision(small_scene, tmp_path):
    """Half precision ends at 65504."""
    run(small_scene, tmp_path, spp=(2,), seeds=1, parameters={"radiance": "1e6"})
    picture = read(tmp_path / "pictures" / "area_2spp_seed1.exr")
    assert picture.max() > 65504
    np.testing.assert_array_equal(
        images.read_parts(tmp_path / "pictures" / "all_2spp.exr")["area"], picture
    )


def test_insufficient_reference_is_announced(finished):
    assert "WARNING: The reference's own" in finished.result.stderr
    assert json.loads((finished.folder / "results.json").read_text())["warnings"]


def test_sufficient_reference_is_not(small_scene, tmp_path):
    warnings = run(small_scene, tmp_path / "out", spp=(2,), reference_spp=4096).warnings()
    assert not [one for one in warnings if "reference" in one]


# ---- Once and no more ----


@pytest.fixture
def count_reads(monkeypatch):
    """Names of the OpenEXR files whose pixels are read from now on, one entry a read."""
    names = []
    original = OpenEXR.File

    def counting(*arguments, **options):
        if arguments and isinstance(arguments[0], str) and not options.get("header_only"):
            names.append(arguments[0])
        return original(*arguments, **options)

    monkeypatch.setattr(OpenEXR, "File", counting)
    monkeypatch.setattr(mi, "Bitmap", refuse_files(mi.Bitmap))
    return names


def refuse_files(original):
    """Make a way to read pictures fail that `count_reads` would not see."""

    def bitmap(source, *arguments, **options):
        assert not isinstance(source, str), f"{source} is read through Mitsuba"
        return original(source, *arguments, **options)

    # What the package asks the class for
    bitmap.PixelFormat, bitmap.FileFormat = original.PixelFormat, original.FileFormat
    return bitmap


@pytest.fixture
def count_figures(monkeypatch):
    """One entry for each figure that is drawn from now on."""
    made = []
    original = matplotlib.figure.Figure.__init__

    def counting(figure, *arguments, **options):
        made.append(figure)
        original(figure, *arguments, **options)

    monkeypatch.setattr(matplotlib.figure.Figure, "__init__", counting)
    return made


def test_each_picture_is_read_once_and_each_figure_drawn_once(
    small_scene, tmp_path, count_reads, count_figures
):
    folder = tmp_path / "out"
    arguments = arguments_of(small_scene, folder)
    references = {
        str(folder / "reference" / f"{name}.exr") for name in ("half_1", "half_2", "reference")
    }
    for made in ("rendered", "reused"):
        result = CliRunner().invoke(cli.app, arguments)
        assert result.exit_code == 0, result.output
        pictures = {str(file) for file in folder.glob("pictures/*_seed?.exr")}
        assert len(pictures) >= SEEDS * len(STRATEGIES) * len(SPP)
        # What has just been rendered need not be read at all.
        read = set(count_reads)
        assert read == (set() if made == "rendered" else pictures | references)
        assert len(count_reads) == len(read)
        assert len(count_figures) == len(list((folder / "figures").glob("*.pdf"))) == FIGURES
        count_reads.clear()
        count_figures.clear()


def test_a_report_reads_what_it_shows_once(finished, count_reads, count_figures):
    result = CliRunner().invoke(cli.app, ["report", str(finished.folder)])
    assert result.exit_code == 0, result.output
    comparison = results.read(finished.folder)
    shown = {str(one.pictures[0].file) for one in comparison.measurements}
    assert sorted(count_reads) == sorted({*shown, str(comparison.reference.file)})
    assert len(count_figures) == FIGURES


# ---- Equal time ----


def timed(seconds):
    """A way to run jobs that says that one took `seconds(job, number of renders before)`."""
    original = RenderJob.run
    made = []

    def run_timed(job):
        rendering = original(job)
        if job.sampling is None:
            return rendering  # of the reference
        made.append(job)
        taken = seconds(job, len(made) - 1)
        return dataclasses.replace(rendering, timing=Timing(taken, 0.0, 0.0, taken))

    return run_timed


def twice_as_slow(job, _):
    return 0.01 * job.spp * (2 if job.sampling == "solid_angle" else 1)


def test_equal_time_takes_the_samples_that_match(small_scene, tmp_path, monkeypatch):
    """A strategy that takes twice as long gets half the samples."""
    monkeypatch.setattr(RenderJob, "run", timed(twice_as_slow))
    comparison = run(small_scene, tmp_path / "out")
    for spp in SPP:
        first = comparison.find(EQUAL_TIME, "area", spp)
        second = comparison.find(EQUAL_TIME, "solid_angle", spp)
        assert (first.spp, second.spp, second.pictures[0].spp) == (spp, spp // 2, spp // 2)
        assert first.seconds == second.seconds == Spread(*[pytest.approx(0.01 * spp)] * 3)
        slower = comparison.find(EQUAL_SAMPLES, "solid_angle", spp)
        assert slower.seconds.median == pytest.approx(2 * first.seconds.median)
        assert slower.ratio == Spread(*[pytest.approx(2)] * 3)
    assert not [one for one in comparison.warnings() if "time" in one]


def test_a_machine_that_slows_down_does_not_turn_a_comparison_round(
    small_scene, tmp_path, monkeypatch
):
    """
    Each render takes 3 % longer than the one before, and each seed's errors are the same as ever.

    Without turns, matched pictures would be compared with times of a machine that was much
    faster: at 32 samples of the bunny, that made an efficiency of 1.22 one of 0.81.
    """
    monkeypatch.setattr(RenderJob, "run", timed(lambda job, n: twice_as_slow(job, n) * 1.03**n))
    drifting = run(small_scene, tmp_path / "drifting")
    seconds = [one.seconds.median for one in drifting.measurements if one.sampling == "area"]
    assert max(seconds[2:]) > 1.4 * max(seconds[:2])  # at equal time, against equal samples
    monkeypatch.setattr(RenderJob, "run", timed(twice_as_slow))
    steady = run(small_scene, tmp_path / "steady")
    for found, expected in zip(drifting.measurements, steady.measurements, strict=True):
        assert (found.sampling, found.spp) == (expected.sampling, expected.spp)
        if found.sampling != "area":
            assert found.ratio.median == pytest.approx(expected.ratio.median)
            assert found.efficiency["mse"].value == pytest.approx(
                expected.efficiency["mse"].value, rel=1e-4  # renders round in changing order
            )  # fmt: skip


def test_what_is_not_of_equal_time_is_announced(small_scene, tmp_path, monkeypatch):
    """Matched pictures take half as long again as the times at equal samples let expect."""

    def surprising(job, number):
        return twice_as_slow(job, number) * (1.5 if job.spp in (1, 4) else 1)

    monkeypatch.setattr(RenderJob, "run", timed(surprising))
    comparison = run(small_scene, tmp_path / "out")
    matched = comparison.find(EQUAL_TIME, "solid_angle", 8)
    assert (matched.spp, matched.ratio.median) == (4, pytest.approx(1.5))
    assert (
        "At equal time, solid_angle at 1 spp took 1.50 times as long as area at 2 (and 1 more):"
        " these errors are not those of equal times." in comparison.warnings()
    )
    text = write_report(comparison).read_text(encoding="utf-8")
    assert "these errors are not those of equal times" in text


def test_a_machine_that_is_not_as_fast_as_itself_is_announced(small_scene, tmp_path, monkeypatch):
    """Each render takes 15 % longer than the one before."""
    monkeypatch.setattr(RenderJob, "run", timed(lambda job, n: twice_as_slow(job, n) * 1.15**n))
    comparison = run(small_scene, tmp_path / "out")
    # Two blocks of two counts lie between.
    assert (
        "area at 2 spp, timed beside itself, took 0.57 times as long (and 3 more): the machine was"
        " busy. Efficiencies and equal times are no better than that." in comparison.warnings()
    )


# ---- Refusals ----


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_invalid_pixels_are_refused(small_scene, tmp_path, monkeypatch, value):
    original = passes.render

    def broken(*arguments):
        rendering = original(*arguments)
        image = rendering.image.copy()
        image[3, 5, 1] = value
        return dataclasses.replace(rendering, image=image)

    monkeypatch.setattr(passes, "render", broken)
    message = "area at 2 spp, seed 1: 1 pixel.* NaN or infinite, the first at x=5, y=3"
    with pytest.raises(ValueError, match=message):
        run(small_scene, tmp_path / "out")
    assert list((tmp_path / "out").rglob("*.exr")) == []
    with pytest.raises(ValueError, match="pass 0 of the reference's half 1: 1 pixel"):
        reference_of(small_scene, tmp_path / "reference", 8)


@pytest.mark.parametrize(("spp", "reference_spp"), [((2, 2**33), 4), ((2,), 10**20), ((0,), 4)])
def test_impossible_numbers_of_samples_are_refused_before_rendering(
    small_scene, tmp_path, spp, reference_spp
):
    with pytest.raises(ValueError, match="samples per pixel are from 1 to 4294967295"):
        compare(small_scene, tmp_path / "out", ("area",), spp, reference_spp)
    assert not (tmp_path / "out").exists()


def test_reference_of_too_many_passes_is_refused(small_scene, tmp_path):
    with pytest.raises(ValueError, match=r"spp=4294967294: .* passes, and at most 1048576"):
        reference_of(small_scene, tmp_path, 2**32 - 2)


def test_black_reference_is_refused(small_scene, tmp_path):
    with pytest.raises(ValueError, match="reference is black"):
        run(small_scene, tmp_path / "out", spp=(2,), seeds=1, parameters={"radiance": "0"})


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--sampling", "area,nonsense", "--spp", "2"], ['"nonsense"', "solid_angle"]),
        (["--sampling", "area+grouped", "--spp", "2"], ['"area+grouped"', "solid_angle"]),
        (["--sampling", "area", "--spp", "0"], ["spp=0", "from 1"]),
    ],
)
def test_errors_take_one_line(small_scene, tmp_path, options, words):
    arguments = ["compare", small_scene, *options, "--reference-spp", "4", "-o", tmp_path / "out"]
    result = CliRunner().invoke(cli.app, [str(argument) for argument in arguments])
    assert result.exit_code == 1
    assert result.stderr.startswith("mi-ellipse: ")
    assert result.stderr.count("\n") == 1
    for word in words:
        assert word in result.stderr


@pytest.mark.parametrize("option", [["--spp", "8,x"], ["--spp", "8", "--inset", "1,2,3"]])
def test_malformed_options(small_scene, option):
    arguments = ["compare", small_scene, "--sampling", "area", *option, "--reference-spp", "4"]
    result = CliRunner().invoke(cli.app, [str(a) for a in [*arguments, "-o", small_scene.parent]])
    assert result.exit_code == 2
    assert option[-2] in result.stderr


# ---- Lamps of an existing scene ----


def test_built_in_lamps_are_a_baseline_and_lamps_have_their_own_strategies(small_scene, tmp_path):
    """The scene has `area` alone: one comparison with it, and with what it is converted to."""
    text = SMALL_SCENE.replace('"ellipse"', '"disk" id="a/b"').replace("ellipticalarea", "area")
    small_scene.write_text(text)
    out = tmp_path / "out"
    arguments = [
        "compare", small_scene, "--sampling", "built-in,a/b=area+solid_angle,solid_angle",
        "--spp", 2, "--seeds", 1, "--reference-spp", 64, "-o", out,
        "--convert-lamps", "--no-grouping",
    ]  # fmt: skip
    result = CliRunner().invoke(cli.app, [str(argument) for argument in arguments])
    assert result.exit_code == 0, result.output
    assert "1 lamp converted" in result.stderr
    comparison = results.read(out)
    names = ("built-in", "a/b=area+solid_angle+ungrouped", "solid_angle+ungrouped")
    assert comparison.strategies == names
    assert comparison.settings["convert_lamps"] == "yes"

    pictures = [read(comparison.find(EQUAL_SAMPLES, name, 2).pictures[0].file) for name in names]
    expected = mi.render(mi.load_string(text), spp=2, seed=1).numpy()
    np.testing.assert_allclose(pictures[0], expected, rtol=1e-5, atol=1e-6)
    # The strategy `area` draws the points that Mitsuba draws.
    np.testing.assert_allclose(pictures[1], expected, rtol=1e-4, atol=1e-6)
    assert not np.allclose(pictures[2], expected, rtol=1e-2)
    assert mi.Bitmap(str(out / "reference" / "reference.exr")).metadata()["convert_lamps"] == "yes"
    page = (out / "report.html").read_text()
    assert "built-in" in page


# ---- Packages ----


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
