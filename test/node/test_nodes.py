"""Every node of a running cell: lifecycle, parameters, diagnostics."""

import gc
import re
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rcl_interfaces.msg import ParameterType
from rcl_interfaces.srv import DescribeParameters, ListParameters

from stepdiag_msgs.msg import RecorderStatus, Step
from stepdiag_msgs.srv import NameLog
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.nodes import base, bringup
from stepdiag_ros.nodes.base import StepdiagNode, reliable
from stepdiag_ros.virtual import faults
from test.participants import participants

NODES = ('recorder', 'evaluation_solver', 'gap_monitor', 'interferometer_driver', 'psd_driver', 'step_sequencer')


def call(cell, kind, name, request):
    """The answer of a service; asked again, for a server that has not found its client yet answers nobody."""
    return cell.operator._call_until_answered(kind, name, request, 30.0)


@pytest.mark.parametrize('node', NODES)
def test_a_node_says_once_a_second_how_it_is(cell, node, eventually):
    status = eventually(lambda: cell.operator.health(node))
    assert status.name == f'tiny/{node}'
    values = eventually(lambda: {v.key: v.value for v in cell.operator.health(node).values})
    eventually(lambda: {v.key: v.value for v in cell.operator.health(node).values}['state'] == 'active')
    assert 'state' in values and status.message


@pytest.mark.parametrize('node', NODES)
def test_every_parameter_is_described_and_numbers_have_a_range(cell, node):
    names = call(cell, ListParameters, f'{node}/list_parameters', ListParameters.Request()).result.names
    own = [n for n in names if not n.startswith('qos_overrides.') and n not in
           ('use_sim_time', 'start_type_description_service')]
    assert 'autostart' in own
    page = (Path(__file__).resolve().parents[2] / 'docs' / 'reference' / 'nodes.md').read_text()
    section = page.split(f'## `{node}`')[1].split('## `')[0]
    assert sorted(own) == sorted(re.findall(r'^\| `(\w+)` \|', section, re.MULTILINE))
    described = call(cell, DescribeParameters, f'{node}/describe_parameters',
                     DescribeParameters.Request(names=own)).descriptors
    for descriptor in described:
        assert descriptor.description, descriptor.name
        if descriptor.type == ParameterType.PARAMETER_DOUBLE:
            assert descriptor.floating_point_range and '[' in descriptor.description, descriptor.name
        if descriptor.type == ParameterType.PARAMETER_INTEGER:
            assert descriptor.integer_range, descriptor.name


BUSY = """
import sys, threading
import numpy as np
from scipy.spatial import cKDTree
from stepdiag_ros.nodes.base import StepdiagNode, run_node

def compute():
    while True:  # in C++ without the interpreter's lock, as an evaluation is
        cKDTree(np.random.rand(20000, 3)).query(np.random.rand(200000, 3))

class Busy(StepdiagNode):
    def __init__(self):
        super().__init__('busy')
        threading.Thread(target=compute, daemon=True).start()
        print('computing', flush=True)

sys.exit(run_node(Busy))
"""


def told_to_end(script, up):
    """Exit status of a node's process that is told to end once it has said ``up``, and what it says then."""
    with subprocess.Popen([sys.executable, '-c', script], stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
                          text=True) as node:
        assert node.stdout.readline() == f'{up}\n'
        node.terminate()
        said = node.communicate(timeout=60.0)[0]
    return node.returncode, said


def test_a_node_that_still_computes_ends_in_order(module_domain):
    assert told_to_end(BUSY, 'computing') == (0, '')


STUCK = """
import sys, threading
from stepdiag_ros.nodes import base

class Stuck(base.StepdiagNode):
    def __init__(self):
        super().__init__('stuck')
        print('up', flush=True)

    def close(self):
        threading.Event().wait()

base.ENDS_S = 1.0
sys.exit(base.run_node(Stuck))
"""


