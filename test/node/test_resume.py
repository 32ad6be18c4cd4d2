"""A calibration survives its nodes: whoever dies is started again, and the run that was broken off is repeated."""

import os
import signal
import threading

import numpy as np
import pytest

from stepdiag_ros.bag.reader import read_log
from stepdiag_ros.bag.source import open_bag
from stepdiag_ros.estimate import evaluate
from stepdiag_ros.model.log import DONE
from test.some import some

RUNS = ('ppp/0/+', 'ppp/0/-', 'lin_x/0/+', 'lin_x/0/-')
STOPS = {'ppp': {0, 1, 2, 3}, 'lin_x': {0, 1}}
#: Whose death stops nothing.
LOOKS_ON = ('evaluation_solver', 'gap_monitor')


def first_names(run_ids) -> tuple[str, ...]:
    return tuple('/'.join(run_id.split('/')[:3]) for run_id in run_ids)


@pytest.fixture(scope='module')
def undisturbed(cell, measured):
    """What a calibration says in which nobody dies, and the description in its log."""
    bag = measured(cell.operator, cell.runtime.parent / 'undisturbed')[3]
    return evaluate(read_log(bag)), read_log(bag).description


def agree(one, other) -> None:
    """Every error that the tiny plan shows is the same within U (k = 2) of both."""
    for name in ('EXX', 'EAX', 'EBX', 'ECX'):
        a, b = one.to_json_dict()['errors'][name], other.to_json_dict()['errors'][name]
        away, uncertainty = np.abs(np.subtract(a['value'], b['value'])), 2.0 * np.add(a['sigma'], b['sigma'])
        assert max(a['sigma']) < 2e-5 and (away <= uncertainty).all(), (name, away, uncertainty)


@pytest.mark.timeout(1800)
@pytest.mark.parametrize('node', some(
    'psd_driver', 'step_sequencer', later=['recorder', 'gap_monitor', 'interferometer_driver', 'evaluation_solver']))
def test_a_calibration_goes_on_where_a_node_s_death_broke_it_off(cell, undisturbed, node, repeated, eventually):
    killed, bag, before = [], cell.runtime.parent / node, cell.restarts
    cell.operator.new_log(str(bag))
    # Where nothing is to stop, a computer that is busy with other work shall not be why something does.
    cell.operator.set_parameters('step_sequencer', {'source_timeout': 30.0 if node in LOOKS_ON else 3.0})

    def kill(feedback) -> None:
        if feedback.run_id == 'ppp/0/-' and feedback.stop >= 6 and not killed:
            killed.append(feedback.run_id)
            os.kill(cell.pids()[node], signal.SIGKILL)
    # The gap monitor comes back when the calibration is over: nobody waits for it.
    late = node == 'gap_monitor'
    outcome = cell.operator.calibrate(dwell_s=0.5, feedback=kill, meanwhile=(lambda: None) if late else cell.watch)
    if late:
        assert eventually(cell.watch) == [node]
    assert killed and cell.restarts == before + 1
    assert outcome.succeeded, outcome.message
    assert ('was started again' in outcome.message) == (node == 'step_sequencer'), outcome.message
    again = repeated(outcome.run_ids, RUNS)
    live = cell.operator.evaluate()
    if node == 'gap_monitor':     # it has read what it missed from the bag
        def health() -> dict[str, str]:
            return {v.key: v.value for v in cell.operator.health(node).values}
        # It diagnoses when nobody else wants the processor: that takes as long as the others leave it.
        eventually(lambda: health().get('verdict', 'none yet') != 'none yet', 1500.0,
                   lambda: cell.operator.health(node))
    assert cell.operator.recorder.bag == str(bag)
    cell.operator.bring('recorder', 'inactive')
    log = read_log(bag)
    solution, description = undisturbed
    assert log.description == description
    done = {run: set(log.steps.index[(log.steps.run == k) & (log.steps.phase == DONE)])
            for k, run in enumerate(log.steps.run_ids)}
    assert all(done[run] == STOPS[run.split('/')[0]] for run in outcome.run_ids)
    if node in LOOKS_ON:
        assert not again and not any('broken off' in w for w in log.warnings)     # nothing stopped for it
    else:
        assert again and all(any(w.startswith(f'run {run.rpartition("/")[0]} was broken off and repeated as {run};')
                                 for w in log.warnings) for run in again), log.warnings
    if node == 'recorder':
        assert len(open_bag(bag).files) == 2
        assert any('lost before the recorder' in w for w in log.warnings)
    assert (bag / f'{node}_0.mcap').exists()
    evaluated = evaluate(log)
    agree(evaluated, solution)
    if node != 'recorder':     # the solver has received what the recorder has not
        assert live['dof'] == evaluated.to_json_dict()['dof']


def test_a_sequencer_that_stood_still_is_called_silent_and_keeps_goal_and_client(cell):
    """Stopped for longer than lease (5 s) and the client's patience (8 s), and alive."""
    stopped, said, before = [], set(), cell.restarts
    cell.operator.new_log()

    def stop(feedback) -> None:
        said.add(feedback.doing)
        if feedback.run_id == 'ppp/0/-' and feedback.stop >= 6 and not stopped:
            stopped.append(cell.pids()['step_sequencer'])
            os.kill(stopped[0], signal.SIGSTOP)
            threading.Timer(12.0, os.kill, (stopped[0], signal.SIGCONT)).start()
    outcome = cell.operator.calibrate(dwell_s=0.5, feedback=stop, meanwhile=cell.watch)
    assert stopped and cell.restarts == before
    assert outcome.succeeded and first_names(outcome.run_ids) == RUNS, outcome.message
    assert 'the sequencer was silent for 1' in outcome.message and 'started again' not in outcome.message
    assert any(text.startswith('the sequencer has been silent for') for text in said)
