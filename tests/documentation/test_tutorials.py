"""The tutorials work from top to bottom, as a reader would take them.

A page is a row of steps. A fence after "Save this as `NAME`" is a file, another fence of Python is
run, and an indented line that begins with `mi-ellipse` is a command. All steps of a page share one
folder and one session of Python. A fence of `text` is what the step before it prints.
"""

from __future__ import annotations

import contextlib
import gc
import io
import os
import re
import shlex
import subprocess
import sys
from importlib import import_module
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import mi_ellipse.cli.compare
import mi_ellipse.sampling
import mi_ellipse.study.run
import pytest
from commands import invoke
from mi_ellipse.sampling import STRATEGIES

ROOT = Path(__file__).parents[2]
PAGES = sorted((ROOT / "docs" / "tutorials").glob("*.md"))
STEP = re.compile(
    r"(?:^Save this as `(?P<file>[^`]+)`[^\n]*\n\n)?^```(?P<language>\w+)\n(?P<fence>.*?)^```$"
    r"|^    mi-ellipse (?P<command>[^\n]+)$",
    re.MULTILINE | re.DOTALL,
)
NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e-?\d+)?")

# Renders and comparisons take this part of the samples of the page.
SMALLER = 16
# What these print holds times, and numbers of the samples of the page.
OF_THAT_MOMENT = ("render", "compare")


class Step(NamedTuple):
    """What a reader does, and what the page says is printed; None where it says nothing."""

    file: str | None
    code: str | None
    command: str | None
    shown: str | None


def steps(page: str) -> list[Step]:
    """Return the steps of a page in their order."""
    found: list[Step] = []
    for match in STEP.finditer(page):
        file, language, fence, command = match.group("file", "language", "fence", "command")
        if language == "text":
            found[-1] = found[-1]._replace(shown=fence)
        elif language != "sh":
            found.append(Step(file, fence, command, None))
    return found


