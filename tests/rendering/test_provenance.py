"""What a picture says of its origin, and what makes it outdated."""

import ast
import os
import re
import shutil
from pathlib import Path

import drjit as dr
import mi_ellipse
import mitsuba as mi
import pytest
from commands import LAMP, SCENE
from mi_ellipse.rendering import provenance
from mi_ellipse.rendering.job import RenderJob

pytestmark = pytest.mark.usefixtures("llvm_ad_rgb")

SPHERE = '<shape type="ply"><string name="filename" value="{}"/></shape>'


# ---- The scene ----


def digest(folder, text, **parameters):
    (folder / "scene.xml").write_text(text)
    return provenance.scene_digest(folder / "scene.xml", parameters)


def test_layout_and_comments_of_a_scene_do_not_count(tmp_path):
    text = SCENE.format(lamps=LAMP)
    commented = text.replace("<sensor", "<!-- of  the\n study -->\n\n<sensor").replace("    ", " ")
    assert commented != text
    assert digest(tmp_path, commented) == digest(tmp_path, text)


def test_name_and_place_of_a_scene_do_not_count(tmp_path):
    text = SCENE.format(lamps=LAMP)
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "other.xml").write_text(text)
    other = provenance.scene_digest(tmp_path / "elsewhere" / "other.xml")
    assert other == digest(tmp_path, text)


def test_values_and_parameters_of_a_scene_count(tmp_path):
    text = SCENE.format(lamps=LAMP)
    digests = [
        digest(tmp_path, text),
        digest(tmp_path, text.replace("0,-4,3", "0,-4,3.5")),
        digest(tmp_path, text, sampler="stratified"),
        digest(tmp_path, text, sampling="area"),
        digest(tmp_path, text.replace('<shape type="disk"', '<shape type="disk" id="ceiling"')),
    ]
    assert len(set(digests)) == len(digests)


@pytest.mark.parametrize("place", ["", "meshes/"])
def test_files_that_a_scene_names_count(tmp_path, monkeypatch, place):
    (tmp_path / "meshes").mkdir()
    text = SCENE.format(lamps=LAMP + SPHERE.format(f"{place}a.ply"))
    (tmp_path / place / "a.ply").write_bytes(b"one")
    first = digest(tmp_path, text)
    monkeypatch.chdir(tmp_path / "meshes")  # file names start at the scene, not here
    assert digest(tmp_path, text) == first
    (tmp_path / place / "a.ply").write_bytes(b"two")
    assert digest(tmp_path, text) != first


def test_included_scenes_count(tmp_path):
    text = SCENE.format(lamps='<include filename="more.xml"/>')
    (tmp_path / "more.xml").write_text('<scene version="3.0.0"><shape type="cube"/></scene>')
    first = digest(tmp_path, text)
    (tmp_path / "more.xml").write_text('<scene version="3.0.0"><shape type="sphere"/></scene>')
    assert digest(tmp_path, text) != first


def test_a_missing_file_of_a_scene_is_named(tmp_path):
    before = mi.variant()
    message = re.escape(str(tmp_path / "scene.xml")) + r' \(line \d+, .*"gone.ply" is not found'
    with pytest.raises(FileNotFoundError, match=message):
        digest(tmp_path, SCENE.format(lamps=SPHERE.format("gone.ply")))
    assert mi.variant() == before


# ---- The code ----


@pytest.fixture
def package(tmp_path):
    """A copy of this package."""
    ignored = shutil.ignore_patterns("__pycache__")
    return shutil.copytree(provenance.PACKAGE, tmp_path / "mi_ellipse", ignore=ignored)


def edit(file: Path, pattern: str, replacement: str):
    text = file.read_text(encoding="utf-8")
    edited, count = re.subn(pattern, replacement, text, count=1)
    assert count == 1, f"{pattern} is not in {file.name}"
    assert edited != text
    file.write_text(edited, encoding="utf-8")


def test_a_copy_has_the_digest_of_the_package(package):
    assert provenance.picture_digest(package) == provenance.picture_digest()