def test_a_node_that_is_stuck_on_its_way_out_ends_and_says_where(module_domain):
    """Before its bringup kills it, which would say nothing."""
    status, said = told_to_end(STUCK, 'up')
    assert status == 1 and 'in close' in said
    assert bringup.GRACE_S > base.ENDS_S


def by_hand(node, *arguments):
    return subprocess.Popen([sys.executable, '-m', f'stepdiag_ros.nodes.{node}', '--ros-args', *arguments],
                            stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)


@pytest.mark.parametrize(('node', 'name'), [('interferometer_driver', 'host'), ('psd_driver', 'host'),
                                            ('multiplexer', 'host'), ('step_sequencer', 'description_file')])
def test_a_node_that_was_given_no_parameters_says_which_it_needs(module_domain, node, name):
    with by_hand(node, '-p', 'autostart:=true') as process:
        said = next(line for line in process.stderr if 'ERROR' in line)
        process.terminate()
        process.communicate(timeout=60.0)
    assert f'{node}: parameter {name} is not given' in said and '--params-file' in said


def test_a_file_of_parameters_that_is_not_there_is_one_line(module_domain, tmp_path):
    with by_hand('psd_driver', '--params-file', str(tmp_path / 'none.yaml')) as process:
        said = process.communicate(timeout=60.0)[1]
    ours = [line for line in said.splitlines() if '[rcl]' not in line]     # which says that it failed, not at what
    assert process.returncode == 2 and len(ours) == 1 and 'none.yaml' in ours[0]


def test_a_new_log_waits_for_no_diagnosis_of_the_last_one(ros_domain, monkeypatch):
    """Nor does what is found in the end pass for the new log's."""
    import rclpy

    from stepdiag_ros.nodes import gap_monitor
    rclpy.init()
    node = gap_monitor.GapMonitor()
    diagnosing, looked, found, said = threading.Event(), threading.Event(), threading.Event(), []

    def diagnose(_log, _effects):
        diagnosing.set()
        found.wait(60.0)

    def steps_received() -> int:
        looked.set()
        return 1
    monkeypatch.setattr(gap_monitor, 'diagnose', diagnose)
    monkeypatch.setattr(gap_monitor, 'must_be_sane', lambda _log: None)
    monkeypatch.setattr(node, 'whole_log', lambda: None)
    monkeypatch.setattr(node, 'steps_received', steps_received)
    try:
        node.configure()
        node.activate()
        node.state = 'active'
        work = threading.Thread(target=lambda: said.append(node._diagnose()))
        work.start()
        assert diagnosing.wait(60.0) and looked.wait(60.0)      # the watcher waits for its turn, too
        ending = threading.Thread(target=node.deactivate, daemon=True)
        ending.start()
        ending.join(30.0)
        assert not ending.is_alive()
        found.set()
        work.join(60.0)
        assert [(answer.success, answer.message) for answer in said] == [
            (False, 'another log was begun meanwhile; stepdiag gap diagnoses the bag of this one')]
    finally:
        found.set()
        node.cleanup()
        node.destroy_node()
        rclpy.try_shutdown()


def test_a_log_that_is_not_sane_is_not_diagnosed(ros_domain, monkeypatch, cell_file, eventually):
    """Whatever effect would be found in it is the mistake's; it is named as soon as readings show it."""
    import rclpy

    from stepdiag_ros.nodes.gap_monitor import GapMonitor
    from stepdiag_ros.virtual.cell import load_cell
    from stepdiag_ros.virtual.offline import simulate_log
    healthy = simulate_log(load_cell(cell_file))
    insane = replace(healthy, displacement=replace(healthy.displacement, values=-healthy.displacement.values))
    rclpy.init()
    node = GapMonitor()
    monkeypatch.setattr(node, 'whole_log', lambda: insane)
    monkeypatch.setattr(node, 'log_so_far', lambda: insane)
    monkeypatch.setattr(node, 'steps_received', lambda: 1)
    try:
        node.configure()
        node.activate()
        node.state = 'active'
        eventually(lambda: 'not sane' in node.health().message, why=node.health)
        answer = node._diagnose()
        assert not answer.success and 'turn the sign of the displacement' in answer.message
        assert not answer.report.verdict
    finally:
        node.cleanup()
        node.destroy_node()
        rclpy.try_shutdown()


