"""When residuals leave the noise floor."""

from dataclasses import replace

import pytest

from stepdiag_ros.estimate import evaluate
from stepdiag_ros.nodes.gap_monitor import LEAST_DOF, leaving
from stepdiag_ros.virtual.cell import parse_cell
from stepdiag_ros.virtual.offline import simulate_log

CELL = """
schema: 1
seed: 4
machine: {name: small, chain: FXYZ, volume: [0.2, 0.16, 0.12], tool: [0.0, 0.0, -0.1]}
plan: {steps: 2, repeats: 2}
setups:
  ppp: {standoff: 0.2, psd_offset: [0.02, 0.0], beams: [[0.0, 0.0]]}
  npp: {standoff: 0.2, psd_offset: [0.02, 0.0], beams: [[0.0, 0.0]]}
motion: {feed: 0.5, acceleration: 8.0, jerk: 800.0, dwell: 0.03}
geometry: {drawn: {positioning: 4.0e-6, straightness: 2.0e-6, angle: 1.0e-5, squareness: 1.0e-5}}
"""


@pytest.fixture(scope='module')
def solution():
    return evaluate(simulate_log(parse_cell(CELL)))


def test_a_sound_machine_stays_within_the_noise(solution):
    state = leaving(solution)
    assert state is not None and abs(state.sigmas) < 4.0 and state.dof == solution.dof


def test_backlash_leaves_it(solution):
    cell = parse_cell(CELL + 'effects: {backlash: {B: [2.0e-5, 0.0, 0.0]}}\n')
    state = leaving(evaluate(simulate_log(cell)))
    assert state is not None and state.sigmas > 10.0 and state.worst_setup in ('ppp', 'npp')


def test_a_fit_without_freedom_says_nothing(solution):
    assert leaving(replace(solution, dof=LEAST_DOF - 1)) is None
    assert leaving(replace(solution, reduced_chi2=None)) is None