def smaller(arguments: list[str]) -> list[str]:
    """Return the arguments of a command with fewer samples."""

    def divided(counts: str) -> str:
        return ",".join(str(max(1, int(count) // SMALLER)) for count in counts.split(","))

    sizes = {"--spp": divided, "--reference-spp": divided}
    changed = [sizes.get(a, str)(b) for a, b in pairwise(arguments)]
    return arguments[:1] + changed


def assert_printed(printed: str, shown: str) -> None:
    """Compare a text as it is, and numbers within 3 % or two units of their last digit.

    Seeds are fixed. Other processors round otherwise, and steps of a descent carry that on.
    """
    assert NUMBER.sub("#", printed).split() == NUMBER.sub("#", shown).split(), printed
    for got, expected in zip(NUMBER.findall(printed), NUMBER.findall(shown), strict=True):
        digits = expected.partition("e")[0].partition(".")[2]
        limit = 0.03 * abs(float(expected)) + 2 * 10.0 ** -len(digits)
        assert abs(float(got) - float(expected)) <= limit, (got, expected)


class Reader:
    """Takes the steps of a page in a folder."""

    def __init__(self, folder: Path):
        self.folder = folder
        self.session: dict[str, object] = {}

    def take(self, step: Step) -> None:
        """Take a step, and compare what it prints."""
        printed = ""
        if step.file is not None:
            path = self.folder / step.file
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(step.code)
            if step.file.startswith("mi_ellipse/"):
                import_module(step.file.removesuffix(".py").replace("/", "."))
        elif step.code is not None:
            output = io.StringIO()
            with contextlib.redirect_stdout(output):
                exec(step.code, self.session)
            printed = output.getvalue()
        else:
            printed = self.run(shlex.split(step.command))
        if step.shown is not None and printed:
            assert_printed(printed, step.shown)

    def run(self, arguments: list[str]) -> str:
        """Run a command; return what it prints unless that holds for a moment alone."""
        result = invoke(*smaller(arguments))
        assert result.exit_code == 0, (arguments, result.output)
        return "" if arguments[0] in OF_THAT_MOMENT else result.output


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder like that of the repository, in which a page may add a strategy."""
    (tmp_path / "scenes").symlink_to(ROOT / "scenes")
    monkeypatch.chdir(tmp_path)
    # A comparison takes many seconds, however small, and has tests of its own: it stops after its
    # checks of strategies, counts and scene.
    monkeypatch.setattr(mi_ellipse.study.run, "_run", lambda *arguments: None)
    monkeypatch.setattr(mi_ellipse.cli.compare, "draw", lambda *arguments: None)
    package = [*mi_ellipse.sampling.__path__, str(tmp_path / "mi_ellipse" / "sampling")]
    monkeypatch.setattr(mi_ellipse.sampling, "__path__", package)
    before = dict(STRATEGIES)
    yield tmp_path
    for name in STRATEGIES.keys() - before.keys():
        del STRATEGIES[name]
        sys.modules.pop(f"mi_ellipse.sampling.{name}", None)


@pytest.fixture
def reader(folder):
    """A reader at the top of a page."""
    reader = Reader(folder)
    yield reader
    # The functions of a session keep its scenes alive. Mitsuba ends the process when a scene is
    # freed while another page records a function.
    reader.session.clear()
    gc.collect()


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.stem)
def test_tutorial(path, reader):
    for step in steps(path.read_text(encoding="utf-8")):
        reader.take(step)


def test_every_fence_is_a_step():
    """But those of `text`, each of which stands below a step."""
    for path in PAGES:
        page = path.read_text(encoding="utf-8")
        shown = page.count("\n```text\n")
        taken = steps(page)
        fences = [step for step in taken if step.code is not None]
        assert len([step for step in taken if step.shown is not None]) == shown, path
        assert 2 * (len(fences) + shown) == page.count("```"), path
        commands = [step for step in taken if step.command is not None]
        assert len(commands) == page.count("\n    mi-ellipse "), path
        assert fences


@pytest.mark.parametrize(
    ("printed", "shown"),
    [("a 1.00", "b 1.00"), ("1.00 lx", "1.06 lx"), ("1 2", "1"), ("300 lx", "310 lx 2")],
)
def test_another_print_is_seen(printed, shown):
    assert_printed(shown, shown)
    with pytest.raises(AssertionError):
        assert_printed(printed, shown)


SAMPLERS = (ROOT / "docs" / "tutorials" / "samplers.md").read_text(encoding="utf-8")


def strategy_of_the_page():
    """Name and code of the strategy that the page on samplers adds."""
    (step,) = (step for step in steps(SAMPLERS) if step.file is not None)
    assert Path(step.file).parent == Path("mi_ellipse/sampling")
    return Path(step.file).stem, step.code


def run_strategy_tests(folder, name, code, chosen, *options):
    """Run tests of strategies in a process in which the page's strategy is registered."""
    (folder / f"{name}.py").write_text(code)
    (folder / "with_strategy.py").write_text(
        f"import mi_ellipse.sampling\n"
        f"mi_ellipse.sampling.__path__.append({str(folder)!r})\n"
        f"import mi_ellipse.sampling.{name}\n"
    )
    command = [sys.executable, "-m", "pytest", "-q", "-p", "with_strategy"]
    command += ["-p", "no:cacheprovider", "tests/sampling/test_strategies.py", *options]
    command += ["-k", f"{name} and ({chosen})" if chosen else name]
    path = os.pathsep.join([str(folder), str(ROOT), os.environ.get("PYTHONPATH", "")])
    environment = os.environ | {"PYTHONPATH": path}
    return subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True)


def test_tests_find_the_strategy_of_the_page(tmp_path):
    """As many as the page says."""
    name, code = strategy_of_the_page()
    assert f"    pytest tests/sampling/test_strategies.py -k {name}\n" in SAMPLERS
    passed = re.search(r"^```text\n(\d+) passed$", SAMPLERS, re.MULTILINE)[1]
    done = run_strategy_tests(tmp_path, name, code, "", "--collect-only")
    assert done.returncode == 0, done.stdout
    assert f"\n{passed}/" in done.stdout


def test_strategy_of_the_page_passes_its_tests(tmp_path):
    """Draw against density (χ²), both ends of the density, and its integral."""
    name, code = strategy_of_the_page()
    done = run_strategy_tests(tmp_path, name, code, "chi_square or is_that or integrates")
    assert done.returncode == 0, done.stdout
    # 11 views of ellipses and 12 of solids; and for each kind of light both ends and the integral
    assert "29 passed" in done.stdout


def test_biased_strategy_fails_its_tests(tmp_path):
    """As the page tells the reader to try."""
    name, code = strategy_of_the_page()
    biased = code.replace("dr.maximum(cosine, 0) / ", "1.05 * dr.maximum(cosine, 0) / ")
    assert biased != code
    done = run_strategy_tests(tmp_path, name, biased, "chi_square and mid")
    assert done.returncode == 1, done.stdout
    assert "1 failed" in done.stdout
