"""Pack a scene with the files that it names, for a machine that shares no disk with this one."""

from __future__ import annotations

import hashlib
import re
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.parsers import expat

import mitsuba as mi

from . import provenance
from .scene import ParsedScene, parse_scene

# Mitsuba's stubs know the functions of the file resolver under another name.
_mi: Any = mi

# A start tag, with attributes in either kind of quotes
TAG = re.compile(rb"""<[^\s/>]+(?:\s+[^\s=]+\s*=\s*(?:"[^"]*"|'[^']*'))*\s*/?>""")
ATTRIBUTE = rb"""(\s%s\s*=\s*)(?:"[^"]*"|'[^']*')"""

# An attribute of an element, and the value that it shall have
Edit = tuple[str, str]


@dataclass(frozen=True)
class Parcel:
    """
    A scene whose files lie side by side, each named by a digest of its content.

    Equal files are one file. What the XML files say stays as it is, to the last digit; only the
    names of files in them are new.
    """

    scene: str  # name of the scene file among `files`
    files: Mapping[str, bytes]  # name → content
    parameters: Mapping[str, str]  # that still have a meaning; those of file names have none
    scene_digest: str  # of the scene that was packed
    origins: Mapping[str, Path]  # name → file that was packed


def unpack(files: Mapping[str, bytes], folder: Path) -> None:
    """Write the files of parcels into a folder; what is there has the same content."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, content in files.items():
        if not (folder / name).exists():
            (folder / name).write_bytes(content)


def pack(scene: Path, parameters: Mapping[str, str]) -> Parcel:
    """
    Pack a scene under the variant that is set.

    Raises
    ------
    FileNotFoundError
        If the scene names a file that does not exist.
    ValueError
        If the scene cannot be packed so that it says the same.
    RuntimeError
        From Mitsuba, if the scene file is missing or wrong.
    """
    parsed = parse_scene(scene, parameters)
    packer = _Packer(parsed, parameters)
    name = packer.xml(parsed.path, _mi.file_resolver())
    kept = {key: value for key, value in parameters.items() if key in packer.used}
    _check(parsed, packer, name, kept)
    files = packer.texts | packer.assets
    return Parcel(name, files, kept, provenance.parsed_digest(parsed), packer.origins)


class _Packer:
    """Collect files under their new names; names are read as Mitsuba's parser reads them."""

    def __init__(self, parsed: ParsedScene, parameters: Mapping[str, str]):
        self.texts: dict[str, bytes] = {}  # what the parser reads: XML files and spectra
        self.assets: dict[str, bytes] = {}  # meshes, textures, volumes
        self.origins: dict[str, Path] = {}
        self.used: set[str] = set()  # parameters of other things than names of files
        self.renamed: list[str] = []  # new names of the assets, in the order of the scene
        self._values = dict(parameters)
        self._of_assets: Any = parsed.resolver
        self._names: dict[Path, str] = {}
        for _, file in parsed.named_files():
            if file not in self._names:
                self._names[file] = self._keep(self.assets, file, file.read_bytes())
            self.renamed.append(self._names[file])

    def xml(self, file: Path, resolver: Any) -> str:
        """Pack an XML file and what it includes, and return its new name."""
        resolver, content = _beside(file, resolver), file.read_bytes()
        edits: list[tuple[int, Edit]] = []

        def start(tag: str, attributes: dict[str, str]) -> None:
            edit = self._edit(tag, attributes, resolver)
            if edit is not None:
                edits.append((reader.CurrentByteIndex, edit))

        reader = expat.ParserCreate()
        reader.StartElementHandler = start
        try:
            reader.Parse(content, True)
        except expat.ExpatError as error:
            raise ValueError(f"{file} cannot be packed: {error}") from None
        for index, edit in reversed(edits):
            content = _edited(content, index, edit)
        return self._keep(self.texts, file, content)

    def _edit(self, tag: str, attributes: Mapping[str, str], resolver: Any) -> Edit | None:
        """Return what has to change in an element, if it names a file."""
        if tag == "include":
            file = self._find(attributes["filename"], resolver)
            return "filename", self.xml(file, resolver)
        if tag == "spectrum" and "filename" in attributes:
            file = self._find(attributes["filename"], resolver)
            return "filename", self._keep(self.texts, file, file.read_bytes())
        if tag == "string" and attributes["name"] == "filename":
            return "value", self._names[self._find(attributes["value"], self._of_assets).resolve()]
        if tag == "path":
            resolver.prepend(str(self._find(attributes["value"], resolver)))
            return "value", "."
        values = {name: self._substitute(value, self.used) for name, value in attributes.items()}
        if tag == "default":
            self._values.setdefault(values["name"], values["value"])
        return None

    def _find(self, name: str, resolver: Any) -> Path:
        return Path(str(resolver.resolve(self._substitute(name, set()))))

    def _substitute(self, text: str, used: set[str]) -> str:
        """Return a text with the values of its parameters, whose names go to `used`."""
        for name in sorted(self._values, key=len, reverse=True):
            pattern = rf"(?<!\\)\${re.escape(name)}"
            text, count = re.subn(pattern, lambda _, name=name: self._values[name], text)  # type: ignore[misc]
            if count:
                used.add(name)
        return text.replace(r"\$", "$")

    def _keep(self, files: dict[str, bytes], file: Path, content: bytes) -> str:
        # Mitsuba reads the format of a file from its suffix.
        suffix = file.suffix if file.suffix.isascii() else ""
        name = hashlib.sha256(content).hexdigest() + suffix
        files[name], self.origins[name] = content, file
        return name


def _beside(file: Path, resolver: Any) -> Any:
    """Return a file resolver that looks first where a file lies."""
    extended = mi.FileResolver(resolver)
    extended.prepend(str(file.resolve().parent))
    return extended


def _edited(content: bytes, index: int, edit: Edit) -> bytes:
    """Return the content of an XML file with one attribute changed, in the tag at `index`."""
    attribute, value = (part.encode() for part in edit)
    found = TAG.match(content, index)
    assert found is not None  # The parser has found a tag here.
    tag = re.sub(ATTRIBUTE % attribute, rb'\g<1>"%s"' % value, found[0])
    return content[:index] + tag + content[found.end() :]


def _check(parsed: ParsedScene, packer: _Packer, name: str, parameters: Mapping[str, str]) -> None:
    """Raise a ValueError unless the packed scene says what the scene says, but for file names."""
    expected = mi.parser.ParserState(parsed.state)
    nodes = [node for node in expected.nodes if "filename" in node.props]
    for node, renamed in zip(nodes, packer.renamed, strict=True):
        node.props["filename"] = renamed
    with tempfile.TemporaryDirectory() as folder:
        unpack(packer.texts, Path(folder))
        state = parse_scene(Path(folder) / name, parameters).state
    if mi.parser.write_string(state) != mi.parser.write_string(expected):
        raise ValueError(
            f"{parsed.path} cannot be packed for another machine: name its files by their paths"
            " from the folder of the scene"
        )
