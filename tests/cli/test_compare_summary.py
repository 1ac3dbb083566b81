"""The table that `compare` prints keeps every name and number."""

import io
from types import SimpleNamespace

import pytest
from mi_ellipse.cli.summary import print_summary
from rich.console import Console


def measurement(sampling):
    return SimpleNamespace(
        kind="equal samples",
        first_spp=16,
        sampling=sampling,
        spp=16,
        seconds=SimpleNamespace(median=0.25, low=0.125, high=0.5),
        ratio=SimpleNamespace(median=1.5, low=1.25, high=1.75),
        efficiency={"mse_trimmed": SimpleNamespace(value=7.25, low=0.01, high=278476.02)},
        errors={"mse_trimmed": SimpleNamespace(mean=0.000123)},
    )


@pytest.mark.parametrize("width", [80, 120, 300])
@pytest.mark.parametrize("name", ["area", "oval=projected_solid_angle+solid_angle+ungrouped"])
def test_nothing_is_cut(name, width):
    names = [name, "solid_angle"]
    comparison = SimpleNamespace(strategies=names, measurements=[measurement(n) for n in names])
    output = io.StringIO()
    print_summary(comparison, Console(file=output, width=width))
    header, title, *rows = output.getvalue().splitlines()[:4]
    assert header.split() == f"strategy spp trimmed MSE seconds over {name}'s efficiency".split()
    assert title.strip() == f"equal samples, {name} at 16 spp"
    numbers = "16 0.000123 0.250 [0.125, 0.500] 1.50 [1.25, 1.75] 7.25 [0.01, 278476.02]"
    assert [" ".join(row.split()) for row in rows] == [f"{n} {numbers}" for n in names]
