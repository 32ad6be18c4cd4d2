"""Two machines behind one laser: each in its namespace, one at a time."""

import threading

import pytest

from stepdiag_ros.bag.reader import read_log
from stepdiag_ros.nodes.bringup import Bringup


@pytest.fixture
def pair(ros_domain, tmp_path, write_cell):
    """Cells `left` and `right`; left's file has the laser and its switch."""
    write_cell(tmp_path, 'right')
    left = write_cell(tmp_path, 'left', dwell=0.2)
    left.write_text(left.read_text(encoding='utf-8') + 'instruments:\n  interferometer: {multiplexer: '
                    '{machines: [right.yaml]}}\n', encoding='utf-8')
    with Bringup(left, bag=tmp_path / 'log', runtime=tmp_path / 'run') as cell:
        yield cell, tmp_path


def test_one_machine_waits_for_the_other(pair):
    cell, folder = pair
    left, right = cell.operator_of('/left'), cell.operator_of('/right')
    right.set_parameters('step_sequencer', {'ready_timeout': 1.0})
    refused, tried = [], threading.Event()

    def knock(feedback) -> None:
        if feedback.stop >= 1 and not tried.is_set():
            tried.set()
            threading.Thread(target=lambda: refused.append(right.calibrate(setups=['lin_x']))).start()
    outcome = left.calibrate(feedback=knock, dwell_s=1.0)
    assert outcome.succeeded and tried.is_set()
    assert refused[0].how == 'aborted'
    assert refused[0].message.startswith('refused to start: the laser serves left')
    right.set_parameters('step_sequencer', {'ready_timeout': 20.0})
    # Left has given the laser back: right has it at once.
    assert right.calibrate(setups=['lin_x']).succeeded
    for operator in (left, right):
        operator.bring('recorder', 'inactive')
    for name, steps in (('log', 36), ('log_right', 12)):
        log = read_log(folder / name)
        assert len(log.steps) == steps and len(log.displacement)
        assert not [w for w in log.warnings if 'hold no usable' in w or 'dwell' in w]
    assert read_log(folder / 'log_right').namespace == '/right'
