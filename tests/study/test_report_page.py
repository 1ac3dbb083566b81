"""The report: one file that needs nothing else, and works in a browser."""

import dataclasses
import html
import json
import os
import re
import shutil
import subprocess
from html.parser import HTMLParser

import mitsuba as mi
import numpy as np
import pytest
from conftest import SMALL_SCENE, SMALL_SIZE
from mi_ellipse.rendering.job import Timing
from mi_ellipse.study import compare
from mi_ellipse.study.report import page, write_report
from mi_ellipse.study.statistics import Efficiency, Estimate
from mi_ellipse.study.timing import PairedTime

STRATEGIES = ("area", "solid_angle")
WIDTH, HEIGHT = SMALL_SIZE

CHROMIUM = os.environ.get("CHROMIUM") or next(
    filter(None, map(shutil.which, ("chromium", "chromium-headless-shell", "google-chrome"))), None
)

needs_browser = pytest.mark.skipif(
    CHROMIUM is None, reason="no Chromium found; the CHROMIUM variable may name one"
)

# Runs in the page: gathers errors, reads the picture, switches to the second one, reads that.
PROBE = """<script>
const problems = [];
window.addEventListener("error", event => problems.push(String(event.message)));
const original = console.error;
console.error = (...words) => { problems.push(words.join(" ")); original(...words); };

function shown(book) {
    const canvas = [...book.querySelectorAll("canvas")].find(one => one.offsetParent !== null);
    const copy = document.createElement("canvas");
    [copy.width, copy.height] = [canvas.width, canvas.height];
    const context = copy.getContext("2d");
    context.drawImage(canvas, 0, 0);
    return Array.from(context.getImageData(0, 0, copy.width, copy.height).data);
}

window.addEventListener("load", () => setTimeout(() => {
    const book = document.querySelector("[id^=flipbook-]");
    const first = shown(book);
    const names = [...book.querySelectorAll("button")].slice(0, 3);
    names[1].click();
    setTimeout(() => {
        const output = document.createElement("pre");
        output.id = "probe";
        output.textContent = JSON.stringify({
            problems, first, second: shown(book), names: names.map(one => one.textContent),
        });
        document.body.append(output);
    }, 500);
}, 1500));
</script>"""


@pytest.fixture(scope="module")
def comparison(tmp_path_factory):
    mi.set_variant("llvm_ad_rgb")
    folder = tmp_path_factory.mktemp("report")
    (folder / "scene.xml").write_text(SMALL_SCENE)
    result = compare(
        folder / "scene.xml", folder / "out", STRATEGIES, (2, 8), 64, 2, say=lambda text: None
    )
    write_report(result)
    return result


@pytest.fixture
def text(comparison):
    return (comparison.folder / "report.html").read_text(encoding="utf-8")


class Page(HTMLParser):
    """Elements that would load something, and the contents of table cells."""

    def __init__(self, text):
        super().__init__()
        self.sources, self.cells, self.open = [], [], []
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        attributes = dict(attributes)
        for name in ("src", "href", "xlink:href"):
            if name in attributes and not (tag == "a" or attributes[name].startswith("#")):
                self.sources.append(attributes[name])
        self.in_cell = tag in ("td", "span") and (tag == "td" or self.in_cell)

    in_cell = False

    def handle_data(self, data):
        if self.in_cell:
            self.cells.append(data)

    def handle_endtag(self, tag):
        if tag == "td":
            self.in_cell = False


def test_report_is_self_contained(text):
    sources = Page(text).sources
    assert sources
    assert all(source.startswith("data:") for source in sources)
    assert "@import" not in text
    assert "url(http" not in text


def test_report_has_every_picture_at_full_size(text):
    books = re.findall(r"flipbook\.MakeFlipBook\((\{.*?\})\);", text)
    assert len(books) == 3  # two counts, and one at equal time
    for book in map(json.loads, books):
        assert (book["width"], book["height"]) == (WIDTH, HEIGHT)
        assert book["names"][0] == "reference"
        assert [name.split(",")[0] for name in book["names"][1:]] == list(STRATEGIES)
        assert len(set(book["dataUrls"])) == 3


def test_numbers_are_those_of_the_comparison(comparison, text):
    cells = Page(text).cells
    for measurement in comparison.measurements:
        error = measurement.errors["mse_trimmed"]
        assert f"{error.mean:.3g}\n± {error.standard_error:.1g}" in cells
        for spread, digits in ((measurement.seconds, 3), (measurement.ratio, 2)):
            assert (
                f"{spread.median:.{digits}f}\n[{spread.low:.{digits}f}, {spread.high:.{digits}f}]"
                in cells
            )
    assert f"{comparison.reference.errors['mse']:.3g}" in cells
    assert comparison.warnings()[0] in html.unescape(text)


def test_efficiencies_have_their_intervals(comparison, text):
    cells = Page(text).cells
    for measurement in comparison.measurements:
        for one in measurement.efficiency.values():
            ends = [f"{v:.2f}" if 0.005 <= v < 1000 else f"{v:.0e}" for v in (one.low, one.high)]
            assert f"{one.value:.2f}\n[{ends[0]}, {ends[1]}]" in cells
    assert "Student's t with 1 degree\nof freedom" in html.unescape(text)


