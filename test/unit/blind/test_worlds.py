"""What is judged in the sealed worlds, without their noise or with it alone."""

import numpy as np
import pytest

from stepdiag_ros.blind.apart import apart
from stepdiag_ros.blind.floor import floor
from stepdiag_ros.blind.world import Order, make
from stepdiag_ros.effects import all_effects
from stepdiag_ros.gap.diagnose import diagnose
from stepdiag_ros.gap.preprocess.observe import observe


@pytest.fixture(scope='module')
def made():
    return make(Order('develop', 5, 1, 'single', ('backlash',), 'field', small=True))


@pytest.mark.long
def test_the_floor_is_where_a_gap_closed_to_the_noise_ends(made):
    bare, effects = observe(made.yardstick.log), [kind() for kind in all_effects().values()]
    before, after = diagnose(made.yardstick.log, effects).cross_validation, diagnose(made.log, effects).cross_validation
    assert floor(bare) == pytest.approx(before.before)
    assert after.before > 1.2 * after.after
    # Both logs have the same realised noise: the residual of the one without its effect is what the other began with.
    assert after.after == pytest.approx(floor(bare), abs=0.05)


def test_an_effect_stands_for_itself_and_no_rival_does(made):
    left = apart(made, observe(made.yardstick.log))
    assert left['backlash'] < 0.5 * min(value for name, value in left.items() if name != 'backlash')
    assert all(np.isfinite(list(left.values())))
