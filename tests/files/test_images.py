"""Pictures on disk, read by other programs and by this package."""

import os
import subprocess
import sys

import mitsuba as mi
import numpy as np
import OpenEXR
import pytest
from commands import files, read
from mi_ellipse.files import images

RNG = np.random.default_rng(4)


def picture(channels, height=7, width=5):
    """Random values, of which few are the same in half precision."""
    return RNG.lognormal(size=(height, width, channels)).astype(np.float32)


# ---- OpenEXR ----


@pytest.mark.parametrize(
    ("count", "channels", "names"),
    [
        (1, None, ("Y",)),
        (2, None, ("Y", "A")),
        (3, None, ("R", "G", "B")),
        (4, None, ("R", "G", "B", "A")),
        (3, ("albedo.R", "albedo.G", "albedo.B"), ("albedo.R", "albedo.G", "albedo.B")),
        (5, ("R", "G", "B", "d.T", "n.X"), ("R", "G", "B", "d.T", "n.X")),
    ],
)
def test_mitsuba_and_openexr_read_what_is_written(tmp_path, count, channels, names):
    image, path = picture(count), tmp_path / "picture.exr"
    images.write_exr(path, image, {}, channels)

    bitmap = mi.Bitmap(str(path))
    assert tuple(field.name for field in bitmap.struct_()) == names
    np.testing.assert_array_equal(np.array(bitmap).reshape(image.shape), image)

    found = OpenEXR.File(str(path), separate_channels=True).channels()
    assert set(found) == set(names)
    for i, name in enumerate(names):
        np.testing.assert_array_equal(found[name].pixels, image[..., i])

    assert images.read_channels(path) == names
    np.testing.assert_array_equal(images.read_exr(path), image)
    assert images.read_exr(path).dtype == np.float32


def test_channels_of_a_layer_stay_together_whatever_their_order(tmp_path):
    names = ("n.Z", "B", "albedo.G", "n.X", "R", "albedo.R", "G", "A", "n.Y", "uv.U", "uv.V")
    image = picture(len(names))
    images.write_exr(tmp_path / "a.exr", image, channels=names)
    expected = (
        "R", "G", "B", "A", "albedo.R", "albedo.G", "n.X", "n.Y", "n.Z", "uv.U", "uv.V",
    )  # fmt: skip
    assert images.read_channels(tmp_path / "a.exr") == expected
    order = [names.index(name) for name in expected]
    np.testing.assert_array_equal(images.read_exr(tmp_path / "a.exr"), image[..., order])


def test_files_of_mitsuba_are_read(tmp_path):
    image = picture(3)
    bitmap = mi.Bitmap(image)
    bitmap.metadata()["spp"] = "8"
    bitmap.write(str(tmp_path / "a.exr"))
    np.testing.assert_array_equal(images.read_exr(tmp_path / "a.exr"), image)
    assert images.read_metadata(tmp_path / "a.exr")["spp"] == "8"


def test_memory_in_any_order_is_written_right(tmp_path):
    image = picture(3)
    for view in (image[::-1, ::2], np.asfortranarray(image), image.astype(np.float64)):
        images.write_exr(tmp_path / "a.exr", view)
        np.testing.assert_array_equal(read(tmp_path / "a.exr"), view)


def test_half_precision_by_choice(tmp_path):
    image = picture(3)
    image[0, 0] = 65504, 6e-8, np.inf
    images.write_exr(tmp_path / "half.exr", image, half=True)
    bitmap = mi.Bitmap(str(tmp_path / "half.exr"))
    assert bitmap.component_format() == mi.Struct.Type.Float16
    with np.errstate(over="ignore"):
        expected = image.astype(np.float16).astype(np.float32)
    assert (expected != image).any()
    np.testing.assert_array_equal(images.read_exr(tmp_path / "half.exr"), expected)

    image[1, 1, 1] = 7e4
    with pytest.raises(ValueError, match=r"holds 70000, and half precision ends at 65504"):
        images.write_exr(tmp_path / "half.exr", image, half=True)
    np.testing.assert_array_equal(images.read_exr(tmp_path / "half.exr"), expected)


def test_attributes_keep_their_types(tmp_path):
    metadata = {"text": "±1", "digits": "08", "whole": -3, "number": 0.1}
    images.write_exr(tmp_path / "a.exr", picture(3), metadata)
    header = OpenEXR.File(str(tmp_path / "a.exr")).header()
    assert {name: header[name] for name in ("text", "digits", "whole")} == {
        "text": "±1", "digits": "08", "whole": -3,
    }  # fmt: skip
    assert header["number"].dtype == np.float64
    # Red, green, blue and white of ITU-R BT.709
    np.testing.assert_allclose(
        header["chromaticities"], [0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329], rtol=1e-6
    )
    for_mitsuba = mi.Bitmap(str(tmp_path / "a.exr")).metadata()
    assert {name: for_mitsuba[name] for name in metadata} == metadata
    assert images.read_metadata(tmp_path / "a.exr") == {
        name: str(value) for name, value in metadata.items()
    }