def with_intervals(comparison, first, second, ratios=(1.0, 1.0)):
    """The comparison with other ends of the intervals of one efficiency, and other times."""
    ends = dict(zip(comparison.strategies, (first, second), strict=True))
    ratio = dict(zip(comparison.strategies, ratios, strict=True))
    second = Timing(1.0, 0.0, 0.0, 1.0)
    measurements = tuple(
        dataclasses.replace(
            one,
            efficiency={"mse": Efficiency(7.25, *ends[one.sampling])},
            times=(PairedTime(second, second, 1 / ratio[one.sampling]),),
        )
        for one in comparison.measurements
    )
    return dataclasses.replace(comparison, measurements=measurements)


@pytest.mark.parametrize(
    ("first", "second", "bold"),
    [((1, 2), (3, 4), 1), ((1, 2), (1.5, 4), 0), ((5, 6), (3, 4), 1), ((1, 2), (np.nan, 4), 0)],
)
def test_bold_is_the_best_by_its_interval_alone(comparison, first, second, bold):
    for group in page._table(with_intervals(comparison, first, second), "equal samples"):
        best = [row.costs[0].best for row in group]
        assert sum(best) == bold
        if bold:
            assert best == [first > second, second > first]


def test_no_efficiency_is_best_on_a_machine_that_is_not_as_fast_as_itself(comparison):
    for ratio, bold in ((1.09, 1), (1 / 1.09, 1), (1.11, 0), (1 / 1.11, 0)):
        changed = with_intervals(comparison, (1, 2), (3, 4), (ratio, 1.5))
        for group in page._table(changed, "equal samples"):
            assert sum(row.costs[0].best for row in group) == bold


def test_no_error_is_best_at_equal_time_where_the_times_differ(comparison):
    errors = {"area": Estimate(2.0, 0.01), "solid_angle": Estimate(1.0, 0.01)}
    for ratio, bold in ((1.09, 1), (1.11, 0), (1 / 1.11, 0)):
        changed = with_intervals(comparison, (1, 2), (1, 2), (1.0, ratio))
        measurements = tuple(
            dataclasses.replace(one, errors=dict.fromkeys(one.errors, errors[one.sampling]))
            for one in changed.measurements
        )
        changed = dataclasses.replace(changed, measurements=measurements)
        for kind, expected in (("equal samples", 1), ("equal time", bold)):
            for group in page._table(changed, kind):
                assert sum(row.errors[0].best for row in group) == expected


def test_curves_are_drawn_inline(text):
    assert text.count("<svg") >= 9
    identifiers = re.findall(r'<clipPath id="([^"]+)"', text)
    assert len(identifiers) == len(set(identifiers)) > 0


def probe(text, script, folder):
    """What a script finds in a page, in a window of 1000 × 800 pixels."""
    file = folder / "report.html"
    file.write_text(text.replace("<head>", f"<head>{script}", 1), encoding="utf-8")
    process = subprocess.run(
        [
            CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic",
            "--no-first-run", "--disable-background-networking", "--disable-component-update",
            "--disable-sync", f"--user-data-dir={folder / 'profile'}", "--window-size=1000,800",
            "--virtual-time-budget=10000", "--dump-dom", file.as_uri(),
        ],
        capture_output=True, text=True, timeout=120, check=True,
    )  # fmt: skip
    found = re.search(r'<pre id="probe">(.*?)</pre>', process.stdout, re.DOTALL)
    assert found, process.stderr
    return json.loads(html.unescape(found.group(1)))


@needs_browser
def test_report_works_in_a_browser(comparison, text, tmp_path):
    result = probe(text, PROBE, tmp_path)
    assert result["problems"] == []
    assert result["names"][1].endswith("area, 2 spp")

    measurement = comparison.find("equal samples", "area", 2)
    expected = comparison.reference_image(), comparison.image(measurement)
    for pixels, image in zip((result["first"], result["second"]), expected, strict=True):
        linear = np.clip(image * 2.0**comparison.exposure, 0, 1)
        srgb = np.where(linear < 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
        shown = np.array(pixels).reshape(HEIGHT, WIDTH, 4)[..., :3]
        # The copies in the page have 8 bits a channel and a common exponent.
        assert np.abs(shown - 255 * srgb).mean() < 2
    assert result["first"] != result["second"]


# What each table needs and what the window gives it
WIDTHS = """<script>
window.addEventListener("load", () => {
    const output = document.createElement("pre");
    output.id = "probe";
    output.textContent = JSON.stringify(
        [...document.querySelectorAll(".scroll")].map(one => [one.scrollWidth, one.clientWidth])
    );
    document.body.append(output);
});
</script>"""


@needs_browser
def test_tables_fit_a_window_of_1000_pixels(comparison, tmp_path):
    longest = "projected_solid_angle_one_sided+ungrouped"
    names = {"solid_angle": longest, "area": "area"}
    changed = dataclasses.replace(
        comparison,
        folder=tmp_path,
        strategies=tuple(names[name] for name in comparison.strategies),
        measurements=tuple(
            dataclasses.replace(one, sampling=names[one.sampling])
            for one in comparison.measurements
        ),
    )
    widths = probe(write_report(changed).read_text(encoding="utf-8"), WIDTHS, tmp_path)
    assert len(widths) == 4
    assert [needed for needed, given in widths if needed > given] == []
    assert max(given for _, given in widths) <= 1000