@pytest.mark.parametrize(
    ("file", "pattern", "replacement"),
    [
        ("rendering/passes.py", r"\A", "# A comment\n\n"),
        ("rendering/passes.py", r"(?m)^import time$", "import time  # of the clock"),
        ("rendering/passes.py", r'\A"""', '"""Another first line. '),
        ("rendering/passes.py", r'(def render\((?:.|\n)*?""")', r"\1 Another docstring."),
        ("rendering/passes.py", r'(class Timing:\n    """)', r"\1Another docstring. "),
        ("sampling/area.py", r'colour="[^"]*"', 'colour="#000000"'),
        ("sampling/area.py", r'sentence="', 'sentence="Other words. '),
        ("study/metrics.py", r"\Z", "\nMORE = 1\n"),
        ("cli/render.py", r"\Z", "\nMORE = 1\n"),
        ("files/images.py", r"\Z", "\nMORE = 1\n"),
    ],
)
def test_what_makes_no_other_picture_does_not_count(package, file, pattern, replacement):
    edit(package / file, pattern, replacement)
    assert provenance.picture_digest(package) == provenance.picture_digest()


@pytest.mark.parametrize(
    ("file", "pattern", "replacement"),
    [
        ("lamps/lamp.py", r"2\*\*-21", "2**-20"),
        ("rendering/passes.py", r"/ 1000", "/ 1001"),  # of the times
        ("rendering/job.py", r"warm_up is None", "warm_up is not None"),
        ("sampling/area.py", r'"area"', '"surface"'),
        ("geometry/cone.py", r"\Z", "\nMORE = 1\n"),
        ("system/llvm.py", r"MINIMUM_VERSION = \d+", "MINIMUM_VERSION = 18"),
    ],
)
def test_what_can_make_another_picture_or_time_counts(package, file, pattern, replacement):
    edit(package / file, pattern, replacement)
    assert provenance.picture_digest(package) != provenance.picture_digest()


def test_a_new_module_counts(package):
    (package / "geometry" / "torus.py").touch()
    assert provenance.picture_digest(package) != provenance.picture_digest()


def imported_modules(file: Path):
    """Files of the package that a module imports, as paths below the package."""
    package = provenance.PACKAGE
    folder = file.parent
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.level:
            start = folder.parents[node.level - 2] if node.level > 1 else folder
            base = start.joinpath(*(node.module or "").split("."))
            for path in (base, *(base / name.name for name in node.names)):
                for found in (path.with_suffix(".py"), path / "__init__.py"):
                    if found.is_file():
                        yield found.relative_to(package).as_posix()


def test_the_code_that_counts_uses_nothing_that_does_not():
    package = provenance.PACKAGE
    # Only these may: they pass on what others compute, or say it.
    allowed = {
        ("__init__.py", "lighting/irradiance.py"),
        ("__init__.py", "measures.py"),
        ("rendering/executor.py", "rendering/provenance.py"),
        ("rendering/job.py", "rendering/provenance.py"),
    }
    used = {
        (name, imported)
        for file in package.rglob("*.py")
        if not (name := file.relative_to(package).as_posix()).startswith(
            provenance.NOT_IN_A_PICTURE
        )
        for imported in imported_modules(file)
        if imported.startswith(provenance.NOT_IN_A_PICTURE)
    }
    assert used == allowed


# ---- Versions, machine, description ----


def test_versions():
    assert provenance.versions() == {
        "mi_ellipse_version": mi_ellipse.__version__,
        "mitsuba_version": mi.__version__,
        "drjit_version": dr.__version__,
    }


def test_machine_tells_the_threads():
    assert provenance.machine().endswith(f", {dr.thread_count()} threads")
    assert dr.thread_count() <= os.cpu_count()


def test_description_of_a_picture(scene_file):
    job = RenderJob(scene_file, {"sampler": "stratified"}, "llvm_ad_rgb", "area", 5, 3)
    rendering = job.run()
    described = provenance.describe(job, rendering)
    assert float(described.pop("render_seconds")) == pytest.approx(rendering.seconds, abs=1e-3)
    assert described == provenance.versions() | {
        "scene": str(scene_file),
        "scene_digest": provenance.scene_digest(scene_file, {"sampler": "stratified"}),
        "spp": "9",
        "passes": "1",
        "seed": "3",
        "variant": "llvm_ad_rgb",
        "sampling": "area",
        "grouping": "yes",
        "convert_lamps": "no",
        "sensor": "the first",
        "integrator": "as in the scene",
        "resolution": "as in the scene",
        "parameters": '{"sampler": "stratified"}',
        "machine": provenance.machine(),
    }
