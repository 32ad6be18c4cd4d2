"""Effects act on each other: behind a detector that is turned a mirror that is not flat shows elsewhere."""

from dataclasses import replace

import pytest

from stepdiag_ros.effects import effect_class
from stepdiag_ros.gap.diagnose import diagnose
from stepdiag_ros.gap.diagnosis import Diagnosis
from stepdiag_ros.twin.adopt import CLOSED, adopt
from stepdiag_ros.twin.twin import Twin
from stepdiag_ros.virtual.offline import simulate_log

from ..conftest import small_cell, times_left

TWO = {'psd_rotation': {'angle': 0.2}, 'mirror_curvature': {'radius': 2000.0, 'astigmatism': 0.5}}


@pytest.fixture(scope='module')
def both() -> Diagnosis:
    cell = small_cell(TWO)
    few = replace(cell.description, plan=replace(cell.description.plan, steps=4))
    return diagnose(simulate_log(replace(cell, description=few)), [effect_class(name)() for name in TWO])


def test_two_that_act_on_each_other_are_found_at_once(both, monkeypatch):
    assert {one.name for one in both.effects} == set(TWO)
    adopted = adopt(both)
    assert times_left(adopted.notes) <= CLOSED
    assert adopted.cell['effects']['psd_rotation']['angle'] == pytest.approx(0.2, abs=0.01)
    # The check can fail: one after the other they settle where neither can leave.
    monkeypatch.setattr('stepdiag_ros.twin.adopt.together', lambda diagnosis, twin: {})
    assert times_left(adopt(both).notes) > CLOSED


@pytest.mark.long
def test_each_is_found_beside_the_other(both, monkeypatch):
    """Each for itself they do more than both together."""
    monkeypatch.setattr(Twin, 'beside', lambda self, before, behind: self)
    assert times_left(adopt(both).notes) > CLOSED
