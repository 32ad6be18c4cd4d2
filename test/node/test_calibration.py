"""A whole live run on a tiny cell: refused, cancelled, done; live, replayed and read, the same bits."""

import json
import threading
import time

import numpy as np
import pytest

from stepdiag_msgs.srv import Diagnose, Evaluate
from stepdiag_ros.bag.reader import read_log
from stepdiag_ros.cli.demo import same_result
from stepdiag_ros.effects import all_effects
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.estimate import evaluate
from stepdiag_ros.gap.diagnose import diagnose
from stepdiag_ros.model.log import DONE, DWELL, MOVE
from stepdiag_ros.nodes.replaying import assemble


@pytest.fixture(scope='module')
def live(cell, measured):
    """One calibration of the tiny cell: outcome, feedback, live document, bag."""
    return measured(cell.operator, cell.runtime.parent / 'whole')


def test_all_runs_are_done_forward_and_backward(live):
    outcome, *_ = live
    assert outcome.run_ids == ('ppp/0/+', 'ppp/0/-', 'lin_x/0/+', 'lin_x/0/-')
    assert outcome.stops == 12 and outcome.message.startswith('12 stops in 4 runs')


def test_feedback_says_where_it_is(live):
    _, feedback, *_ = live
    assert [f.stop for f in feedback] == sorted(f.stop for f in feedback)
    assert all(f.stops == 12 for f in feedback)
    moving = [f for f in feedback if f.axis != 255]
    assert {f.axis for f in moving} == {0, 1, 2}
    assert any(f.doing == 'Z to stop 3 of 3' for f in moving)
    assert moving[-1].time_left < moving[len(moving) // 2].time_left


def test_the_bag_holds_the_contracts_events(live):
    log = read_log(live[3])
    steps = log.steps
    assert log.namespace == '/tiny' and len(steps) == 3 * 12
    np.testing.assert_array_equal(steps.phase, np.tile([MOVE, DWELL, DONE], 12))
    assert (np.diff(steps.time_ns) >= 0).all()
    ppp = steps.run == steps.run_ids.index('ppp/0/-')
    assert list(steps.index[ppp][::3]) == [3, 2, 1, 0]
    assert list(steps.axis[ppp][::3]) == [255, 2, 1, 0]
    assert not [w for w in log.warnings if 'lost' in w or 'missing' in w or 'runs backwards' in w]
    assert {'air_temperature', 'air_pressure', 'humidity'} <= log.environment.keys()


def test_runs_begin_at_zero(live):
    log = read_log(live[3])
    first = np.flatnonzero((log.steps.axis == 255) & (log.steps.phase == DWELL))
    for event in first:
        inside = (log.displacement.time_ns >= log.steps.time_ns[event]) \
            & (log.displacement.time_ns < log.steps.time_ns[event + 1]) & (log.displacement.health > 0)
        assert inside.any()
        assert abs(log.displacement.values[inside, 0].mean()) < 2e-7


def test_live_replayed_and_read_have_the_same_bits(live):
    _, _, document, bag = live
    offline = evaluate(read_log(bag)).to_json_dict()
    again = evaluate(read_log(bag)).to_json_dict()
    replayed = evaluate(assemble(bag).build()).to_json_dict()
    assert same_result(offline, again)
    assert same_result(json.loads(json.dumps(document)), json.loads(json.dumps(offline)))
    assert same_result(replayed, offline)
    assert document['dof'] > 0 and np.isfinite(document['reduced_chi2'])


def calibrate_without(operator, node, ready_s, after='active'):
    """How a goal ends while a node is inactive, which is brought to ``after`` again."""
    operator.bring(node, 'inactive')
    operator.set_parameters('step_sequencer', {'ready_timeout': ready_s})
    try:
        return operator.calibrate()
    finally:
        operator.bring(node, after)
        operator.set_parameters('step_sequencer', {'ready_timeout': 20.0})


def test_a_goal_is_refused_while_a_source_is_silent(cell, live):
    operator = cell.operator
    operator.new_log(str(cell.runtime.parent / 'refused'))
    outcome = calibrate_without(operator, 'psd_driver', 4.0)
    assert outcome.how == 'aborted' and outcome.stops == 0
    assert outcome.message.startswith('refused to start: ') and '/tiny/psd/spot' in outcome.message
    operator.bring('recorder', 'inactive')
    with pytest.raises(StepdiagError, match='step'):
        read_log(cell.runtime.parent / 'refused')   # nothing has moved


def test_a_goal_is_refused_while_nothing_is_recorded(cell, live):
    outcome = calibrate_without(cell.operator, 'recorder', 1.0, after='inactive')
    assert outcome.how == 'aborted' and 'the recorder is not recording' in outcome.message


def test_a_goal_is_refused_while_a_listener_has_not_said_that_it_hears(cell, live):
    operator = cell.operator
    operator.new_log(str(cell.runtime.parent / 'unheard'))
    outcome = calibrate_without(operator, 'gap_monitor', 4.0)
    assert outcome.how == 'aborted' and outcome.stops == 0
    assert 'gap_monitor does not receive /tiny/interferometer/displacement' in outcome.message


def test_an_unknown_setup_is_refused(cell, live):
    outcome = cell.operator.calibrate(setups=['nnp'])
    assert outcome.how == 'aborted' and "unknown setup 'nnp'" in outcome.message


def test_other_steps_than_the_description_are_refused(cell, live):
    outcome = cell.operator.calibrate(steps=7)
    assert outcome.how == 'aborted' and '7 steps were asked for' in outcome.message


def test_cancel_leaves_the_machine_still_and_the_bag_whole(cell, live):
    operator = cell.operator
    bag = cell.runtime.parent / 'cancelled'
    operator.new_log(str(bag))
    def stop_at_two(feedback) -> None:
        if feedback.stop >= 2:
            operator.cancel()
    outcome = operator.calibrate(feedback=stop_at_two)
    assert outcome.how == 'canceled' and 2 <= outcome.stops < 12
    assert 'the machine stands still' in outcome.message
    operator.bring('recorder', 'inactive')
    log = read_log(bag)
    assert (log.steps.phase == DONE).sum() == outcome.stops
    # Another goal can follow, into the same sequencer.
    operator.new_log(str(cell.runtime.parent / 'after'))
    assert operator.calibrate(setups=['lin_x']).succeeded


def test_a_second_goal_into_the_same_bag_counts_its_repeats_on(cell, live):
    operator = cell.operator
    bag = cell.runtime.parent / 'twice'
    operator.new_log(str(bag))
    assert operator.calibrate(setups=['lin_x']).run_ids == ('lin_x/0/+', 'lin_x/0/-')
    assert operator.calibrate(setups=['lin_x']).run_ids == ('lin_x/1/+', 'lin_x/1/-')
    operator.bring('recorder', 'inactive')
    assert set(read_log(bag).steps.repeat) == {0, 1}


def test_a_second_goal_at_the_same_time_is_rejected(cell, live):
    operator = cell.operator
    operator.new_log(str(cell.runtime.parent / 'busy'))
    refused, tried = [], threading.Event()

    def knock(feedback) -> None:
        if not tried.is_set():
            tried.set()
            threading.Thread(target=second).start()

    def second() -> None:
        from stepdiag_ros.nodes.operator import Operator
        with Operator('tiny') as other:
            try:
                refused.append(other.calibrate(setups=['lin_x']))
            except StepdiagError as error:
                refused.append(error)
    outcome = operator.calibrate(dwell_s=1.0, setups=['ppp'], feedback=knock)
    assert outcome.succeeded
    assert isinstance(refused[0], StepdiagError) and 'rejects the goal' in str(refused[0])


class Halting:
    """An action client's handle whose thread loses the processor after each request."""

    def __init__(self, handle):
        self._handle = handle

    def __getattr__(self, name):
        inner = getattr(self._handle, name)
        if name not in ('send_goal_request', 'send_result_request'):
            return inner

        def halted(*arguments):
            sequence_number = inner(*arguments)
            time.sleep(0.5)
            return sequence_number
        return halted


def test_no_answer_of_the_sequencer_is_lost(cell, live, monkeypatch):
    operator = cell.operator
    operator.new_log(str(cell.runtime.parent / 'halting'))
    monkeypatch.setattr(operator._action, '_client_handle', Halting(operator._action._client_handle))
    assert operator.calibrate(setups=['lin_x']).succeeded


def test_a_sequencer_that_is_silent_and_answers_keeps_its_goal(cell, live, monkeypatch):
    """On a busy computer diagnostics may stay away for as long as those of a dead node."""
    class Silent(dict):
        def __setitem__(self, name, health) -> None:
            if not name.endswith('step_sequencer'):
                super().__setitem__(name, health)
    operator = cell.operator
    operator.new_log(str(cell.runtime.parent / 'silent'))
    monkeypatch.setattr('stepdiag_ros.nodes.sent_goal.DOUBT_S', 0.2)
    monkeypatch.setattr('stepdiag_ros.nodes.sent_goal.ASK_S', 0.2)
    monkeypatch.setattr(operator, '_heard', Silent(operator._heard))
    outcome = operator.calibrate(setups=['ppp'])
    assert outcome.succeeded and 'was started again' not in outcome.message


def test_the_gap_monitor_publishes_its_report_when_all_is_measured(cell, live, eventually):
    from rclpy.qos import DurabilityPolicy, QoSProfile

    from stepdiag_msgs.msg import GapReport, GeometricErrors

    operator, received = cell.operator, {}
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    for kind, topic in ((GapReport, 'gap_report'), (GeometricErrors, 'geometric_errors')):
        operator.node.create_subscription(kind, topic, lambda m, t=topic: received.__setitem__(t, m), latched)
    operator.bring('gap_monitor', 'inactive')
    operator.bring('gap_monitor', 'active')
    operator.new_log(str(cell.runtime.parent / 'diagnosed'))
    received.clear()
    assert operator.calibrate().succeeded
    eventually(lambda: len(received) == 2, 120)
    operator.bring('recorder', 'inactive')
    log = read_log(cell.runtime.parent / 'diagnosed')
    diagnosis = diagnose(log, [kind() for kind in all_effects().values()]).to_json_dict()
    report = received['gap_report']
    assert (report.verdict, report.channel) == (diagnosis['verdict'], diagnosis['gap']['channel'])
    assert (report.before, report.after, report.noise_floor) == tuple(
        diagnosis['gap'][key] for key in ('before_m', 'after_m', 'noise_floor_m'))
    assert [(one.name, one.probability, one.closes, dict(zip(one.parameters, one.value, strict=True)))
            for one in report.effects] == [
        (one['name'], one['probability'], one['closes'], one['parameters']) for one in diagnosis['effects']]
    errors, document = received['geometric_errors'], operator.evaluate()
    assert errors.complete and errors.dof == document['dof'] > 0 and errors.reduced_chi2 == document['reduced_chi2']
    assert errors.squareness[0] == document['errors']['EC0Y']['value']
    assert {curve.name: (list(curve.position), list(curve.value), list(curve.sigma)) for curve in errors.curves} == {
        name: (one['position_m'], one['value'], one['sigma'])
        for name, one in document['errors'].items() if 'position_m' in one}
    for message in (report, errors):    # curves are numbers with names, not a text in a text
        assert 'json' not in message.get_fields_and_field_types()
    # The services answer with the same messages; the bag is closed, and what the solver holds has not changed.
    answer = operator._call(Evaluate, 'evaluate', Evaluate.Request(), 300.0)
    assert answer.success and str(answer.errors) == str(errors) and json.loads(answer.document) == document
    answer = operator._call(Diagnose, 'diagnose', Diagnose.Request(), 300.0)
    answer.report.header = report.header     # when it was diagnosed
    assert answer.success and str(answer.report) == str(report)
    assert json.loads(answer.document)['verdict'] == report.verdict


def test_a_setup_without_a_code_waits_for_a_person(cell, live, restart_sequencer):
    from stepdiag_ros.nodes.step_sequencer import ASK
    operator, asked = cell.operator, []
    operator.new_log(str(cell.runtime.parent / 'by_hand'))
    # lin_x has no code: the virtual mirror stays where it is.
    restart_sequencer(cell, '-p', 'ask_operator:=true', '-p', "setup_codes:=['ppp=M101']")
    with pytest.raises(StepdiagError, match='no setup is waited for'):
        operator.mounted()

    def confirm(feedback) -> None:
        if feedback.doing.startswith(ASK):
            asked.append(feedback.setup)
            threading.Thread(target=operator.mounted).start()
    try:
        outcome = operator.calibrate(setups=['ppp', 'lin_x'], feedback=confirm, meanwhile=lambda: (
            operator.cancel() if asked == ['lin_x'] else None))
    finally:
        restart_sequencer(cell)
    assert asked == ['lin_x'] and outcome.how == 'canceled' and outcome.stops >= 8
