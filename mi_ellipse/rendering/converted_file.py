"""Write a scene file anew with its built-in lamps converted, and everything else as it stands."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from xml.sax.saxutils import escape, quoteattr, unescape

import mitsuba as mi

from ..files import atomic
from ..plugins.names import AREA, ELLIPTICAL_AREA
from . import rewrite
from .rewrite import Conversion
from .scene import ParsedScene, parse_scene

# What Mitsuba's XML parser accepts and a strict one does not, such as "--" in a comment, is common
# in scene files. So this finds the tags itself, and the result is checked with Mitsuba's parser.
_TAG = re.compile(
    rb"<!--.*?-->|<!\[CDATA\[.*?\]\]>|<\?.*?\?>|<![^>]*>"
    rb"|<(?P<closes>/?)(?P<name>[\w:.-]+)(?P<rest>(?:\"[^\"]*\"|'[^']*'|[^'\">])*)>",
    re.DOTALL,
)
_ATTRIBUTE = re.compile(rb"([\w:.-]+)\s*=\s*(\"[^\"]*\"|'[^']*')")


def write_converted(
    scene_file: str | os.PathLike[str],
    output: str | os.PathLike[str],
    parameters: Mapping[str, str] | None = None,
    overwrite: bool = False,
) -> Conversion:
    """
    Write a scene file with every `area` that could be an `ellipticalarea` converted.

    Comments, layout, ``<default>`` and ids stay. An included file with such a lamp is copied into
    the place where it is included; others stay included. Relative names of files mean the same
    files as before, also if the new file lies in another folder.

    Parameters
    ----------
    scene_file
        XML scene, which is left alone.
    output
        File to write.
    parameters
        Values for the ``<default>`` parameters, where the scene cannot be read without them. They
        are not written.
    overwrite
        Replace a file that exists.

    Returns
    -------
    Conversion
        Which lamps were converted.

    Raises
    ------
    ValueError
        If `output` exists or is a file of the scene, or if the scene is written in a way that this
        function does not follow. Nothing is written then.
    """
    scene_file, output = Path(scene_file), Path(output)
    parsed = parse_scene(scene_file, parameters)
    if output.resolve() in [file.resolve() for file in parsed.scene_files]:
        raise ValueError(f"{output} is a file of the scene itself; choose another name")
    if output.exists() and not overwrite:
        raise ValueError(f"{output} exists already; choose another name, or say --overwrite")

    lamps, _ = rewrite.convertible(parsed.resolved())
    expected = mi.parser.ParserState(parsed.state)
    for lamp in lamps:
        expected.nodes[lamp.index].props.set_plugin_name(ELLIPTICAL_AREA)
    text = _Copy(parsed, {lamp.index for lamp in lamps}, output.resolve().parent).text()
    with atomic.replacement(output) as temporary:
        temporary.write_bytes(text)
        written = parse_scene(temporary, parameters)
        if written.state != expected or _named_files(written) != _named_files(parsed):
            raise ValueError(
                f"{scene_file} cannot be converted as a file: the result would not be the same"
                " scene; render it with --convert-lamps, or write"
                f' type="{ELLIPTICAL_AREA}" by hand'
            )
    return parsed.conversion()


def _named_files(parsed: ParsedScene) -> list[Path]:
    return [file for _, file in parsed.named_files()]


@dataclass(frozen=True)
class _Edit:
    """Bytes of a file from `start` to `end` that shall be others."""

    start: int
    end: int
    new: bytes


@dataclass(frozen=True)
class _Tag:
    """A start tag in a file, or the only one of an empty element."""

    name: bytes
    start: int  # Of its name, as Mitsuba counts
    end: int  # After the tag
    attributes: dict[bytes, tuple[int, int]]  # Where their values are, without the quotes

    @property
    def opening(self) -> int:
        return self.start - 1


@dataclass
class _Copy:
    """The text of a scene with changes, file by file in the order in which Mitsuba reads them."""

    parsed: ParsedScene
    lamps: set[int]  # Nodes of the emitters that are converted
    folder: Path  # Of the new file
    _next: int = field(default=0, init=False)  # The file that is read next

    def text(self) -> bytes:
        """Return the new scene file."""
        content, edits, tags = self._file()
        home = self.parsed.path.parent
        if self.folder != home:
            path = quoteattr(_relative(home, self.folder).replace("$", "\\$"))
            edits.append(_Edit(tags[0].end, tags[0].end, b"\n    <path value=%s/>" % path.encode()))
        return _apply(content, edits)

    def _file(self) -> tuple[bytes, list[_Edit], list[_Tag]]:
        """Read the next file, and find what changes in it."""
        number = self._next
        self._next += 1
        file = self.parsed.scene_files[number]
        content = file.read_bytes()
        tags = list(_tags(content))
        edits = [self._convert(content, file, tags, offset) for offset in self._offsets(number)]
        for tag in tags:
            if tag.name == b"include":
                edits += self._include(content, tag, file)
            elif tag.name == b"path":
                edits += self._move(content, tag, b"value", file)
        return content, edits, tags

    def _offsets(self, number: int) -> list[int]:
        """Return where Mitsuba found the lamps of a file."""
        nodes = self.parsed.state.nodes
        return [nodes[i].offset for i in sorted(self.lamps) if nodes[i].file_index == number]

    def _convert(self, content: bytes, file: Path, tags: list[_Tag], offset: int) -> _Edit:
        """Change the type of an emitter."""
        tag = next((tag for tag in tags if tag.start == offset), None)
        if tag is None or b"type" not in tag.attributes:
            raise ValueError(
                f"{file}: no emitter is found at byte {offset}; the file must be UTF-8"
            )
        if (value := _value(content, tag, b"type")) != AREA:
            raise ValueError(
                f'{file}: the type of an emitter is the parameter "{value}"; give that the value'
                f' "{ELLIPTICAL_AREA}" instead'
            )
        return _Edit(*tag.attributes[b"type"], ELLIPTICAL_AREA.encode())

    def _include(self, content: bytes, tag: _Tag, file: Path) -> list[_Edit]:
        """Copy an included file if one of its lamps is converted, else include it from here."""
        name = _value(content, tag, b"filename")
        pattern = "/".join(re.sub(r"\\\$\w+", ".*", re.escape(part)) for part in name.split("/"))
        files = self.parsed.scene_files
        if self._next == len(files) or not re.search(f"{pattern}$", files[self._next].as_posix()):
            # It is empty, so Mitsuba does not count it.
            return self._move(content, tag, b"filename", file)
        before, included = self._next, files[self._next]
        inner, edits, tags = self._file()
        nodes = self.parsed.state.nodes
        if not any(before <= nodes[i].file_index < self._next for i in self.lamps):
            return self._move(content, tag, b"filename", file, included)
        return [_Edit(tag.opening, tag.end, self._inlined(content, tag, inner, edits, tags))]

    def _inlined(
        self, content: bytes, tag: _Tag, inner: bytes, edits: list[_Edit], tags: list[_Tag]
    ) -> bytes:
        """Return the content of an included scene, or an included element without its version."""
        root = tags[0]
        if root.name == b"scene":
            closing = inner.rindex(b"</")
            outside = [_Edit(0, root.end, b""), _Edit(closing, len(inner), b"")]
        else:
            start, end = root.attributes[b"version"]
            version = inner[:start].rindex(b"version")
            name = content[slice(*tag.attributes[b"name"])] if b"name" in tag.attributes else b""
            replaced = b'name="%s"' % name if name else b""
            outside = [_Edit(0, root.opening, b""), _Edit(version, end + 1, replaced)]
        return _apply(inner, edits + outside).strip()

    def _move(
        self, content: bytes, tag: _Tag, attribute: bytes, file: Path, target: Path | None = None
    ) -> list[_Edit]:
        """
        Let a name that starts at the folder of its file start at that of the new one.

        `target` is the file that is meant, if it is known. Where a parameter begins the name, it
        stays, and so does a name that is found elsewhere: the <path> of the new file leads there.
        """
        name = _value(content, tag, attribute)
        home = file.resolve().parent
        found = target.resolve() if target and "$" not in name else home / name
        is_known = target is not None or "$" in name or found.exists()
        if self.folder == home or Path(name).is_absolute() or name[0] == "$" or not is_known:
            return []
        new = escape(_relative(found, self.folder), {'"': "&quot;", "'": "&apos;"})
        return [_Edit(*tag.attributes[attribute], new.encode())]


def _tags(content: bytes) -> Iterator[_Tag]:
    """Yield the start tags of a file."""
    for match in _TAG.finditer(content):
        if match["name"] and not match["closes"]:
            start = match.start("rest")
            attributes = {
                found[1]: (start + found.start(2) + 1, start + found.end(2) - 1)
                for found in _ATTRIBUTE.finditer(match["rest"])
            }
            yield _Tag(match["name"], match.start("name"), match.end(), attributes)


def _value(content: bytes, tag: _Tag, attribute: bytes) -> str:
    text = content[slice(*tag.attributes[attribute])].decode()
    return unescape(text, {"&quot;": '"', "&apos;": "'"})


def _relative(path: Path, folder: Path) -> str:
    return Path(os.path.relpath(path, folder)).as_posix()


def _apply(content: bytes, edits: list[_Edit]) -> bytes:
    """Return a text with edits made; they do not overlap."""
    parts, position = [], 0
    for edit in sorted(edits, key=lambda edit: edit.start):
        parts += [content[position : edit.start], edit.new]
        position = edit.end
    return b"".join([*parts, content[position:]])
