"""Mirror forms: heights, slopes, and the surfaces built from them."""

import numpy as np
import pytest

from stepdiag_ros.model.mirror_form import FlatForm, HeightForm, SphericalForm, quadratic_form

AXES = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
POINT = (0.0, 0.0, 0.0)


@pytest.mark.parametrize('cubic', [(0.0, 0.0, 0.0, 0.0), (1e-2, 2e-2, -3e-2, 4e-2)])
def test_gradient_is_the_slope_of_the_height(cubic):
    form = quadratic_form(2e-3, 5e-4, -3e-4, cubic)
    x, y = np.random.default_rng(1).uniform(-0.1, 0.1, (2, 50))
    h = 1e-3
    off_x, off_y = cubic[0] * h**2 / 6.0, cubic[3] * h**2 / 6.0    # by which a difference of a cubic is too steep
    gx, gy = form.gradient(x, y)
    np.testing.assert_allclose((form.height(x + h, y) - form.height(x - h, y)) / (2 * h), gx + off_x, atol=1e-15)
    np.testing.assert_allclose((form.height(x, y + h) - form.height(x, y - h)) / (2 * h), gy + off_y, atol=1e-15)


@pytest.mark.parametrize(('form', 'height'), [
    (FlatForm(), 0.0),
    (SphericalForm(1e-3), 0.5e-3 * 0.05**2),
    (quadratic_form(1e-3), 0.5e-3 * 0.05**2),
    (quadratic_form(0.0, 1e-3), 0.5e-3 * (0.03**2 - 0.04**2)),
    (quadratic_form(0.0, 0.0, 1e-3), 1e-3 * 0.03 * 0.04),
    (quadratic_form(0.0, cubic=(1e-2, 0.0, 2e-2, 0.0)), 1e-2 * 0.03**3 / 6.0 + 0.5 * 2e-2 * 0.03 * 0.04**2),
    (HeightForm(lambda x, y: 1e-6 + 0.0 * x, lambda x, y: (0.0 * x, 0.0 * y)), 1e-6),
])
def test_light_from_above_strikes_at_the_height(form, height):
    t, normal = form.surface(POINT, AXES).hit((0.03, 0.04, 1.0), (0.0, 0.0, -1.0))
    # A sphere's height differs from the paraboloid's by c³r⁴/8.
    assert 1.0 - t == pytest.approx(height, abs=2e-15)
    assert normal[2] > 0.99


def test_a_positive_curvature_is_hollow():
    for form in (SphericalForm(1e-2), quadratic_form(1e-2)):
        _, normal = form.surface(POINT, AXES).hit((0.05, 0.0, 1.0), (0.0, 0.0, -1.0))
        assert normal[0] == pytest.approx(-5e-4, rel=1e-6)
