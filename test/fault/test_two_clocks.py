"""Drivers on another computer, whose clock is off: measured while the log is recorded, and no finding afterwards.

The other computer is made of this one: a driver's process, and no other, has a system clock that is shifted
(``clock_shim.c``) and, so that nobody takes it for ours, another name.
"""

import struct
from pathlib import Path

import numpy as np
import pytest

from stepdiag_ros.nodes import environment
from test.some import some

environment.prepare()

from stepdiag_ros.bag.reader import build_log, read_log  # noqa: E402 - after the environment
from stepdiag_ros.bag.schemas import CLOCK_OFFSET  # noqa: E402
from stepdiag_ros.bag.source import open_bag  # noqa: E402
from stepdiag_ros.bag.tables import collect  # noqa: E402
from stepdiag_ros.effects import all_effects  # noqa: E402
from stepdiag_ros.estimate import evaluate  # noqa: E402
from stepdiag_ros.gap import diagnose  # noqa: E402
from stepdiag_ros.model.log import DWELL, CalibrationLog  # noqa: E402
from stepdiag_ros.nodes.bringup import Bringup  # noqa: E402
from stepdiag_ros.nodes.replaying import assemble  # noqa: E402

CELL = """
schema: 1
seed: 11
machine: {name: apart, chain: FXYZ, volume: [0.10, 0.08, 0.06], tool: [0.0, 0.0, -0.10]}
plan: {steps: 3, order: XYZ, repeats: 2}
setups:
  ppp: {standoff: 0.20, psd_offset: [0.02, 0.0], beams: [[0.0, 0.0]]}
  lin_x: {standoff: 0.20, psd_offset: [0.02, 0.0], beams: [[0.0, 0.0]], length: 0.10, stops: 4}
geometry:
  drawn: {positioning: 8.0e-6, straightness: 4.0e-6, angle: 4.0e-5, squareness: 1.5e-5}
misalignments:
  drawn: {laser: 3.0e-4, mirror: 2.0e-4, psd_zero: 0.0}
air: {period: 1.0}
motion: {feed: 0.2, acceleration: 8.0, jerk: 800.0, in_position: 5.0e-8, settling: 0.002, dwell: 0.25}
sampling: {interferometer: 200.0, psd: 200.0, block: 0.05}
"""


class Apart(Bringup):
    """A cell of which some nodes run where the clock is off."""

    def __init__(self, *given, elsewhere: dict[str, str], shifted: tuple[str, ...], **more):
        super().__init__(*given, **more)
        self._elsewhere, self._shifted = elsewhere, shifted

    def _command(self, machine, node):
        command = super()._command(machine, node)
        there = ['env', *(f'{k}={v}' for k, v in self._elsewhere.items())] if node in self._shifted else []
        return [*there, *command]


def calibrate(folder: Path, shim: Path, offset_s: float, shifted: tuple[str, ...]) -> Path:
    """The bag of a calibration with the clocks of the ``shifted`` drivers off."""
    folder.mkdir()
    name = folder / 'name'
    name.write_text('another-computer\n', encoding='ascii')
    file, clock = folder / 'apart.yaml', folder / 'time'
    file.write_text(CELL, encoding='utf-8')
    clock.write_bytes(struct.pack('q', round(offset_s * 1e9)))
    with Apart(file, bag=folder / 'log', runtime=folder / 'run', shifted=shifted,
               elsewhere={'LD_PRELOAD': str(shim), 'CLOCK_SHIM_FILE': str(clock),
                          'CLOCK_SHIM_NAME': str(name)}) as cell:
        outcome = cell.operator.calibrate(meanwhile=cell.watch)
    assert outcome.succeeded, outcome.message
    return folder / 'log'


def named(log: CalibrationLog) -> set[str]:
    """What the diagnosis names."""
    return {found.name for found in diagnose(log, [kind() for kind in all_effects().values()]).effects}


@pytest.fixture(scope='module')
def together(module_domain, tmp_path_factory, clock_shim):
    """What an undisturbed calibration says."""
    bag = calibrate(tmp_path_factory.mktemp('together') / 'cell', clock_shim, 0.0, ())
    return evaluate(read_log(bag))


@pytest.mark.parametrize(('shifted', 'offset_s'), some(
    (('interferometer_driver',), 0.040),
    later=[(('psd_driver',), 1800.0), (('interferometer_driver', 'psd_driver'), -0.040)]))
def test_a_clock_that_is_off_is_a_fact_of_the_log(ros_domain, tmp_path, clock_shim, together, shifted, offset_s):
    bag = calibrate(tmp_path / 'cell', clock_shim, offset_s, shifted)
    log = read_log(bag)
    said = [w for w in log.warnings if 'its clock was' in w]
    assert len(said) == len(shifted), log.warnings
    for line in said:
        assert line.split(':')[0] + '_driver' in shifted
        assert abs(float(line.split(' was ')[1].split(' ms')[0]) - 1e3 * offset_s) < 5.0
        assert float(line.split('± ')[1].split(' ms')[0]) < 5.0
    # The sensors' samples cover the dwells that the sequencer announced.
    for samples in (log.displacement, log.spot):
        first = samples.time_ns[np.searchsorted(samples.time_ns, log.steps.time_ns[log.steps.phase == DWELL])]
        assert (first - log.steps.time_ns[log.steps.phase == DWELL] < 0.2e9).all()
    assert 'clock_skew' not in named(log)
    if shifted == ('interferometer_driver', 'psd_driver'):
        # Who does not know of the comparison finds, in the very same messages, a clock that is off.
        source = open_bag(bag)
        assert 'clock_skew' in named(build_log(source, collect(source, lambda topic: not topic.endswith(CLOCK_OFFSET))))
    solution = evaluate(log)
    assert abs(solution.dof - together.dof) <= 2 and solution.reduced_chi2 < 2.0
    for name in ('EXX', 'EYX', 'EZX'):
        a, b = (s.to_json_dict()['errors'][name] for s in (solution, together))
        assert (np.abs(np.subtract(a['value'], b['value'])) < 3.0 * np.hypot(a['sigma'], b['sigma']) + 1e-9).all()
    assert evaluate(assemble(bag).build()).reduced_chi2 == solution.reduced_chi2

