"""A tiny cell for the tests of the graph, and one that runs for a whole module."""

import time
from collections.abc import Callable
from pathlib import Path

import pytest

from stepdiag_ros.nodes import environment
from stepdiag_ros.nodes.patience import Patience

environment.prepare()

CELL = """
schema: 1
seed: 7
machine: {{name: {name}, chain: FXYZ, volume: [0.10, 0.08, 0.06], tool: [0.0, 0.0, -0.10]}}
plan: {{steps: 1, order: XYZ, repeats: 1}}
setups:
  ppp: {{standoff: 0.20, psd_offset: [0.02, 0.0], beams: [[0.0, 0.0]]}}
  lin_x: {{standoff: 0.20, psd_offset: [0.02, 0.0], beams: [[0.0, 0.0]], length: 0.10, stops: 2}}
geometry:
  drawn: {{positioning: 8.0e-6, straightness: 4.0e-6, angle: 2.0e-5, squareness: 1.5e-5}}
misalignments:
  drawn: {{laser: 3.0e-4, mirror: 2.0e-4, psd_zero: 0.0}}
air: {{period: 1.0, scale_temperature: [20.1, 20.2, 20.3]}}
motion: {{feed: 0.5, acceleration: 8.0, jerk: 800.0, in_position: 5.0e-8, settling: 0.002, dwell: {dwell}}}
sampling: {{interferometer: 200.0, psd: 200.0, block: 0.05}}
"""


def write_cell(folder: Path, name: str = 'tiny', dwell: float = 0.12) -> Path:
    path = folder / f'{name}.yaml'
    path.write_text(CELL.format(name=name, dwell=dwell), encoding='utf-8')
    return path


@pytest.fixture(name='write_cell', scope='session')
def _write_cell() -> Callable[..., Path]:
    return write_cell


@pytest.fixture
def cell_file(tmp_path: Path) -> Path:
    return write_cell(tmp_path)


@pytest.fixture(scope='module')
def cell(module_domain, tmp_path_factory):
    """A tiny cell, up and active."""
    from stepdiag_ros.nodes.bringup import Bringup
    folder = tmp_path_factory.mktemp('cell')
    with Bringup(write_cell(folder), bag_folder=folder, runtime=folder / 'run') as running:
        yield running


def eventually(condition: Callable[[], object], timeout_s: float = 60.0,
               why: Callable[[], object] = lambda: '') -> object:
    """Wait until ``condition()`` is true; its value.  ``why()`` goes into the complaint."""
    patience = Patience(timeout_s)
    while not (value := condition()):
        assert not patience.over(), f'did not come true within {timeout_s:g} s: {why()}'
        time.sleep(0.05)
    return value


@pytest.fixture(name='eventually')
def _eventually():
    return eventually


def restart_sequencer(cell, *options: str) -> None:
    """Start the sequencer again with other parameters: those that move a machine are read-only."""
    child = cell._children['step_sequencer']
    child.command = [*child.command[:child.command.index('--params-file') + 2], *options]
    child.process.kill()
    child.process.wait()
    assert cell.watch() == ['step_sequencer']


@pytest.fixture(name='restart_sequencer')
def _restart_sequencer():
    return restart_sequencer


def measured(operator, bag: Path) -> tuple:
    """The plan's calibration into ``bag``, which is closed: outcome, feedback, live document, bag."""
    feedback: list = []
    operator.new_log(str(bag))
    outcome = operator.calibrate(feedback=feedback.append)
    assert outcome.succeeded, outcome.message
    document = operator.evaluate()
    operator.bring('recorder', 'inactive')
    return outcome, feedback, document, bag


def repeated(run_ids, planned) -> list[str]:
    """Names of the runs of a calibration that bear another than the ``planned`` one: they were broken off before.

    Which run a node's death breaks off is the computer's affair: what a test is told of a calibration and what it then
    does come late on a busy one.
    """
    assert ['/'.join(run_id.split('/')[:3]) for run_id in run_ids] == list(planned)
    return [run_id for run_id, plan in zip(run_ids, planned, strict=True) if run_id != plan]


@pytest.fixture(name='repeated', scope='session')
def _repeated():
    return repeated


@pytest.fixture(name='measured', scope='session')
def _measured():
    return measured
