"""Read and write pictures: OpenEXR for linear values, PNG for the screen."""

from __future__ import annotations

import hashlib
import io
import json
import math
from collections.abc import Mapping
from os import PathLike
from typing import Any

import mitsuba as mi
import numpy as np
import OpenEXR
from numpy.typing import ArrayLike, NDArray

from .atomic import write_bytes

# Names of the channels by their number, where a caller does not name them
DEFAULT_CHANNELS = {1: ("Y",), 2: ("Y", "A"), 3: ("R", "G", "B"), 4: ("R", "G", "B", "A")}

# Red, green, blue and white point (x, y) of ITU-R BT.709, in which Mitsuba renders
CHROMATICITIES = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)
LUMINANCE = (0.2126, 0.7152, 0.0722)  # of red, green and blue; ITU-R BT.709

# Digest of the pixels and of what else the header says, see :func:`_checksum`
CHECKSUM = "checksum"

# Attributes by which a file describes itself. They are no settings of a picture.
STRUCTURE = {
    CHECKSUM,
    "channels", "chromaticities", "chunkCount", "compression", "dataWindow", "displayWindow",
    "lineOrder", "name", "pixelAspectRatio", "screenWindowCenter", "screenWindowWidth", "tiles",
    "type", "version", "view",
}  # fmt: skip

# OpenEXR sorts the channels of a file by name; a picture has them in this order in each layer.
CHANNEL_ORDER = "RGBXYZA"

SUM = "sum"  # Name of the part that holds the sum behind a picture

Image = NDArray[np.float32]
Metadata = Mapping[str, str | int | float]
Planes = dict[str, NDArray[Any]]  # pixels (height, width) by the names of their channels


# ---- OpenEXR ----


def write_exr(
    path: str | PathLike[str],
    image: ArrayLike,
    metadata: Metadata | None = None,
    channels: tuple[str, ...] | None = None,
    half: bool = False,
) -> None:
    """
    Write a linear picture as OpenEXR; an older file stays whole until the new one is.

    The header carries a checksum of pixels and metadata, by which readers notice altered files.

    Parameters
    ----------
    path
        Output file.
    image
        Array of shape (height, width, channels).
    metadata
        Attributes for the header. Texts stay texts, integers and floating-point numbers keep their
        type; :func:`read_metadata` and ``mi.Bitmap(path).metadata()`` read them back.
    channels
        Names of the channels; needed where they are not luminance or RGB, with or without alpha.
    half
        Store half instead of single precision: 11 significant bits, and at most 65504.

    Raises
    ------
    ValueError
        If `image` has another shape, a channel has no name, a value is too large for half
        precision, or an attribute has a name that OpenEXR uses itself.
    OSError
        If the file cannot be written.
    """
    pixels = _pixels(image, channels, half)
    _write(path, OpenEXR.File(_header(metadata, pixels), pixels))


def write_parts(
    path: str | PathLike[str],
    parts: Mapping[str, ArrayLike],
    metadata: Metadata | None = None,
    half: bool = False,
) -> None:
    """
    Write several pictures as named parts of one OpenEXR file, which viewers step through.

    Parameters
    ----------
    path
        Output file, replaced whole.
    parts
        Pictures by their names, each as for :func:`write_exr`, with luminance or RGB, with or
        without alpha, and all of one height and width.
    metadata
        Attributes for the header of every part.
    half
        As for :func:`write_exr`.

    Raises
    ------
    ValueError
        As :func:`write_exr`; for pictures of different sizes; without any part, or for one without
        a name.
    """
    if not parts or not all(parts):
        raise ValueError(f"parts={list(parts)}: a file needs at least one part, each with a name")
    sizes = {name: np.shape(image)[:2] for name, image in parts.items()}
    if len(set(sizes.values())) > 1:
        raise ValueError(f"parts: all must have one size, and theirs are {sizes}")
    made = []
    for name, image in parts.items():
        pixels = _pixels(image, None, half)
        made.append(OpenEXR.Part(_header(metadata, pixels), pixels, name))
    _write(path, OpenEXR.File(made))


