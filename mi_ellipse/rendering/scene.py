"""Load a scene file, with its lamps' sampling strategy chosen from outside if wanted."""

# Types such as `mi.Scene` exist only once a variant is set.
from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi

from ..plugins.attachment import attach_all
from ..plugins.names import ELLIPTICAL_AREA
from ..system.threads import use_threads
from . import rewrite
from .changes import UNCHANGED, Changes, sensor_names
from .rewrite import Conversion

UNUSED = "unused parameters"  # In Mitsuba's error for values that a scene does not use

# Mitsuba's stubs know the functions of the file resolver and of the log under other names.
_mi: Any = mi


@dataclass(frozen=True)
class ParsedScene:
    """What a scene file says, under the variant that was set when it was parsed."""

    path: Path
    config: mi.parser.ParserConfig
    state: mi.parser.ParserState
    resolver: mi.FileResolver  # Knows the scene's folder and what its <path> elements add

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
        with self.files_found():
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

    def resolved(self) -> mi.parser.ParserState:
        """Return a copy with the names of the current version, and with references resolved."""
        state = mi.parser.ParserState(self.state)
        mi.parser.transform_upgrade(self.config, state)
        mi.parser.transform_resolve(self.config, state)
        return state

    def conversion(self) -> Conversion:
        """Tell which lamps ``convert_lamps`` converts."""
        return rewrite.convert_lamps(self.resolved())

    def sensors(self) -> tuple[str, ...]:
        """Return the ids of the sensors, and numbers for those without."""
        return tuple(sensor_names(self.resolved()))

    @contextmanager
    def files_found(self) -> Iterator[None]:
        """Let relative file names mean what they mean in the scene."""
        before = _mi.file_resolver()
        _mi.set_file_resolver(self.resolver)
        try:
            yield
        finally:
            _mi.set_file_resolver(before)


def set_variant(variant: str) -> None:
    """
    Set Mitsuba's variant.

    Raises
    ------
    ValueError
        If it needs a GPU that Dr.Jit cannot use here.
    ImportError
        From Mitsuba, if there is no such variant.
    """
    if variant.startswith("cuda") and not dr.has_backend(dr.JitBackend.CUDA):
        raise ValueError(
            f"variant={variant}: Dr.Jit finds no NVIDIA GPU here; choose one that starts with llvm"
            " or scalar"
        )
    mi.set_variant(variant)


def load_scene(
    path: str | PathLike[str],
    parameters: Mapping[str, str] | None = None,
    sampling: str | None = None,
    convert_lamps: bool = False,
) -> mi.Scene:
    """
    Load an XML scene as ``mi.load_file`` does, and refuse lamps that would give no light.

    Parameters
    ----------
    path
        Scene file. It stays as it is.
    parameters
        Values for the scene's ``<default>`` parameters.
    sampling
        Strategy for every ``ellipticalarea`` of the scene, whatever the scene says, or for single
        ones, see :func:`mi_ellipse.rendering.rewrite.choose_sampling`. None leaves the scene's
        choices.
    convert_lamps
        Turn every ``area`` on a ``disk``, ``sphere``, ``ellipse`` or ``ellipsoid`` into an
        ``ellipticalarea``, before `sampling` is applied. Mitsuba's log says at level "Info" which.

    Raises
    ------
    ValueError
        If an ``ellipticalarea`` belongs to no shape, if `sampling` is unknown, if it is given but
        the scene has no ``ellipticalarea``, if the scene does not use one of `parameters`, if a
        film has no pixels, or if the file holds something other than a scene or is a folder.
    RuntimeError
        From Mitsuba, for everything that is wrong with the file itself.
    """
    parsed = parse_scene(path, parameters)
    if convert_lamps:
        _mi.Log(mi.LogLevel.Info, str(parsed.conversion()))
    return instantiate(parsed, sampling, Changes(convert_lamps))


def check_scene_file(path: Path) -> None:
    """Raise a ValueError for a folder; Mitsuba says itself that a file does not exist."""
    if path.is_dir():
        raise ValueError(f"{path} is a folder, and not the XML file of a scene")


