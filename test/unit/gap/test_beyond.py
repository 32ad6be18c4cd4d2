"""What no effect of the vocabulary does is not given the name of one, and what one does keeps its name."""

import numpy as np
import pytest

from stepdiag_ros.effects import effect_class
from stepdiag_ros.effects.base import Effect
from stepdiag_ros.effects.cyclic_nonlinearity import DECOYS, WAVELENGTHS
from stepdiag_ros.gap.beyond import beyond_families


class Leak(Effect):
    """The spot leaks into the length and saturates."""

    name = 'leak'

    def after_light(self, moment):
        moment.length = moment.length + 4e-5 * np.tanh(moment.spot[:, :1] / 5e-4)


class Twist(Effect):
    """The head turns with the direction of Z."""

    name = 'twist'

    def before_pose(self, moment):
        moment.turn = moment.turn + 4e-6 * moment.approach[:, [2]] * np.array([1.0, 0.5, 0.0])


class Bow(Effect):
    """Y's guideway bends into an S in the course of the log."""

    name = 'bow'

    def before_pose(self, moment):
        place = moment.commanded[:, 1] / 0.4
        size = 6e-6 * (1.0 - np.exp(-moment.seconds / 400.0)) * np.sin(2.0 * np.pi * place)
        moment.shift = moment.shift + size[:, None] * np.eye(3)[2]


@pytest.mark.parametrize(('kind', 'words'), [(Leak, 'follows the spot'), (Twist, 'turned by the direction of Z'),
                                             (Bow, 'changes its shape')])
def test_physics_of_no_name_is_not_named(case, kind, words):
    found = case.diagnose(kind())
    assert not found.effects, [(e.name, e.probability) for e in found.effects]
    assert found.verdict == 'unexplained'
    assert words in found.leftover


def test_a_fringe_keeps_its_name(case):
    given = effect_class('cyclic_nonlinearity')(amp=1.2e-7, amp2=0.0, phase=0.4, wavelength=1.53e-6)
    found = case.diagnose(given)
    assert [e.name for e in found.effects] == ['cyclic_nonlinearity']
    assert found.verdict == 'explained'


def test_decoys_are_of_no_laser():
    """Neither a wavelength nor its half or double: those a real swing shows at too."""
    for wavelength in WAVELENGTHS:
        for factor in (0.5, 1.0, 2.0):
            assert min(abs(d / (factor * wavelength) - 1.0) for d in DECOYS) > 0.02


def test_columns_fit_their_log(case):
    view = case.observe().view
    for family, forms in beyond_families(view).items():
        for form in forms:
            assert form.columns.shape[1:] == view.reading.shape, family
            assert np.all(np.isfinite(form.columns)) and np.any(form.columns), form.label
