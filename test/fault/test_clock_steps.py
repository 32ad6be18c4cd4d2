"""The system clock is set during a run: the run goes on, the log says so, the result is as if nothing had been.

The clock is set by a library (``clock_shim.c``) that is preloaded into all processes of a cell: the real
clock of this computer stays as it is.
"""

import struct
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2

from stepdiag_ros.nodes import environment
from test.some import some

environment.prepare()

from stepdiag_ros.bag.reader import read_log  # noqa: E402 - after the environment
from stepdiag_ros.estimate import evaluate  # noqa: E402
from stepdiag_ros.model.log import DONE, DWELL  # noqa: E402
from stepdiag_ros.nodes.bringup import Bringup  # noqa: E402
from stepdiag_ros.nodes.replaying import assemble  # noqa: E402

CELL = """
schema: 1
seed: 7
machine: {name: clock, chain: FXYZ, volume: [0.10, 0.08, 0.06], tool: [0.0, 0.0, -0.10]}
plan: {steps: 1, order: XYZ, repeats: 1}
setups:
  ppp: {standoff: 0.20, psd_offset: [0.02, 0.0], beams: [[0.0, 0.0]]}
  lin_x: {standoff: 0.20, psd_offset: [0.02, 0.0], beams: [[0.0, 0.0]], length: 0.10, stops: 2}
air: {period: 1.0}
motion: {feed: 0.2, acceleration: 8.0, jerk: 800.0, in_position: 5.0e-8, settling: 0.002, dwell: 0.4}
sampling: {interferometer: 200.0, psd: 200.0, block: 0.05}
"""


def calibrate(folder: Path, monkeypatch, shim: Path, step_s: float = 0.0) -> object:
    """A calibration during which the clock is set; its outcome."""
    folder.mkdir()
    cell_file, clock = folder / 'clock.yaml', folder / 'time'
    cell_file.write_text(CELL, encoding='utf-8')
    clock.write_bytes(struct.pack('q', 0))
    monkeypatch.setenv('LD_PRELOAD', str(shim))
    monkeypatch.setenv('CLOCK_SHIM_FILE', str(clock))
    done = []

    def set_clock(feedback) -> None:
        if step_s and feedback.stop >= 5 and not done:
            with open(clock, 'r+b') as file:    # in place: the processes look at these very bytes
                done.append(file.write(struct.pack('q', round(step_s * 1e9))))
    with Bringup(cell_file, bag=folder / 'log', runtime=folder / 'run') as cell:
        return cell.operator.calibrate(feedback=set_clock, meanwhile=cell.watch)


@pytest.fixture(scope='module')
def still(module_domain, tmp_path_factory, clock_shim):
    """What a calibration says during which nobody sets the clock."""
    folder = tmp_path_factory.mktemp('still') / 'cell'
    with pytest.MonkeyPatch.context() as patch:
        outcome = calibrate(folder, patch, clock_shim)
    assert outcome.succeeded, outcome.message
    return evaluate(read_log(folder / 'log'))


@pytest.mark.parametrize('seconds', some(-5.0, later=[3600.0, -3600.0]))
def test_a_step_of_the_clock_is_marked_and_the_run_goes_on(ros_domain, tmp_path, monkeypatch, clock_shim, still,
                                                           seconds):
    outcome = calibrate(tmp_path / 'stepped', monkeypatch, clock_shim, seconds)
    assert outcome.succeeded, outcome.message
    assert f'the system clock was set by {seconds:+.3f} s' in outcome.message
    log = read_log(tmp_path / 'stepped' / 'log')
    said = [w for w in log.warnings if 'system clock was set' in w]
    assert {w.split(':')[0] for w in said} == {'step_sequencer', 'interferometer_driver', 'psd_driver'}
    assert not [w for w in log.warnings if 'runs backwards' in w or 'lost before' in w], log.warnings
    dwells = log.steps.time_ns[log.steps.phase == DONE] - log.steps.time_ns[log.steps.phase == DWELL]
    assert (dwells > 0.39e9).all() and (dwells < 1.5e9).all()
    assert np.ptp(log.steps.time_ns) < 120e9 and (np.diff(log.steps.time_ns) >= 0).all()
    # Every stop was measured, once.
    one, other = still, evaluate(log)
    # (But for a stop at which a busy computer polled the interferometer too late.)
    assert abs(other.dof - one.dof) <= 2
    assert chi2.sf(other.reduced_chi2 * other.dof, other.dof) > 1e-6     # a dwell that is cut wrongly gives thousands
    for name in ('EXX', 'EYX', 'EZX'):
        a, b = (s.to_json_dict()['errors'][name] for s in (one, other))
        assert (np.abs(np.subtract(a['value'], b['value'])) < 3.0 * np.hypot(a['sigma'], b['sigma']) + 1e-9).all()
    assert evaluate(assemble(tmp_path / 'stepped' / 'log').build()).reduced_chi2 == other.reduced_chi2
