"""Say what a picture was made from: scene, code, versions and machine."""

from __future__ import annotations

import ast
import hashlib
import json
import platform
from collections.abc import Mapping
from functools import cache
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

import drjit as dr
import mitsuba as mi

from .. import __version__
from .scene import ParsedScene, parse_scene

if TYPE_CHECKING:
    from .job import RenderJob
    from .passes import Rendering

PACKAGE = Path(__file__).resolve().parent.parent

# Folders and modules that have no part in a picture nor in its time. Every other module has one,
# so a new room counts until it is named here.
NOT_IN_A_PICTURE = (
    "__main__.py",
    "cli/",
    "files/",
    "lighting/",
    "measures.py",
    "rendering/cluster.py",
    "rendering/converted_file.py",
    "rendering/parcel.py",
    "rendering/partial.py",
    "rendering/provenance.py",
    "rendering/worker.py",
    "study/",
    "system/doctor.py",
    "system/messages.py",
)

# What the registry of strategies holds for figures and pages alone, as arguments of a decorator
APPEARANCE = {"label", "colour", "mark", "sentence"}


def versions() -> dict[str, str]:
    """Return the versions of this package, of Mitsuba and of Dr.Jit."""
    return {
        "mi_ellipse_version": __version__,
        "mitsuba_version": str(mi.__version__),
        "drjit_version": str(vars(dr)["__version__"]),  # which is missing in its stubs
    }


def machine() -> str:
    """Return the processor's name, as far as the system tells it, and the threads in use."""
    return f"{processor()}, {dr.thread_count()} threads"


@cache
def processor() -> str:
    """Return the processor's name, as far as the system tells it."""
    name = platform.processor() or platform.machine()
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        models = [
            line for line in cpuinfo.read_text().splitlines() if line.startswith("model name")
        ]
        name = models[0].partition(":")[2].strip() if models else name
    return name


def scene_digest(path: str | PathLike[str], parameters: Mapping[str, str] | None = None) -> str:
    """
    Return a SHA-256 of what a scene file says and of the files it names, such as meshes.

    Equal for two files that differ in comments and layout alone; included files count in full, and
    so do the values of `parameters`. The sampling strategy that a job chooses does not count.

    Raises
    ------
    FileNotFoundError
        If the scene names a file that does not exist; the message says which, and where.
    RuntimeError
        From Mitsuba, if the scene file is missing or wrong.
    """
    return parsed_digest(parse_scene(path, parameters))


def parsed_digest(parsed: ParsedScene) -> str:
    """Return the :func:`scene_digest` of a scene that has been parsed."""
    result = hashlib.sha256(mi.parser.write_string(parsed.state).encode())
    # Mitsuba writes no id that nothing refers to, but a job can name a lamp by it.
    for index, node in enumerate(parsed.state.nodes):
        if node.props.id():
            result.update(f"{index} {node.props.id()}\n".encode())
    for _, file in parsed.named_files():
        result.update(file.read_bytes())
    return result.hexdigest()


def picture_digest(package: Path = PACKAGE) -> str:
    """
    Return a SHA-256 of the code that makes a picture and its time.

    It covers the modules of this package without :data:`NOT_IN_A_PICTURE`. Comments, layout,
    docstrings and the colours and sentences of the strategies do not count. The digest is that of
    the syntax tree, so another version of Python, which takes its own time, can give another one.
    """
    result = hashlib.sha256()
    for file in sorted(package.rglob("*.py")):
        name = file.relative_to(package).as_posix()
        if not name.startswith(NOT_IN_A_PICTURE):
            tree = _Bare().visit(ast.parse(file.read_text(encoding="utf-8")))
            result.update(f"{name}\n{ast.dump(tree)}\n".encode())
    return result.hexdigest()


def describe(job: RenderJob, rendering: Rendering) -> dict[str, str]:
    """
    Return the settings that made a picture, as texts for its metadata.

    ``sampling`` reads "as in the scene" where the job chose none; ``grouping`` is "yes" or "no",
    see :func:`yes_or_no`; ``parameters`` is a JSON object; ``convert_lamps``, ``sensor``,
    ``integrator`` and ``resolution`` tell the job's changes;
    ``scene_digest`` is that of :func:`scene_digest` for the scene that was rendered.
    """
    return {
        "scene": str(job.scene),
        "spp": str(rendering.spp),
        "passes": str(rendering.passes),
        **settings(job, rendering.scene_digest),
        "render_seconds": f"{rendering.seconds:.3f}",
        "machine": rendering.machine,
    }


def settings(job: RenderJob, digest: str) -> dict[str, str]:
    """Return what two renders have in common if their samples may be averaged, as texts."""
    return {
        "scene_digest": digest,
        "seed": str(job.seed),
        "variant": job.variant,
        "sampling": job.sampling or "as in the scene",
        "grouping": yes_or_no(job.grouping),
        **job.changes.describe(),
        "parameters": json.dumps(dict(job.parameters)),
        **versions(),
    }


def yes_or_no(grouping: bool) -> str:
    """Return the metadata's word for whether lamps choose among themselves."""
    return "yes" if grouping else "no"


class _Bare(ast.NodeTransformer):
    """Remove from a syntax tree what has no influence on what the code computes."""

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.AST:
        return self._strip(node)

    def visit_AsyncFunctionDef(self, node: ast.AsyncFunctionDef) -> ast.AST:
        return self._strip(node)

    def visit_ClassDef(self, node: ast.ClassDef) -> ast.AST:
        for decorator in node.decorator_list:
            if isinstance(decorator, ast.Call):
                decorator.keywords = [
                    word for word in decorator.keywords if word.arg not in APPEARANCE
                ]
        return self._strip(node)

    def visit_Module(self, node: ast.Module) -> ast.AST:
        return self._strip(node)

    def _strip(
        self, node: ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef | ast.Module
    ) -> ast.AST:
        if ast.get_docstring(node, clean=False) is not None:
            node.body = node.body[1:]
        return self.generic_visit(node)
