"""The study compares what its commands say, and its intervals are those of its seeds."""

import shlex

import numpy as np
import pytest
import typer
from mi_ellipse.cli import app

from benchmarks import study, study_page


@pytest.mark.parametrize("case", study.CASES, ids=lambda case: case.name)
def test_commands_are_those_of_the_comparison(case):
    """The command line reads them as the benchmark calls `compare`."""
    program, name, *arguments = shlex.split(case.command)
    assert (program, name) == ("mi-ellipse", "compare")
    command = typer.main.get_command(app).commands[name]
    read = command.make_context(name, arguments).params
    assert (study.ROOT / read["scene_file"]).resolve() == study.SCENES / f"{case.scene}.xml"
    assert (study.ROOT / read["output"]).resolve() == study.FOLDER / case.name
    assert read["sampling"].split(",") == list(case.strategies)
    assert [int(spp) for spp in read["spp"].split(",")] == list(case.spp)
    assert read["seeds"] == study.SEEDS
    assert read["reference_spp"] == case.reference_spp


def test_intervals_hold_the_ratio():
    """95 % of them, of 2 000 ratios of two independent means whose ratio is known to be 2."""
    rng = np.random.default_rng(1)
    held = 0
    for _ in range(2000):
        first, others = (rng.normal(mean, 0.05 * mean, 8) for mean in (2.0, 1.0))
        own = study.ratio_of_independent(first, others)
        held += own["low"] < 2 < own["high"]
    # Student's t of one sample's degrees of freedom is a little too wide for two samples.
    assert 0.94 < held / 2000 < 0.99


def test_the_choice_of_the_lamp_is_most_of_the_error(llvm_ad_rgb, monkeypatch):
    """Two lamps that Mitsuba picks have more than twice the error of those that choose."""
    monkeypatch.setattr(study, "PARTS_SPP", 4)
    picked, chosen = (
        np.mean(study.error(f"solid_angle{mark}", {}, True, study.LIGHT_SAMPLES))
        for mark in (study.UNGROUPED, "")
    )
    alone = np.mean(study.error("solid_angle", {}, False, study.LIGHT_SAMPLES))
    assert alone < chosen < 0.5 * picked


def test_widest_interval():
    values = [{"value": 2, "low": 1.9, "high": 2.2}, {"value": 1, "low": 0.8, "high": 1.1}]
    assert study_page.widest(values) == "25 %"
