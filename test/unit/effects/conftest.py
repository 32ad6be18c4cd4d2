"""A quiet cell, its log with and without an effect, and what the diagnosis sees of it."""

from dataclasses import dataclass

import numpy as np
import pytest

from stepdiag_ros.effects.base import Effect, Form, StopView
from stepdiag_ros.gap.preprocess.observe import Observation, observe
from stepdiag_ros.model.log import CalibrationLog
from stepdiag_ros.virtual.cell import Cell, parse_cell
from stepdiag_ros.virtual.offline import simulate_log

TEXT = """\
seed: 5
machine: {name: quiet, volume: [0.5, 0.4, 0.3], tool: [0.02, -0.01, -0.12]}
plan: {steps: 3, repeats: 1}
setups:
  ppp: {standoff: 0.3, psd_offset: [0.02, 0.01]}
  npp: {standoff: 0.3, psd_offset: [0.02, 0.01]}
  pnp: {standoff: 0.3, psd_offset: [0.02, 0.01]}
  nnp: {standoff: 0.3, psd_offset: [0.02, 0.01]}
  lin_x: {standoff: 0.3, psd_offset: [0.02, 0.01], length: 0.5, stops: 2}
  lin_y: {standoff: 0.3, psd_offset: [0.02, 0.01], length: 0.4, stops: 2}
  lin_z: {standoff: 0.3, psd_offset: [0.02, 0.01], length: 0.3, stops: 2}
noise: {displacement: 1.0e-11, spot: 1.0e-11, position_repeatability: 1.0e-10, angle_repeatability: 1.0e-10}
misalignments: {drawn: {laser: 4e-4, mirror: 3e-4}}
air: {temperature: 20.0, sensors: [temperature, pressure, humidity, scale], period: 1.0}
motion: {feed: 0.5, acceleration: 4.0, jerk: 400.0, in_position: 1.0e-10, settling: 0.001, dwell: 0.5, mount: 30.0}
sampling: {interferometer: 50, psd: 50, in_motion: false}
"""


@dataclass(frozen=True)
class Bench:
    """The quiet cell without effects, observed; ``free``: basis (N, p) of what the nominal fit can take."""

    cell: Cell
    log: CalibrationLog
    plain: Observation
    free: np.ndarray

    @property
    def view(self) -> StopView:
        return self.plain.view

    def with_effect(self, effect: Effect) -> Observation:
        return observe(simulate_log(self.cell, effects=[effect]))

    def change(self, other: Observation) -> np.ndarray:
        """What the effect does to the stops' means (n, c) [m]."""
        return other.view.reading - self.view.reading

    def left(self, columns: np.ndarray) -> np.ndarray:
        """Columns (k, n, c) without what errors, misalignments and resets can imitate: (N, k)."""
        flat = columns.reshape(len(columns), -1).T
        return flat - self.free @ (self.free.T @ flat)

    def fitted(self, form: Form, change: np.ndarray) -> tuple[np.ndarray, float]:
        """Coefficients (k,) of a form for a change (n, c), and the share of it that remains."""
        columns, target = self.left(form.columns), self.left(change[None])[:, 0]
        size = np.linalg.norm(columns, axis=0)
        found = np.linalg.lstsq(columns / size, target, rcond=1e-9)[0] / size
        return found, float(np.linalg.norm(target - columns @ found) / np.linalg.norm(target))


def bench_of(text: str) -> Bench:
    """A cell file's text, simulated and observed."""
    cell = parse_cell(text)
    log = simulate_log(cell)
    plain = observe(log)
    jacobian = plain.fit.jacobian.toarray()
    size = np.linalg.norm(jacobian, axis=0)
    vector, value, _ = np.linalg.svd(jacobian[:, size > 0] / size[size > 0], full_matrices=False)
    return Bench(cell, log, plain, vector[:, value > 1e-9 * value[0]])


@pytest.fixture(scope='session')
def bench() -> Bench:
    return bench_of(TEXT)


@pytest.fixture(scope='session')
def other_bench() -> Bench:
    """A moving table, three beams, another order of the axes."""
    text = TEXT.replace('{name: quiet,', '{name: other, chain: XYFZ,')
    text = text.replace('steps: 3,', 'steps: 3, order: ZXY,')
    text = text.replace('psd_offset: [0.02, 0.01]', 'psd_offset: [0.02, 0.01], beams: [[0, 0], [0.025, 0], [0, 0.025]]')
    # Three beams a nanometre apart would be all but exactly one another at the quiet cell's noise.
    text = text.replace('1.0e-11', '1.0e-9').replace('1.0e-10, angle_repeatability: 1.0e-10',
                                                     '1.0e-8, angle_repeatability: 1.0e-8')
    return bench_of(text)