@pytest.mark.parametrize(
    ("image", "options", "message"),
    [
        (np.ones((2, 2)), {}, r"its shape is \(2, 2\)"),
        (np.ones((0, 2, 3)), {}, r"its shape is \(0, 2, 3\)"),
        (np.ones((2, 2, 5)), {}, "5 channels needs their names"),
        (np.ones((2, 2, 2)), {"channels": ("R", "R")}, "a name of its own"),
        (np.ones((2, 2, 2)), {"channels": ("R", "G", "B")}, "2 channels"),
        (np.ones((2, 2, 3)), {"metadata": {"compression": "best"}}, "'compression'"),
    ],
)
def test_impossible_pictures_are_refused(tmp_path, image, options, message):
    with pytest.raises(ValueError, match=message):
        images.write_exr(tmp_path / "a.exr", image, **options)
    assert files(tmp_path) == []


def test_unreadable_files_are_named(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"gone\.exr"):
        images.read_exr(tmp_path / "gone.exr")
    (tmp_path / "text.exr").write_text("no picture")
    with pytest.raises(ValueError, match=r"text\.exr: this is no OpenEXR file"):
        images.read_exr(tmp_path / "text.exr")
    images.write_exr(tmp_path / "a.exr", picture(3))
    whole = (tmp_path / "a.exr").read_bytes()
    for length in (100, len(whole) - 20):
        (tmp_path / "cut.exr").write_bytes(whole[:length])
        with pytest.raises(ValueError, match=r"cut\.exr: the OpenEXR file is damaged"):
            images.read_exr(tmp_path / "cut.exr")


@pytest.mark.parametrize("suffix", ["exr", "png"])
def test_full_disk_leaves_the_old_file(tmp_path, suffix):
    # The limit on the size of files cuts off the last bytes alone, which libraries write when they
    # close a file: too late to complain.
    path = tmp_path / f"a.{suffix}"
    code = (
        "import resource, sys; import numpy as np; from mi_ellipse.files import images\n"
        "image = np.random.default_rng(1).random((9, 9, 3))\n"
        f"images.write_{suffix}(sys.argv[1], image)\n"
        "size = len(open(sys.argv[1], 'rb').read())\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (size - 5, size - 5))\n"
        f"images.write_{suffix}(sys.argv[1], image[::-1])\n"
    )
    process = subprocess.run([sys.executable, "-c", code, path], capture_output=True, text=True)
    assert process.returncode == 1
    assert "OSError" in process.stderr.splitlines()[-1]
    assert files(tmp_path) == [path.name]
    assert read(path).shape == (9, 9, 3)


# ---- Several parts ----


def test_parts_keep_names_order_and_pixels(tmp_path):
    path = tmp_path / "parts.exr"
    parts = {"reference": picture(3), "solid angle": picture(4), "difference": picture(1)}
    images.write_parts(path, parts, {"spp": "64"})
    found = images.read_parts(path)
    assert list(found) == list(parts)
    for name, image in parts.items():
        np.testing.assert_array_equal(found[name], image)
    assert images.read_metadata(path) == {"spp": "64"}

    opened = OpenEXR.File(str(path)).parts
    assert [part.name() for part in opened] == list(parts)
    assert [part.header["spp"] for part in opened] == ["64"] * 3
    np.testing.assert_array_equal(opened[0].channels["RGB"].pixels, parts["reference"])
    np.testing.assert_array_equal(read(path), parts["reference"])  # Mitsuba reads the first one


def test_parts_in_half_precision(tmp_path):
    parts = {"a": picture(3), "b": picture(3)}
    images.write_parts(tmp_path / "parts.exr", parts, half=True)
    for name, image in images.read_parts(tmp_path / "parts.exr").items():
        np.testing.assert_array_equal(image, parts[name].astype(np.float16))


def test_a_single_picture_has_one_part_without_a_name(tmp_path):
    image = picture(3)
    images.write_exr(tmp_path / "a.exr", image)
    (found,) = images.read_parts(tmp_path / "a.exr").items()
    assert found[0] == ""
    np.testing.assert_array_equal(found[1], image)


def test_parts_are_not_taken_for_a_single_picture(tmp_path):
    images.write_parts(tmp_path / "parts.exr", {"one": picture(3), "two": picture(3)})
    with pytest.raises(ValueError, match=r"several parts \(one, two\)"):
        images.read_exr(tmp_path / "parts.exr")


def test_parts_of_different_sizes_are_refused(tmp_path):
    parts = {"one": picture(3), "two": picture(3, 2, 2)}
    with pytest.raises(ValueError, match=r"one size, .*'one': \(7, 5\), 'two': \(2, 2\)"):
        images.write_parts(tmp_path / "parts.exr", parts)


