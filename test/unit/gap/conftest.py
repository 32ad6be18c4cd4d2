"""A small noisy cell, and its diagnosed logs."""

from functools import cached_property

import pytest

from stepdiag_ros.effects import all_effects, effect_class
from stepdiag_ros.effects.base import Effect
from stepdiag_ros.gap import Diagnosis, diagnose
from stepdiag_ros.gap.preprocess.observe import Observation, observe
from stepdiag_ros.model.log import CalibrationLog
from stepdiag_ros.virtual.cell import Cell, parse_cell
from stepdiag_ros.virtual.offline import simulate_log

LAYOUT = """\
seed: 11
machine: {name: small, volume: [0.5, 0.4, 0.3], tool: [0.0, 0.0, -0.12]}
plan: {steps: 5, repeats: 2}
setups:
  ppp: {standoff: 0.3, psd_offset: [0.02, 0.0]}
  npp: {standoff: 0.3, psd_offset: [0.02, 0.0]}
  pnp: {standoff: 0.3, psd_offset: [0.02, 0.0]}
  nnp: {standoff: 0.3, psd_offset: [0.02, 0.0]}
  lin_x: {standoff: 0.3, psd_offset: [0.02, 0.0], length: 0.5, stops: 2}
  lin_y: {standoff: 0.3, psd_offset: [0.02, 0.0], length: 0.4, stops: 2}
  lin_z: {standoff: 0.3, psd_offset: [0.02, 0.0], length: 0.3, stops: 2}
noise: NOISE
misalignments: {drawn: {laser: 4e-4, mirror: 3e-4}}
motion: {feed: 0.3, acceleration: 3.0, jerk: 100.0, in_position: 1.0e-9, settling: 0.005, dwell: 0.6, mount: 120.0}
sampling: {interferometer: 50, psd: 50, in_motion: true}
"""
NOISE = '{displacement: 5.0e-9, spot: 2.0e-7, position_repeatability: 3.0e-7, angle_repeatability: 2.0e-7}'
SILENCE = '{displacement: 0.0, spot: 0.0, position_repeatability: 0.0, angle_repeatability: 0.0}'
TEXT, QUIET = (LAYOUT.replace('NOISE', noise) for noise in (NOISE, SILENCE))


class Case:
    """Logs of the small cell with effects, their observation and diagnosis."""

    text, quiet = TEXT, QUIET

    def __init__(self):
        self.cell: Cell = parse_cell(TEXT)

    @cached_property
    def _plain(self) -> CalibrationLog:
        return simulate_log(self.cell)

    @cached_property
    def _plainly_observed(self) -> Observation:
        return observe(self._plain)

    def log(self, *effects: Effect) -> CalibrationLog:
        return simulate_log(self.cell, effects=list(effects)) if effects else self._plain

    def untidy(self, law: str, *effects: Effect, seed: int = 11, dwell: float = 0.6) -> CalibrationLog:
        """A log whose noise follows the cell file's ``noise_law``; ``dwell`` [s]."""
        text = TEXT.replace('seed: 11', f'seed: {seed}').replace('dwell: 0.6', f'dwell: {dwell}')
        return simulate_log(parse_cell(f'{text}noise_law: {law}\n'), effects=list(effects))

    def observe(self, *effects: Effect) -> Observation:
        return observe(self.log(*effects)) if effects else self._plainly_observed

    def diagnose(self, *effects: Effect) -> Diagnosis:
        return diagnose(self.log(*effects), [kind() for kind in all_effects().values()])


@pytest.fixture(scope='session')
def case() -> Case:
    return Case()


@pytest.fixture(scope='session')
def unaffected(case: Case) -> Diagnosis:
    """What the diagnosis makes of the log in which nothing acts."""
    return case.diagnose()


@pytest.fixture(scope='session')
def lost_motion(case: Case) -> Diagnosis:
    """What it makes of a log in which X and Z have lost motion."""
    return case.diagnose(effect_class('backlash')(B=[4e-6, 0.0, 3e-6]))