def test_quality_of_service_can_be_overridden(cell):
    names = call(cell, ListParameters, 'interferometer_driver/list_parameters',
                 ListParameters.Request()).result.names
    assert 'qos_overrides./tiny/interferometer/displacement.publisher.depth' in names
    assert 'qos_overrides./tiny/interferometer/displacement.publisher.reliability' in names


def test_a_value_out_of_range_is_refused(cell):
    with pytest.raises(StepdiagError, match='parameter sample_rate cannot be -1.0'):
        cell.operator.set_parameters('interferometer_driver', {'sample_rate': -1.0})


@pytest.mark.parametrize('node', NODES)
def test_a_node_goes_down_and_up_again(cell, node, eventually):
    operator = cell.operator
    for state in ('inactive', 'unconfigured', 'inactive', 'active'):
        operator.bring(node, state)
        assert operator.state(node) == state
    eventually(lambda: cell.operator.health(node).level != DiagnosticStatus.ERROR,
               why=lambda: cell.operator.health(node).message)


#: What names files, hosts, feeds or places, or keeps the machine still for want of a client or of a hand; a parameter
#: service that everybody may call does not change it.
FIXED = {
    'interferometer_driver': {'host': '10.0.0.1', 'port': 1, 'serves': ['a=1'], 'beams': 3},
    'psd_driver': {'host': '10.0.0.1', 'port': 1, 'stream_port': 1, 'mode': 'poll', 'length': 0.1, 'rotation': 1.0,
                   'gain': [2.0, 2.0], 'zero': [1.0, 1.0]},
    'step_sequencer': {'host': '10.0.0.1', 'port': 1, 'description_file': '/etc/passwd', 'feed': 5.0,
                       'origin': [1.0, 1.0, 1.0], 'setup_codes': ['ppp=M102'], 'listeners': [''], 'sources': [''],
                       'light': '/other/use_source', 'lease': 3600.0, 'lost_client': 'at_once', 'ask_operator': True},
    'recorder': {'bag': '/tmp/elsewhere', 'bag_folder': '/tmp', 'go_on': True},
}


@pytest.mark.parametrize(('node', 'name'), [(node, name) for node, names in FIXED.items() for name in names])
def test_what_names_files_hosts_feeds_or_places_cannot_be_changed(cell, node, name):
    with pytest.raises(StepdiagError, match='read-only'):
        cell.operator.set_parameters(node, {name: FIXED[node][name]})
    page = (Path(__file__).resolve().parents[2] / 'docs' / 'reference' / 'nodes.md').read_text()
    section = page.split(f'## `{node}`')[1].split('## `')[0]
    assert re.search(rf'^\| `{name}` \|[^|]*\| read-only: ', section, re.MULTILINE)


def test_no_parameter_names_a_file_that_would_be_run(cell):
    names = call(cell, ListParameters, 'gap_monitor/list_parameters', ListParameters.Request()).result.names
    assert 'effects' not in names
    with pytest.raises(StepdiagError, match='effects'):
        cell.operator.set_parameters('gap_monitor', {'effects': ['/tmp/evil.py']})


def test_a_bag_elsewhere_than_in_the_recorder_s_folder_is_refused(cell, tmp_path):
    with pytest.raises(StepdiagError, match='makes bags in .* alone'):
        cell.operator.new_log(str(tmp_path / 'elsewhere'))
    for name in ('../outside', '..', 'a\nb'):
        named = call(cell, NameLog, 'recorder/name_log', NameLog.Request(name=name))
        assert not named.success and 'a name without a folder' in named.message


def test_drivers_deliver_at_their_rate(cell, eventually):
    for node in ('interferometer_driver', 'psd_driver'):
        def rate(node=node):
            values = {v.key: v.value for v in cell.operator.health(node).values}
            return float(values.get('rate_Hz', 0.0))
        assert eventually(lambda rate=rate: rate() > 100.0)


