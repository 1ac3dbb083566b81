"""The table of limits finds its values in `docs/data`, and its verdicts are those of the values."""

import json
import re

import numpy as np
import pytest

from benchmarks import limits, measured
from benchmarks.measured import Limit, Measured, Verdict, around, at, quotient
from benchmarks.text import ROOT

ALL = limits.limits()


def read(name):
    document = json.loads((ROOT / "docs" / "data" / f"{name}.json").read_text(encoding="utf-8"))
    return document.get(name, document)


def limit(most, bound, *value, what="a thing"):
    return Limit("things", what, most, bound, lambda: Measured(*value), "It is so.")


@pytest.mark.parametrize("entry", ALL, ids=lambda entry: f"{entry.subject}: {entry.what}")
def test_every_limit_has_its_value(entry):
    found = entry.measure()
    low, high = found.ends
    assert 0 < found.value < np.inf
    assert low <= found.value <= high
    # A reason stays true when a value moves
    assert entry.reason.endswith(".")
    assert not re.search(r"\d", entry.reason)


def test_limits_are_told_apart():
    names = [(entry.subject, entry.what) for entry in ALL]
    assert len(set(names)) == len(names)
    subjects = [subject for subject, _ in names]
    assert [s for k, s in enumerate(subjects) if s not in subjects[:k]] == [
        s for k, s in enumerate(subjects) if k == 0 or s != subjects[k - 1]
    ]  # The entries of a subject stand together: it has one table


def test_values_are_those_of_the_benchmarks():
    """Against what the benchmarks computed themselves, or against their data, read again."""
    error, choice = read("error")["heights"], read("choice")
    for height, strategy in (("0.25", "projected_solid_angle"), ("0.6", "solid_angle")):
        row = error[height]["light samples"][strategy]
        plain, above = (limits.gain(height, "light samples", strategy, k) for k in (False, True))
        assert plain.value == pytest.approx(row["gain_trimmed"])
        assert above.value == pytest.approx(row["gain_above_floor"])
    row = choice["bunny"]["solid_angle"]
    assert limits.gain_in("bunny", "solid_angle").value == pytest.approx(row["gain"]["trimmed"])
    for strategy in ("solid_angle", "projected_solid_angle"):
        group = read("groups")["cases"]["bunny"]["MIS"][f"{strategy}, grouped"]
        for base in ("ungrouped", "built-in"):
            found = limits.net("bunny", "MIS", strategy, base)
            assert found.value == pytest.approx(group[f"over {base}"]["net"])
        row = read("study")["bunny"]["strategies"][strategy]["256"]
        found = limits.gain_in_study("bunny", strategy).value
        # Of four times, the median of the reciprocals is not the reciprocal of the median.
        assert found == pytest.approx(row["lower"]["value"] / row["time"]["median"], rel=0.05)
        ball = read("ellipsoids")["shapes"]["sphere"]["1.0"]["MIS"][strategy]
        found = limits.solid("sphere", "1.0", "MIS", strategy)
        assert found.value == pytest.approx(ball["error_ratio"])
    fog = read("render_time")["spheres_fog"]["ratios"]["solid_angle"]
    assert vars(at("render_time", "spheres_fog", "ratios", "solid_angle")) == {
        "value": fog["median"],
        "low": fog["low"],
        "high": fog["high"],
    }


def test_all_scenes_of_render_time_have_a_limit():
    named = {entry.what for entry in limits.render_times()}
    for scene in read("render_time"):
        for strategy in ("solid_angle", "projected_solid_angle"):
            assert f"{scene}, `{strategy}`" in named


@pytest.mark.parametrize(
    ("most", "bound", "value", "verdict"),
    [
        (True, 1.05, (1.05,), Verdict.HOLDS),
        (True, 1.05, (1.06,), Verdict.MISSED),
        (True, 1.05, (1.02, 1.0, 1.05), Verdict.HOLDS),
        (True, 1.05, (1.04, 1.0, 1.06), Verdict.WITHIN),
        (True, 1.05, (1.06, 1.05, 1.1), Verdict.WITHIN),
        (True, 1.05, (1.06, 1.051, 1.1), Verdict.MISSED),
        (False, 5, (5,), Verdict.HOLDS),
        (False, 5, (4.9,), Verdict.MISSED),
        (False, 5, (7, 5, 9), Verdict.HOLDS),
        (False, 5, (7, 4.9, 9), Verdict.WITHIN),
        (False, 5, (4.5, 4, 5), Verdict.WITHIN),
        (False, 5, (4.5, 4, 4.9), Verdict.MISSED),
    ],
)
def test_verdict(most, bound, value, verdict):
    assert limit(most, bound).verdict(Measured(*value)) is verdict


