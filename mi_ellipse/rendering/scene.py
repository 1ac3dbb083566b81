"""Load a scene file, with its lamps' sampling strategy chosen from outside if wanted."""

# Types such as `mi.Scene` exist only once a variant is set.
from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi

from .. import sampling as strategies
from ..plugins.names import ELLIPTICAL_AREA

# Mitsuba's stubs know the functions of the file resolver under another name.
_mi: Any = mi


@dataclass(frozen=True)
class ParsedScene:
    """What a scene file says, under the variant that was set when it was parsed."""

    path: Path
    config: mi.parser.ParserConfig
    state: mi.parser.ParserState

    @property
    def scene_files(self) -> tuple[Path, ...]:
        """The XML files: the scene and what it includes."""
        return tuple(Path(str(file)) for file in self.state.files)

    def named_files(self) -> list[tuple[str, Path]]:
        """
        Return where a file is named, and which one, for each mesh, texture or volume.

        The content of a spectrum's file is part of what was parsed, so it is not among them.

        Raises
        ------
        FileNotFoundError
            If one of them does not exist.
        """
        with _files_found_beside(self.path):
            found = []
            for node in self.state.nodes:
                if "filename" in node.props:
                    location = mi.parser.file_location(self.state, node)
                    name = node.props["filename"]
                    file = Path(str(_mi.file_resolver().resolve(name)))
                    if not file.is_file():
                        raise FileNotFoundError(f'{location}: the file "{name}" is not found')
                    found.append((location, file.resolve()))
        return found


def load_scene(
    path: str | PathLike[str],
    parameters: Mapping[str, str] | None = None,
    sampling: str | None = None,
) -> mi.Scene:
    """
    Load an XML scene as ``mi.load_file`` does, and refuse lamps that would give no light.

    Parameters
    ----------
    path
        Scene file.
    parameters
        Values for the scene's ``<default>`` parameters.
    sampling
        Strategy for every ``ellipticalarea`` of the scene, whatever the scene says; None leaves
        the scene's choices.

    Raises
    ------
    ValueError
        If an ``ellipticalarea`` belongs to no shape, if `sampling` is unknown, if it is given but
        the scene has no ``ellipticalarea``, or if the file holds something other than a scene.
    RuntimeError
        From Mitsuba, for everything that is wrong with the file itself.
    """
    return instantiate(parse_scene(path, parameters), sampling)


def parse_scene(
    path: str | PathLike[str], parameters: Mapping[str, str] | None = None
) -> ParsedScene:
    """
    Read an XML scene under the current variant, without loading it.

    Parameters and errors are those of :func:`load_scene`.
    """
    path = Path(path)
    config = mi.parser.ParserConfig(mi.variant() or "")
    with _files_found_beside(path):
        state = mi.parser.parse_file(config, str(path), **(parameters or {}))
    return ParsedScene(path.resolve(), config, state)


def instantiate(parsed: ParsedScene, sampling: str | None = None) -> mi.Scene:
    """
    Load a scene that has been parsed; `sampling` and errors are those of :func:`load_scene`.

    What was parsed stays as it is and can be loaded again.
    """
    state = mi.parser.ParserState(parsed.state)
    with _files_found_beside(parsed.path):
        _refuse_detached_lamps(parsed.config, state)
        if sampling is not None:
            _choose_sampling(state, sampling)
        mi.parser.transform_all(parsed.config, state)
        with _one_thread():
            scene = mi.parser.instantiate(parsed.config, state)
    if not isinstance(scene, mi.Scene):
        raise ValueError(f"{parsed.path}: the root element is no <scene>")
    return scene


def _lamps(state: mi.parser.ParserState) -> list[int]:
    return [i for i, node in enumerate(state.nodes) if node.props.plugin_name() == ELLIPTICAL_AREA]


def _choose_sampling(state: mi.parser.ParserState, sampling: str) -> None:
    """Write the strategy into every lamp of a parsed scene."""
    strategies.find(sampling)
    lamps = _lamps(state)
    if not lamps:
        raise ValueError(
            f'a sampling strategy ("{sampling}") is given, but the scene has no "{ELLIPTICAL_AREA}"'
        )
    for lamp in lamps:
        state.nodes[lamp].props["sampling"] = sampling


def _refuse_detached_lamps(config: mi.parser.ParserConfig, state: mi.parser.ParserState) -> None:
    """
    Raise an error for a lamp outside every shape, which Mitsuba would ignore without a word.

    The parsed tree shows it, included files and references considered, while the finished scene
    no longer knows of such a lamp.
    """
    resolved = mi.parser.ParserState(state)
    mi.parser.transform_upgrade(config, resolved)
    mi.parser.transform_resolve(config, resolved)

    attached = {
        value.index()
        for node in resolved.nodes
        if node.type == mi.ObjectType.Shape
        for _, value in node.props.items()
        if isinstance(value, mi.Properties.ResolvedReference)
    }
    for lamp in _lamps(resolved):
        if lamp not in attached:
            location = mi.parser.file_location(resolved, resolved.nodes[lamp])
            raise ValueError(
                f'{location}: this "{ELLIPTICAL_AREA}" belongs to no shape and would give no light;'
                " put it inside the <shape> that shall shine"
            )


@contextmanager
def under_variant(variant: str) -> Iterator[None]:
    """Set a variant of Mitsuba, and set that of the caller again in the end."""
    before = mi.variant()
    mi.set_variant(variant)
    try:
        yield
    finally:
        if before is not None:
            mi.set_variant(before)


@contextmanager
def _one_thread() -> Iterator[None]:
    """
    Let the scene be built the same way each time.

    Several threads build a ray tracing hierarchy whose order changes from one load to the next, and
    with it the last digits of where rays meet meshes.
    """
    threads = dr.thread_count()
    dr.set_thread_count(1)
    try:
        yield
    finally:
        dr.set_thread_count(threads)


@contextmanager
def _files_found_beside(path: Path) -> Iterator[None]:
    """Let relative file names of a scene start at its folder, as ``mi.load_file`` does."""
    before = _mi.file_resolver()
    extended = mi.FileResolver(before)
    extended.prepend(str(path.resolve().parent))
    _mi.set_file_resolver(extended)
    try:
        yield
    finally:
        _mi.set_file_resolver(before)
