"""Load a scene file, with its lamps' sampling strategy chosen from outside if wanted."""

# Types such as `mi.Scene` exist only once a variant is set.
from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from os import PathLike
from pathlib import Path

import mitsuba as mi

from .sampling import STRATEGIES

EMITTER = "ellipticalarea"


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
    path = Path(path)
    config = mi.parser.ParserConfig(mi.variant())
    with _files_found_beside(path):
        state = mi.parser.parse_file(config, str(path), **(parameters or {}))
        _refuse_detached_lamps(config, state)
        if sampling is not None:
            _choose_sampling(state, sampling)
        mi.parser.transform_all(config, state)
        scene = mi.parser.instantiate(config, state)
    if not isinstance(scene, mi.Scene):
        raise ValueError(f"{path}: the root element is no <scene>")
    return scene


def digest(path: str | PathLike[str], parameters: Mapping[str, str] | None = None) -> str:
    """
    Return a SHA-256 of what a scene file says and of the files it names, such as meshes.

    Equal for two files that differ in comments and layout alone; included files count in full.
    """
    path = Path(path)
    config = mi.parser.ParserConfig(mi.variant())
    with _files_found_beside(path):
        state = mi.parser.parse_file(config, str(path), **(parameters or {}))
        result = hashlib.sha256(mi.parser.write_string(state).encode())
        for node in state.nodes:
            if "filename" in node.props:
                file = Path(str(mi.file_resolver().resolve(node.props["filename"])))
                result.update(file.read_bytes() if file.is_file() else b"")
    return result.hexdigest()


def _lamps(state: mi.parser.ParserState) -> list[int]:
    return [i for i, node in enumerate(state.nodes) if node.props.plugin_name() == EMITTER]


def _choose_sampling(state: mi.parser.ParserState, sampling: str) -> None:
    """Write the strategy into every lamp of a parsed scene."""
    if sampling not in STRATEGIES:
        known = ", ".join(STRATEGIES)
        raise ValueError(f'unknown sampling strategy "{sampling}"; known are: {known}')

    lamps = _lamps(state)
    if not lamps:
        raise ValueError(
            f'a sampling strategy ("{sampling}") is given, but the scene has no "{EMITTER}"'
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
                f'{location}: this "{EMITTER}" belongs to no shape and would give no light; put it'
                " inside the <shape> that shall shine"
            )


@contextmanager
def _files_found_beside(path: Path) -> Iterator[None]:
    """Let relative file names of a scene start at its folder, as ``mi.load_file`` does."""
    before = mi.file_resolver()
    extended = mi.FileResolver(before)
    extended.prepend(str(path.resolve().parent))
    mi.set_file_resolver(extended)
    try:
        yield
    finally:
        mi.set_file_resolver(before)
