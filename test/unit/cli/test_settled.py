"""What is printed of a further run: what is open, what the cell does and why, how long it takes."""

from pathlib import Path

import pytest

from stepdiag_ros.cli.settled import open_words, round_line, run_words, span
from stepdiag_ros.gap.experiment_design.extended_log import Run
from stepdiag_ros.gap.experiment_design.next_run import NextRun
from stepdiag_ros.gap.experiment_design.without_hands import Able
from stepdiag_ros.model.description import Setup
from stepdiag_ros.nodes.settling import Round

SETUP = Setup('pnp', 0.2, (0.02, 0.0), ((0.0, 0.0),))
OPEN = {'psd_zero_offset': 0.62, 'mirror_curvature': 0.08, 'nothing': 0.3}


def able(run: Run, error: float = 0.01, seconds: float = 11.6) -> Able:
    return Able('pnp', NextRun(run, 5.0, error, ('mirror_curvature', 'psd_zero_offset'), False, ''), seconds)


def test_a_round_says_what_is_open_and_what_is_done_and_how_long():
    line = round_line(1, Round(OPEN, able(Run(SETUP, known=False)), Path('bags/log_further_1')))
    assert line == (f'further run 1: open: {open_words(OPEN)}. The cell mounts pnp and measures it, which the log does '
                    'not hold; expected to decide with odds of 100 to one; takes about 12 s; log: '
                    'bags/log_further_1')
    assert "Spot sensor's zero is off (62 %)" in line
    assert 'more than 10000 to one' in round_line(2, Round(OPEN, able(Run(SETUP), 0.0), Path('b')))


@pytest.mark.parametrize('run, words', [
    (Run(SETUP), 'mounts pnp and measures it'),
    (Run(SETUP, again_after=0.0), 'mounts pnp and measures it, and again at once'),
    (Run(SETUP, wait=600.0, watch=90.0, again_after=300.0),
     'waits 10 min, mounts pnp, records it for 90 s before it moves, and measures it, and again after 5 min')])
def test_what_the_cell_does(run, words):
    assert run_words('pnp', run) == words


def test_durations():
    assert (span(11.6), span(119.0), span(150.0), span(3600.0)) == ('12 s', '119 s', '2 min', '60 min')
