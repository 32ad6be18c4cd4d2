"""Effects act on each other: a detector that is turned sees a beam that wanders elsewhere."""

from dataclasses import replace

import pytest

from stepdiag_ros.effects import effect_class
from stepdiag_ros.gap.diagnose import diagnose
from stepdiag_ros.gap.diagnosis import Diagnosis
from stepdiag_ros.twin.adopt import CLOSED, adopt
from stepdiag_ros.twin.twin import Twin
from stepdiag_ros.virtual.offline import simulate_log

from ..conftest import small_cell

TWO = ('psd_rotation', 'beam_pointing_drift')
HALL = {'course': {'seconds': [0.0, 60.0, 150.0, 170.0, 400.0, 1000.0],
                   'values': [[0, 0], [9e-5, -3e-5], [3e-5, 4e-5], [-7e-5, 4e-5], [-3e-5, -6e-5], [-3e-5, -6e-5]]}}


@pytest.fixture(scope='module')
def both() -> Diagnosis:
    cell = small_cell({'psd_rotation': {'angle': 0.1}, 'beam_pointing_drift': HALL}, 0.1)
    few = replace(cell.description, plan=replace(cell.description.plan, steps=4))
    return diagnose(simulate_log(replace(cell, description=few)), [effect_class(name)() for name in TWO])


def left(adopted) -> float:
    note = next(note for note in adopted.notes if note.startswith('run along'))
    return float(note.split('leaves ')[1].split(' ')[0])


def test_each_is_found_beside_the_other(both, monkeypatch):
    assert {one.name for one in both.effects} == set(TWO)
    adopted = adopt(both)
    assert left(adopted) <= CLOSED
    # The check can fail: each for itself they do more than both together.
    monkeypatch.setattr(Twin, 'beside', lambda self, before, behind: self)
    assert left(adopt(both)) > CLOSED