@pytest.mark.parametrize('name', ['configure', 'activate', 'cleanup'])
def test_a_transition_that_does_not_leave_the_state_is_refused_and_ends_no_node(cell, name):
    """It may be asked for twice, by an operator and a node that starts by itself, or by anybody who tries."""
    for node in NODES:
        assert not cell.operator.transition(node, name)
        assert cell.operator.state(node) == 'active'


def test_messages_that_nobody_understands_end_no_node_and_blind_none(cell, eventually):
    """Anybody on the computer may publish: arrays of unlike length, bytes that are no message."""
    before, own = cell.pids(), cell.operator.node
    steps = own.create_publisher(Step, 'sequencer/step', reliable())
    recorders = own.create_publisher(RecorderStatus, 'recorder/status', reliable(10))
    said = own.create_publisher(DiagnosticArray, '/diagnostics', 50)
    assert eventually(lambda: min(p.get_subscription_count() for p in (steps, recorders, said)) >= 2)
    for raw in (b'\x00\x01\x00\x00', b'\x00\x01\x00\x00' + b'\xff' * 64, b'\x07' * 9):
        for one in (steps, recorders, said):
            one.publish(raw)
    for _ in range(3):
        recorders.publish(RecorderStatus(topics=['/tiny/sequencer/step'], received=[]))
    assert eventually(lambda: 'not understood' in cell.operator.health('step_sequencer').message)
    assert eventually(lambda: 'not understood' not in cell.operator.health('step_sequencer').message)    # it passes
    assert cell.pids() == before and all(cell.operator.state(node) == 'active' for node in NODES)
    for node in ('evaluation_solver', 'gap_monitor'):
        assert 'receives nothing more' not in cell.operator.health(node).message


def test_what_is_not_understood_is_said_by_the_logger_that_says_all_else(cell):
    """A throttled line of rclpy refuses every other call of the same line: a node that had logged an error ended."""
    node = StepdiagNode('says', context=cell.operator.node.context)
    try:
        for _ in range(2):
            node.get_logger().error('an error of the usual kind')
            node.callback_failed(ValueError('no message'))
        assert 'no message' in node._not_understood
    finally:
        node.destroy_node()


def test_goals_that_no_log_can_hold_are_refused_at_once(cell):
    """65,535 repeats were spelled out for minutes, and a dwell without an end was begun."""
    for asked, why in (({'repeats': 65535}, 'repeats of'), ({'dwell': float('inf')}, 'a dwell of inf s'),
                       ({'dwell': 1e300}, 'at most 600 s')):
        refused = cell.operator.calibrate(['ppp'], asked.get('repeats', 0), asked.get('dwell', 0.0))
        assert refused.how == 'aborted' and why in refused.message


def test_a_driver_ends_its_block_whatever_its_length_is_set_to(cell):
    """A block of 100,000 samples at 1 Hz lasted a day, and deactivating waited for it."""
    operator = cell.operator
    before = {name: operator.parameters('psd_driver', [name])[0] for name in ('sample_rate', 'block_samples')}
    operator.set_parameters('psd_driver', {'sample_rate': 1.0, 'block_samples': 100_000})
    time.sleep(1.0)
    operator.set_parameters('psd_driver', before)
    assert operator.transition('psd_driver', 'deactivate') and operator.state('psd_driver') == 'inactive'
    operator.bring('psd_driver', 'active')


def test_configuring_without_an_instrument_says_so_in_one_line(cell, eventually):
    operator = cell.operator
    operator.bring('psd_driver', 'unconfigured')
    faults.inject(cell.runtime, 'psd', 'drop')
    time.sleep(0.1)   # longer than the server's interval of looking
    try:
        assert not operator.transition('psd_driver', 'configure')
        assert operator.state('psd_driver') == 'unconfigured'
        said = eventually(lambda: operator.health('psd_driver').level == DiagnosticStatus.ERROR
                          and operator.health('psd_driver').message)
        assert 'PSD at 127.0.0.1:' in said and 'reconnect' in said and '\n' not in said
    finally:
        faults.clear(cell.runtime, 'psd')
        time.sleep(0.1)
        operator.bring('psd_driver', 'active')


