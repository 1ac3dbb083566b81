"""The uniform share of draws towards a sphere costs no more than its comment says."""

from mi_ellipse.sampling import projected_solid_angle as psa

from derivations import cap


def test_variance_of_the_least_density():
    found = [cap.largest_variance(factor * psa.LEAST_DENSITY) for factor in (0.5, 1, 2)]
    assert 0.006 < found[1] < 0.0065
    assert found == sorted(found)
