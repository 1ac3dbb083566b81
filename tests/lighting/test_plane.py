"""Measuring planes and their texts."""

import numpy as np
import pytest
from mi_ellipse.lighting.plane import Plane, read_plane

BOX = (-1, -2, 0), (3, 4, 5)


def test_points_are_the_centres_of_the_cells():
    plane = Plane((1, 2, 3), (4, 0, 0), (0, 0, 2))
    points = plane.points(2, 3)
    assert points.shape == (3, 2, 3)
    np.testing.assert_allclose(points[0], [[2, 2, 3 + 1 / 3], [4, 2, 3 + 1 / 3]])
    np.testing.assert_allclose(points[2, 1], [4, 2, 3 + 5 / 3])
    np.testing.assert_allclose(plane.normal, [0, -1, 0])
    np.testing.assert_allclose(plane.flipped().normal, [0, 1, 0])
    np.testing.assert_array_equal(plane.flipped().points(2, 3), points)


@pytest.mark.parametrize(
    ("text", "origin", "first", "second", "normal"),
    [
        ("z=0.85", (-1, -2, 0.85), (4, 0, 0), (0, 6, 0), (0, 0, 1)),
        (" x = -1 ", (-1, -2, 0), (0, 6, 0), (0, 0, 5), (1, 0, 0)),
        ("y=2", (-1, 2, 0), (0, 0, 5), (4, 0, 0), (0, 1, 0)),
        ("0,1,2, 2,0,0, 0,0,3", (0, 1, 2), (2, 0, 0), (0, 0, 3), (0, -1, 0)),
    ],
)
def test_texts(text, origin, first, second, normal):
    plane = read_plane(text, *BOX)
    assert (plane.origin, plane.first, plane.second) == (origin, first, second)
    np.testing.assert_allclose(plane.normal, normal, atol=1e-15)


@pytest.mark.parametrize("text", ["", "z", "z=", "z=a", "w=1", "1,2,3", "1,2,3,4,5,6,7,8,x"])
def test_other_texts_are_refused(text):
    with pytest.raises(ValueError, match=rf"plane={text}: write z=HEIGHT .*, or nine numbers"):
        read_plane(text, *BOX)


@pytest.mark.parametrize(
    ("text", "box", "message"),
    [
        ("0,0,0,1,0,0,2,0,0", BOX, "span no area"),
        ("0,0,0,1,0,0,0,0,0", BOX, "span no area"),
        ("0,0,0,1,0,0,0,inf,0", BOX, "finite"),
        ("z=nan", BOX, "finite"),
        ("z=1", ((np.inf,) * 3, (-np.inf,) * 3), "no shapes"),
        ("z=1", ((0, 0, 0), (0, 1, 1)), "span no area"),
    ],
)
def test_planes_without_area_are_refused(text, box, message):
    with pytest.raises(ValueError, match=message):
        read_plane(text, *box)