def write_with_sum(
    path: str | PathLike[str],
    image: ArrayLike,
    total: NDArray[np.float64],
    metadata: Metadata,
    channels: tuple[str, ...],
) -> None:
    """
    Write a picture with the sum that it was made from, to the last bit.

    OpenEXR knows no double precision. So the file has a second part, whose channels are pairs of
    integers. Programs that read one part see the picture alone.

    Parameters
    ----------
    path, image, metadata, channels
        See :func:`write_exr`.
    total
        Array of the shape of `image`.
    """
    bits = np.ascontiguousarray(total).view(np.uint32).reshape(*total.shape, 2)
    words = {
        f"{name}.{word}": np.ascontiguousarray(bits[..., i, word])
        for i, name in enumerate(channels)
        for word in (0, 1)
    }
    pixels = _pixels(image, channels, False)
    parts = [
        OpenEXR.Part(_header(metadata, pixels), pixels, "picture"),
        OpenEXR.Part(_header(None, words), words, SUM),
    ]
    _write(path, OpenEXR.File(parts))


def read_sum(path: str | PathLike[str], channels: tuple[str, ...]) -> NDArray[np.float64]:
    """
    Return the sum that :func:`write_with_sum` has written.

    Raises
    ------
    ValueError
        If the file holds none, has other channels, or is damaged.
    OSError
        If it cannot be read.
    """
    for part in _open(path).parts:
        if part.name() == SUM and len(part.channels) == 2 * len(channels):
            planes = _planes(path, part)
            words = [[planes[f"{name}.{word}"] for word in (0, 1)] for name in channels]
            bits = np.moveaxis(np.array(words, dtype=np.uint32), (0, 1), (-2, -1))
            return np.ascontiguousarray(bits).view(np.float64)[..., 0]
    raise ValueError(f"{path}: the file holds no sum of the channels {', '.join(channels)}")


def fits_half(image: ArrayLike) -> bool:
    """Tell whether half precision, which ends at 65504, holds all finite values of a picture."""
    image = np.asarray(image)
    # From here on, rounding gives infinity.
    return bool(np.abs(image[np.isfinite(image)]).max(initial=0) < 65520)


def read_exr(path: str | PathLike[str]) -> Image:
    """
    Return the picture of an OpenEXR file as an array of shape (height, width, channels).

    Channels come in the order of :func:`read_channels`, for colours R, G, B, A.

    Raises
    ------
    ValueError
        If the file is no OpenEXR file, is damaged, or has several parts. Altered pixels or metadata
        count as damage, where the file has a checksum of :func:`write_exr`.
    OSError
        If it cannot be read.
    """
    return _image(path, _single_part(path))


def read_picture(path: str | PathLike[str]) -> tuple[Image, dict[str, str]]:
    """
    Return the picture of :func:`read_exr` with the attributes of :func:`read_metadata`, both whole.

    Raises
    ------
    ValueError
        As :func:`read_exr`, and if the file has no checksum.
    OSError
        If the file cannot be read.
    """
    part = _single_part(path)
    if CHECKSUM not in part.header:
        raise ValueError(f"{path}: the file has no checksum")
    return _image(path, part), _texts(part.header)


def read_channels(path: str | PathLike[str]) -> tuple[str, ...]:
    """Return the names of the channels that :func:`read_exr` gives, in the same order."""
    return _channel_names(_single_part(path))


def read_parts(path: str | PathLike[str]) -> dict[str, Image]:
    """
    Return the pictures of an OpenEXR file by the names of its parts.

    The only part of a file may have no name; its key is then empty. Errors are those of
    :func:`read_exr`.
    """
    return {part.name(): _image(path, part) for part in _open(path).parts}