@pytest.mark.parametrize("parts", [{}, {"": np.ones((2, 2, 3))}])
def test_parts_need_names(tmp_path, parts):
    with pytest.raises(ValueError, match="at least one part, each with a name"):
        images.write_parts(tmp_path / "parts.exr", parts)


# ---- Damage ----


def test_no_altered_bit_of_a_picture_is_read_in_silence(tmp_path):
    image, path = picture(3), tmp_path / "picture.exr"
    about = {"text": "Größe\n", "count": 3, "seconds": 0.1}
    images.write_exr(path, image, about)
    whole, metadata = path.read_bytes(), images.read_metadata(path)
    choose = np.random.default_rng(1)
    noticed = 0
    for place in choose.integers(len(whole), size=300):
        altered = bytearray(whole)
        altered[place] ^= 1 << int(choose.integers(8))
        path.write_bytes(altered)
        try:
            found, about = images.read_picture(path)
        except ValueError as error:
            noticed += str(path) in str(error)
            continue
        # The bit has no part in pixels and settings, as those of the chromaticities.
        np.testing.assert_array_equal(found, image)
        assert about == metadata
    assert noticed > 200


def test_files_without_a_checksum_are_read_but_not_taken_for_whole(tmp_path):
    path = tmp_path / "picture.exr"
    mi.Bitmap(picture(3)).write(str(path))
    assert images.read_exr(path).shape == (7, 5, 3)
    with pytest.raises(ValueError, match="has no checksum"):
        images.read_picture(path)


def test_the_name_of_the_checksum_is_taken(tmp_path):
    with pytest.raises(ValueError, match="'checksum'"):
        images.write_exr(tmp_path / "picture.exr", picture(3), {"checksum": "0"})


# ---- For the screen ----


def test_srgb_is_that_of_mitsuba():
    linear = np.linspace(-0.1, 1.1, 3 * 500).reshape(20, 25, 3)
    bitmap = mi.Bitmap(np.float32(np.clip(linear, 0, 1)))
    expected = bitmap.convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.Float32, srgb_gamma=True)
    # Mitsuba computes it in single precision.
    np.testing.assert_allclose(images.to_srgb(linear), np.array(expected), atol=1e-6)


def test_luminance():
    image = np.zeros((2, 3, 4))
    image[..., 1], image[..., 3] = 2, 7  # green alone, and an alpha that does not count
    np.testing.assert_allclose(images.luminance(image), np.full((2, 3), 2 * 0.7152))
    np.testing.assert_allclose(images.luminance(np.full((2, 3, 1), 5.0)), np.full((2, 3), 5.0))


def test_exposure_shows_a_grey_picture_at_four_fifths(tmp_path):
    image = np.full((4, 4, 3), 0.2)
    exposure = images.choose_exposure(image)
    assert exposure == 2
    images.write_png(tmp_path / "grey.png", image, exposure)
    srgb = 255 * (1.055 * 0.8 ** (1 / 2.4) - 0.055)  # IEC 61966-2-1
    np.testing.assert_allclose(read(tmp_path / "grey.png"), srgb, atol=1)
    assert images.choose_exposure(np.zeros((4, 4, 3))) == 0


@pytest.mark.parametrize("write", [images.write_exr, images.write_png])
def test_interrupted_write_leaves_the_old_file(tmp_path, monkeypatch, write):
    path = tmp_path / f"picture.{write.__name__[-3:]}"
    write(path, np.zeros((4, 4, 3)))
    before = path.read_bytes()

    def interrupt(source, target):
        assert os.path.dirname(source) == os.path.dirname(target)
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(os, "replace", interrupt)
        with pytest.raises(KeyboardInterrupt):
            write(path, np.ones((4, 4, 3)))
    assert (files(tmp_path), path.read_bytes()) == ([path.name], before)
    write(path, np.ones((4, 4, 3)))
    assert path.read_bytes() != before


def test_sum_behind_a_picture_is_kept_to_the_bit(tmp_path):
    file = tmp_path / "sum.exr"
    image = np.random.default_rng(1).random((3, 5, 2), dtype=np.float32)
    total = np.random.default_rng(2).random((3, 5, 2)) * 1e9
    total[0, 0], total[1, 1], total[2, 2] = (np.nan, -np.inf), (1e300, 5e-324), (-0.0, 1 / 3)
    images.write_with_sum(file, image, total, {"spp": "7"}, ("Y", "depth.T"))
    assert images.read_sum(file, ("Y", "depth.T")).tobytes() == total.tobytes()
    assert np.array_equal(images.read_parts(file)["picture"], image)
    assert images.read_metadata(file) == {"spp": "7"}
    assert np.array_equal(np.array(mi.Bitmap(str(file))), image)  # other programs see the picture
    with pytest.raises(ValueError, match=r"sum.exr: the file holds no sum of the channels R, G, B"):
        images.read_sum(file, ("R", "G", "B"))