def parse_scene(
    path: str | PathLike[str], parameters: Mapping[str, str] | None = None
) -> ParsedScene:
    """
    Read an XML scene under the current variant, without loading it.

    Parameters and errors are those of :func:`load_scene`.
    """
    path = Path(path)
    check_scene_file(path)
    config = mi.parser.ParserConfig(mi.variant() or "")
    before = _mi.file_resolver()
    resolver = _mi.FileResolver(before)
    resolver.prepend(str(path.resolve().parent))
    _mi.set_file_resolver(resolver)
    try:
        state = mi.parser.parse_file(config, str(path), **(parameters or {}))
    except RuntimeError as error:
        if UNUSED in str(error):
            raise ValueError(_unknown_parameters(path, parameters or {})) from None
        raise
    finally:
        _mi.set_file_resolver(before)
    return ParsedScene(path.resolve(), config, state, resolver)


def _unknown_parameters(path: Path, parameters: Mapping[str, str]) -> str:
    """Return the error for values of parameters that a scene does not use."""
    config = mi.parser.ParserConfig(mi.variant() or "")
    config.unused_parameters = mi.LogLevel.Debug
    state = mi.parser.parse_file(config, str(path), **parameters)
    known: dict[str, None] = {}  # In the order of the files
    for file in state.files:
        text = re.sub(r"<!--.*?-->", "", Path(str(file)).read_text("utf-8", "replace"), flags=re.S)
        known |= dict.fromkeys(re.findall(r"(?<!\\)\$(\w+)", text))
    unknown = ", ".join(
        f"{name}={value}" for name, value in parameters.items() if name not in known
    )
    names = f"known are: {', '.join(known)}" if known else "it has none"
    return f"{path}: the scene has no parameter for {unknown}; {names}"


def instantiate(
    parsed: ParsedScene, sampling: str | None = None, changes: Changes = UNCHANGED
) -> mi.Scene:
    """
    Load a scene that has been parsed, changed; errors are those of :func:`load_scene`.

    What was parsed stays as it is and can be loaded again.
    """
    with parsed.files_found():
        state = parsed.resolved()
        _refuse_empty_films(state)
        _refuse_detached_lamps(state)
        changes.apply(state)
        if sampling is not None:
            rewrite.choose_sampling(state, sampling)
        mi.parser.transform_all(parsed.config, state)
        # Several threads build a ray tracing hierarchy whose order changes from one load to the
        # next, and with it the last digits of where rays meet meshes.
        with use_threads(1):
            scene = mi.parser.instantiate(parsed.config, state)
    if not isinstance(scene, mi.Scene):
        raise ValueError(f"{parsed.path}: the root element is no <scene>")
    attach_all(scene)
    return scene


def _refuse_empty_films(state: mi.parser.ParserState) -> None:
    """Raise an error for a film without pixels, which Mitsuba takes for a wrong field of view."""
    for node in state.nodes:
        if node.type == mi.ObjectType.Film:
            for side in ("width", "height"):
                if side in node.props and node.props[side] == 0:
                    location = mi.parser.file_location(state, node)
                    raise ValueError(f"{location}: {side}=0, but a film needs at least 1 pixel")


def _refuse_detached_lamps(state: mi.parser.ParserState) -> None:
    """
    Raise an error for a lamp outside every shape, which Mitsuba would ignore without a word.

    The resolved tree shows it, while the finished scene no longer knows of such a lamp.
    """
    attached = {pair.index for pair in rewrite.pairs(state)}
    for index, node in enumerate(state.nodes):
        if node.props.plugin_name() == ELLIPTICAL_AREA and index not in attached:
            raise ValueError(
                f'{mi.parser.file_location(state, node)}: this "{ELLIPTICAL_AREA}" belongs to no'
                " shape and would give no light; put it inside the <shape> that shall shine"
            )


@contextmanager
def under_variant(variant: str) -> Iterator[None]:
    """Set a variant of Mitsuba, and set that of the caller again in the end."""
    before = mi.variant()
    set_variant(variant)
    try:
        yield
    finally:
        if before is not None:
            mi.set_variant(before)