def test_the_recorder_confirms_what_it_hears(cell, eventually):
    wanted = {f'/tiny/{t}' for t in (
        'interferometer/displacement', 'psd/spot', 'cell_description', 'environment/air_temperature',
        'environment/air_pressure', 'environment/humidity')}
    assert eventually(lambda: cell.operator.recorder and wanted <= set(cell.operator.recorder.hears),
                      why=lambda: cell.operator.recorder)
    assert sum(cell.operator.recorder.lost) == 0


def test_unknown_parameters_of_the_psd_are_refused_in_one_line(cell, eventually):
    operator = cell.operator
    operator.bring('psd_driver', 'unconfigured')
    operator.set_parameters('psd_driver', {'channels': [0, 1, 2, 2]})
    with pytest.raises(StepdiagError, match='name four different analogue inputs'):
        operator.bring('psd_driver', 'inactive')
    operator.set_parameters('psd_driver', {'channels': [0, 1, 2, 3]})
    operator.bring('psd_driver', 'active')


def test_who_is_closed_is_gone(ros_domain):
    """What DDS keeps of a node that was not taken apart discovers all that come later, in threads of its own."""
    from stepdiag_ros.nodes.observer import Observer
    from stepdiag_ros.nodes.operator import Operator
    from stepdiag_ros.nodes.player import Player
    gc.collect()   # nodes of tests before, which hold themselves
    before = participants()
    for make in (lambda: Operator('/tiny'), Observer, lambda: Player('/tiny')):
        with make():
            assert participants() == before + 1
        assert participants() == before


def test_a_node_that_takes_long_for_each_answer_is_heard(cell):
    """Longer than the time after which it is asked again, as on a busy computer."""
    import rclpy
    from lifecycle_msgs.srv import GetState
    from rclpy.experimental.events_executor import EventsExecutor

    from stepdiag_ros.nodes.base import spin
    from stepdiag_ros.nodes.operator import ASK_AGAIN_S

    def slowly(_request, response):
        time.sleep(ASK_AGAIN_S + 0.5)
        response.current_state.label = 'active'
        return response
    context, stop = rclpy.Context(), threading.Event()
    rclpy.init(context=context)
    node, executor = rclpy.create_node('slow', namespace='/tiny', context=context), EventsExecutor(context=context)
    node.create_service(GetState, 'slow/get_state', slowly)
    executor.add_node(node)
    answering = threading.Thread(target=spin, args=(executor, stop.is_set), daemon=True)
    answering.start()
    try:
        assert cell.operator.state('slow', 60.0) == 'active'
    finally:
        stop.set()
        answering.join(60.0)
        base.end(node, context, executor)


def test_a_raw_subscription_hands_on_nothing_before_its_start(ros_domain, eventually):
    import rclpy
    from std_msgs.msg import String

    from stepdiag_ros.nodes.base import reliable
    from stepdiag_ros.nodes.subscription import RawSubscription
    context = rclpy.Context()
    rclpy.init(context=context)
    node = rclpy.create_node('speaker', namespace='/raw', context=context)
    publisher = node.create_publisher(String, 'cell_description', reliable(5))
    received = []
    raw = RawSubscription(node, {'cell_description': 'std_msgs/msg/String'}, received.append)
    try:
        eventually(publisher.get_subscription_count)
        for text in ('one', 'two', 'three'):
            publisher.publish(String(data=text))
        assert received == []
        raw.start()
        eventually(lambda: len(received) == 3)
        assert [message.sequence for message in received] == [1, 2, 3]
        assert all(message.cdr[8:11] in (b'one', b'two', b'thr') for message in received)
        assert all(0 < m.published_ns <= m.received_ns for m in received)
        assert raw.lost == {'cell_description': 0} and raw.received == {'cell_description': 3}
    finally:
        raw.close()
        base.end(node, context)