@pytest.mark.parametrize("value", [(1.234,), (1.2, 1.1, 1.234), (0.02506,), (987.6, 950.0, 1234.5)])
@pytest.mark.parametrize("most", [True, False])
def test_bound_in_the_place_of_a_limit_holds(most, value):
    found = Measured(*value)
    bound = limit(most, 0).bound_that_holds(found)
    assert limit(most, bound).verdict(found) is Verdict.HOLDS
    worse = found.ends[1 if most else 0]
    assert abs(bound / worse - 1) < 0.01  # Three digits


def test_tables_of_made_up_limits():
    of = [
        limit(True, 2, 1.5, what="first"),
        limit(True, 2, 2.1, 1.9, 2.3, what="second"),
        limit(False, 3, 2.0, 1.913, 2.2, what="third"),
    ]
    rows = limits.kept(of).splitlines()
    assert rows[0] == "### things"
    assert rows[-3:] == [
        "| first | at most 2 | 1.500 | yes |",
        "| second | at most 2 | 2.10 [1.90, 2.30] | within the error |",
        "| third | at least 3 | 2.00 [1.91, 2.20] | **no** |",
    ]
    text = limits.missed(of)
    assert text.startswith("Of 3 limits 1 hold, and 1 more within the error. The other 1 do not")
    assert text.splitlines()[-1] == "| things | third | at least 3 | at least 1.91 | It is so. |"
    assert limits.missed(of[:2]) == "Of 2 limits 1 hold, and 1 more within the error.\n"


def test_verdicts_follow_the_data(monkeypatch):
    ratios = {
        "solid_angle": {"median": 1.04, "low": 1.03, "high": 1.049},
        "projected_solid_angle": {"median": 1.2, "low": 1.15, "high": 1.25},
    }
    for module in (limits, measured):
        monkeypatch.setattr(module, "data", lambda name: {"panel": {"ratios": ratios}})
    text = limits.kept(limits.render_times())
    assert "| panel, `solid_angle` | at most 1.05 | 1.040 [1.030, 1.049] | yes |" in text
    assert "| panel, `projected_solid_angle` | at most 1.1 | 1.200 [1.150, 1.250] | **no**" in text


@pytest.mark.parametrize(
    ("uniform", "area", "sentence"),
    [
        (1.09, 0.99, "To reach 1.05, 40 % of the light samples"),
        (1.04, 0.99, "That is below 1.05 without such a branch."),
        (1.09, 1.06, "No share of draws by area would reach 1.05."),
    ],
)
def test_what_a_branch_could_save(monkeypatch, uniform, area, sentence):
    times = {"solid_angle": uniform, "area": area}
    made_up = {
        "render_time": {
            "spheres_fog": {
                "ratios": {
                    name: {"median": time, "low": time - 0.01, "high": time + 0.01}
                    for name, time in times.items()
                }
            }
        },
        "calls": {
            "sample_direction": {"solid_angle": {"nanoseconds": 8}, "area": {"nanoseconds": 4}}
        },
    }
    monkeypatch.setattr(measured, "data", made_up.get)
    text = limits.far_lamps()
    assert sentence in text
    assert "a draw would take 0.50 of its time" in text
    assert f"{100 * (uniform - area) / uniform:.1f} % less time" in text


def test_interval_of_a_quotient():
    """That of two logarithms with normal errors, by chance."""
    rng = np.random.default_rng(1)
    over, under = (np.exp(rng.normal(0, sigma, 400_000)) for sigma in (0.05, 0.12))
    parts = [Measured(1, *np.quantile(values, (0.025, 0.975))) for values in (over, under)]
    found = quotient(*parts)
    # The quantiles of 400 000 draws scatter by 0.3 % of the spread, which is 13 %.
    assert found.ends == pytest.approx(np.quantile(over / under, (0.025, 0.975)), rel=2e-3)
    assert quotient(Measured(6), Measured(3)) == Measured(2)
    assert quotient(Measured(6), Measured(3, 2, 4)).ends == pytest.approx((1.5, 3))
    assert quotient(Measured(6), around(1, 1)).ends[1] == np.inf  # Perhaps there is no error left


@pytest.mark.parametrize(("file", "name"), [entry[2:] for entry in limits.TESTED])
def test_tests_that_hold_a_limit_exist(file, name):
    assert f"def {name}(" in (ROOT / file).read_text(encoding="utf-8")