def read_metadata(path: str | PathLike[str]) -> dict[str, str]:
    """
    Return the attributes of an OpenEXR file that hold texts or numbers, all as texts.

    Attributes that describe the file itself (its channels, its compression, …) are left out. In a
    file of several parts they are those of the first part. Errors are those of :func:`read_exr`.
    """
    return _texts(_open(path, header_only=True).header())


def _texts(header: Mapping[str, Any]) -> dict[str, str]:
    """Return the settings in a header as texts."""
    found = {}
    for name, value in header.items():
        if isinstance(value, np.ndarray) and value.shape == (1,):  # a number in double precision
            value = value.item()
        if name not in STRUCTURE and isinstance(value, (str, int, float)):
            found[name] = str(value)
    return found


def _write(path: str | PathLike[str], file: Any) -> None:
    # By way of memory: OpenEXR does not notice if a disk is too full for the last bytes.
    buffer = io.BytesIO()
    file.write(buffer)
    write_bytes(path, buffer.getbuffer())


def _header(metadata: Metadata | None, pixels: Planes) -> dict[str, Any]:
    """Return the attributes of a part as OpenEXR wants them."""
    metadata = metadata or {}
    if reserved := sorted(STRUCTURE & set(metadata)):
        raise ValueError(
            f"metadata: the file itself uses the name {reserved[0]!r}; choose another one"
        )
    typed = {
        # OpenEXR stores a Python float in single precision, but an array of one as it is.
        name: np.array([value]) if isinstance(value, float) else value
        for name, value in metadata.items()
    }
    return typed | {
        CHECKSUM: _checksum(_texts(typed), pixels),
        "type": OpenEXR.scanlineimage,
        "compression": OpenEXR.ZIP_COMPRESSION,
        "chromaticities": CHROMATICITIES,
    }


def _checksum(metadata: Mapping[str, str], pixels: Planes) -> str:
    """Return a SHA-256 of settings, names of channels and pixels."""
    result = hashlib.sha256(json.dumps(metadata, sort_keys=True).encode())
    for name in sorted(pixels):
        plane = np.ascontiguousarray(pixels[name])
        result.update(f"{name} {plane.dtype.name} {plane.shape}".encode())
        result.update(plane.data)
    return result.hexdigest()


def _pixels(image: ArrayLike, channels: tuple[str, ...] | None, half: bool) -> Planes:
    """Return the channels of a picture by name."""
    image = np.asarray(image)
    if image.ndim != 3 or 0 in image.shape:
        raise ValueError(f"image: its shape is {image.shape}, and not (height, width, channels)")
    names = channels or DEFAULT_CHANNELS.get(image.shape[2])
    if names is None:
        raise ValueError(f"channels: a picture with {image.shape[2]} channels needs their names")
    if len(set(names)) != image.shape[2]:
        raise ValueError(
            f"channels={names}: the picture has {image.shape[2]} channels, and each needs a name"
            " of its own"
        )
    if half and not fits_half(image):
        largest = np.abs(image[np.isfinite(image)]).max()
        raise ValueError(
            f"half=True: the picture holds {largest:g}, and half precision ends at 65504; write it"
            " in single precision"
        )
    precision = np.float16 if half else np.float32
    # OpenEXR takes the memory as it lies and ignores strides.
    return {
        name: np.ascontiguousarray(image[..., i], dtype=precision) for i, name in enumerate(names)
    }


def _open(path: str | PathLike[str], header_only: bool = False) -> Any:
    """Open a file of OpenEXR, and say what is wrong with one that cannot be opened."""
    # The library writes its own complaint to the terminal; most files are sorted out before.
    with open(path, "rb") as file:
        if file.read(4) != b"\x76\x2f\x31\x01":  # the magic number of the format
            raise ValueError(f"{path}: this is no OpenEXR file")
    try:
        opened = OpenEXR.File(str(path), separate_channels=True, header_only=header_only)
    except (RuntimeError, UnicodeDecodeError) as error:
        raise ValueError(f"{path}: the OpenEXR file is damaged ({error})") from None
    if not opened.parts:
        raise ValueError(f"{path}: the OpenEXR file is damaged: it has no complete picture")
    return opened


