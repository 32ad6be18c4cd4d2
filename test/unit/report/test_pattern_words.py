"""Patterns without a name in plain words."""

import pytest

from stepdiag_ros.gap.alternatives.known_physics import beyond_families
from stepdiag_ros.gap.alternatives.unmodelled import unknown_families
from stepdiag_ros.gap.preprocess.observe import observe
from stepdiag_ros.report.pattern_words import pattern_words
from stepdiag_ros.virtual.cell import parse_cell
from stepdiag_ros.virtual.offline import simulate_log

CELL = """\
seed: 3
machine: {name: small, volume: [0.5, 0.4, 0.3], tool: [0.0, 0.0, -0.12]}
plan: {steps: 4, repeats: 2}
setups:
  ppp: {standoff: 0.3, psd_offset: [0.02, 0.0]}
  npp: {standoff: 0.3, psd_offset: [0.02, 0.0]}
  lin_x: {standoff: 0.3, psd_offset: [0.02, 0.0], length: 0.5, stops: 2}
misalignments: {drawn: {laser: 4e-4, mirror: 3e-4}}
motion: {feed: 0.3, acceleration: 3.0, jerk: 100.0, dwell: 0.3, mount: 120.0}
sampling: {interferometer: 50, psd: 50}
"""


@pytest.mark.parametrize(('label', 'said'), [
    ('displacement: places by direction in ppp',
     'the laser length belongs to places along ppp, and is opposite forward and backward'),
    ('mirror: wandering inside the runs', "the mirror's attitude wanders inside each run"),
    ('spot_x: jump at npp/0/+ stop 4', 'the spot in x jumps once (run npp/0/+, stop 4) and stays there'),
    ('constant: not alike from setup to setup',
     'a known pattern (constant) whose size differs from setup to setup'),
    ('displacement: bent beyond 35 % of the range', 'the laser length is bent beyond 35 % of its range'),
    ('displacement: follows the spot at 45°, saturating at 1 mm',
     'the laser length follows the spot along 45°, up to some 1 mm'),
    ('tool: turned by the direction of X, by place', 'the tool turns with the direction in which X moves, by place'),
    ('length: another unit from ppp/0/+ stop 4 on', 'the unit of length is another one from run ppp/0/+, stop 4 on'),
    ('EYX changes its shape, bow, slowing',
     'the guideway of X changes its shape in Y with time (as a bow; slowing)'),
    ('displacement: off by the direction of X', 'the laser length shifts with the direction in which X moves'),
    ('what X carries: turned and shifted, linear', 'what X carries turns and shifts with time (linear)'),
    ('EBX changes its shape, slope, smooth',
     'the carriage of X turns about Y, by its place and with time (in proportion to the place; smooth)'),
    ('EXX has another shape in each run', 'X is off along itself, by its place otherwise in each run'),
    ('an axis loses steps: X: shifted by which axis moved last',
     "an axis loses steps: X's position shifts with which axis moved last"),
    ('something never received of', 'something never received of')])
def test_what_has_no_name_is_said_in_words(label, said):
    assert pattern_words(label) == said


def test_no_form_is_left_with_its_label():
    """Whatever the diagnosis may say of a log, the page says in words."""
    view = observe(simulate_log(parse_cell(CELL))).view
    labels = {form.label for of in (unknown_families(view), beyond_families(view)) for forms in of.values()
              for form in forms}
    assert len(labels) > 500
    assert [label for label in labels if pattern_words(label) == label] == [
        'lengths and spots follow the signal quality']
