"""Pictures on disk, read by other programs and by this package."""

import os

import numpy as np
import pytest
from commands import files, read
from mi_ellipse.files import images


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