def _single_part(path: str | PathLike[str]) -> Any:
    parts = _open(path).parts
    if len(parts) > 1:
        names = ", ".join(part.name() for part in parts)
        raise ValueError(f"{path}: the file has several parts ({names}); read them as parts")
    return parts[0]


def _channel_names(part: Any) -> tuple[str, ...]:
    """Return the names of a part's channels: those without a layer first, R before G before B."""

    def order(name: str) -> tuple[str, int, str]:
        layer, _, last = name.rpartition(".")
        known = len(last) == 1 and last in CHANNEL_ORDER
        return layer, CHANNEL_ORDER.index(last) if known else len(CHANNEL_ORDER), last

    return tuple(sorted(part.channels, key=order))


def _image(path: str | PathLike[str], part: Any) -> Image:
    return np.stack(list(_planes(path, part).values()), axis=-1).astype(np.float32)


def _planes(path: str | PathLike[str], part: Any) -> Planes:
    """Return the pixels of a part, if they are those that were written."""
    planes = {name: part.channels[name].pixels for name in _channel_names(part)}
    wanted = part.header.get(CHECKSUM)
    if wanted is not None and wanted != _checksum(_texts(part.header), planes):
        raise ValueError(f"{path}: the OpenEXR file is damaged: its checksum is wrong")
    return planes


# ---- For the screen ----


def write_png(path: str | PathLike[str], image: ArrayLike, exposure: float = 0.0) -> None:
    """
    Write a picture for the screen: 8 bits a channel, sRGB, clipped at white.

    Parameters
    ----------
    path
        Output file; as with :func:`write_exr`, it is replaced whole.
    image
        Linear array of shape (height, width, channels); channels after RGB are left out, and
        values that are not finite become black.
    exposure
        Stops to brighten by, see :func:`choose_exposure`.
    """
    rgb = np.nan_to_num(_to_rgb(image), nan=0.0, posinf=0.0, neginf=0.0) * 2.0**exposure
    bitmap = mi.Bitmap(np.ascontiguousarray(rgb, dtype=np.float32))
    # Mitsuba's own conversion, since it dithers: smooth gradients show no steps.
    bitmap = bitmap.convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.UInt8, srgb_gamma=True)
    stream = mi.MemoryStream()
    bitmap.write(stream, mi.Bitmap.FileFormat.PNG)
    write_bytes(path, stream.raw_buffer())


def choose_exposure(image: ArrayLike) -> float:
    """
    Return an exposure in stops that suits a picture: 0 leaves it as it is, 1 doubles it.

    The luminance that 95 % of the pixels stay below becomes 0.8, so that a lamp in the picture may
    burn out and the scene does not. Half stops, so that noise does not change the exposure between
    two renders of a scene.
    """
    grey = luminance(image)
    grey = grey[np.isfinite(grey)]
    bright = float(np.percentile(grey, 95)) if grey.size else 0.0
    return round(2 * math.log2(0.8 / bright)) / 2 if bright > 0 else 0.0


def luminance(image: ArrayLike) -> NDArray[np.float64]:
    """
    Return the luminance (height, width) of a linear picture (height, width, channels).

    Weights are those of ITU-R BT.709. The first channel is taken where there are less than three.
    """
    grey: NDArray[np.float64] = _to_rgb(image) @ np.array(LUMINANCE)
    return grey


def to_srgb(linear: ArrayLike) -> NDArray[np.float64]:
    """Return linear values as sRGB (IEC 61966-2-1), clipped to [0, 1]."""
    linear = np.clip(np.asarray(linear, dtype=np.float64), 0.0, 1.0)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


def _to_rgb(image: ArrayLike) -> NDArray[np.float64]:
    """Return the colour of a picture in double precision, luminance repeated."""
    image = np.asarray(image, dtype=np.float64)
    return image[..., :3] if image.shape[2] >= 3 else image[..., [0, 0, 0]]
