"""What changes at once keeps the name of where it acts: a lamp that is switched, a beam that is knocked."""

import numpy as np
import pytest

from stepdiag_ros.effects.base import Effect


class Lamp(Effect):
    """A lamp is switched on: its light pulls the spot to the detector's middle."""

    name = 'lamp'

    def after_light(self, moment):
        lit = moment.seconds > 520.0
        moment.spot = moment.spot * (1.0 - 0.06 * lit)[:, None]


class Knock(Effect):
    """Somebody knocks at the laser's stand."""

    name = 'knock'

    def before_light(self, moment):
        moment.laser = moment.laser + 2e-5 * (moment.seconds > 520.0)[:, None] * np.array([0.8, -0.6])


@pytest.mark.long
@pytest.mark.parametrize(('kind', 'name'), [(Lamp, 'ambient_light'), (Knock, 'beam_pointing_drift')])
def test_what_changes_at_once_is_named_by_where_it_acts(case, kind, name):
    found = case.diagnose(kind())
    assert [e.name for e in found.effects] == [name] and found.effects[0].probability > 0.9
    assert found.verdict == 'explained', found.unmodelled
    assert any('from ' in a.form.label and ' on' in a.form.label for a in found.joint.active)
