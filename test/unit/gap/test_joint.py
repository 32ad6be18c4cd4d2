"""Machine and effects fitted together."""

from dataclasses import replace

import numpy as np

from stepdiag_ros.effects import effect_class
from stepdiag_ros.gap.evidence import SIZES, width_of
from stepdiag_ros.gap.joint import solve, tuned


def test_a_coefficient_that_nothing_settles_is_held_to_the_size_of_the_others(case):
    found = case.diagnose(effect_class('psd_zero_offset')(x=3e-5, y=1e-5))
    active, space = found.joint.active[0], found.joint.parity
    form = active.form
    loose = replace(form, held=None, columns=np.concatenate([form.columns, 0.0 * form.columns[:1]]),
                    names=(*form.names, 'never seen'), scale=np.append(form.scale, form.scale[0]))
    (effect, held), = tuned(space, [(active.effect, loose)])
    assert width_of(held) < 0.5 * SIZES[-1]
    result, = solve(space, [(effect, held)])
    assert np.sqrt(result.covariance[-1, -1]) <= 1.001 * width_of(held) * held.scale[-1]
    free, = solve(space, [(effect, loose)])
    settled = np.sqrt(np.diag(free.covariance))[:-1] < 0.05 * np.abs(free.coefficients[:-1])
    assert settled.any()
    assert np.allclose(result.coefficients[:-1][settled], free.coefficients[:-1][settled], rtol=0.02)
