"""`stepdiag web`: it serves on loopback, only shows, tells strangers nothing, and says what does not run."""

import http.client
import json
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator

import pytest
from wsproto import ConnectionType, WSConnection
from wsproto.events import RejectConnection, Request, TextMessage

from stepdiag_ros.nodes import environment

environment.prepare()

import rclpy  # noqa: E402 - the environment has to be set before
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue  # noqa: E402
from std_msgs.msg import String  # noqa: E402

from stepdiag_msgs.msg import DisplacementMean, ErrorCurve, GeometricErrors, RecorderStatus, Step  # noqa: E402
from stepdiag_ros.nodes import base  # noqa: E402
from stepdiag_ros.nodes.base import reliable  # noqa: E402
from stepdiag_ros.nodes.patience import Patience  # noqa: E402

EVIL = '<img src=x onerror=alert(1)>'
DESCRIPTION = """
schema: 1
machine: {name: left, chain: FXYZ, volume: [0.2, 0.16, 0.12], tool: [0, 0, -0.1]}
plan: {steps: 2}
setups: {ppp: {standoff: 0.2, psd_offset: [0.02, 0.0]}}
"""


class Machine:
    """Publishes what the nodes of a machine would, with real messages."""

    def __init__(self, space: str):
        self._context = rclpy.Context()
        rclpy.init(context=self._context)
        self.node = rclpy.create_node('player', context=self._context)
        self.space = space
        self._said = self.node.create_publisher(DiagnosticArray, '/diagnostics', 10)

        def publisher(kind, topic, latched=False):
            return self.node.create_publisher(kind, f'{space}/{topic}', reliable(10, latched=latched))
        self._text = publisher(String, 'cell_description', True)
        self.step = publisher(Step, 'sequencer/step')
        self.length = publisher(DisplacementMean, 'interferometer/decimated')
        self.errors = publisher(GeometricErrors, 'geometric_errors/so_far', True)
        self.recorder = publisher(RecorderStatus, 'recorder/status')
        self._text.publish(String(data=DESCRIPTION))

    def say(self, name: str, message: str, level: bytes = b'\x00', **values: str) -> None:
        self._said.publish(DiagnosticArray(status=[DiagnosticStatus(
            name=name, message=message, level=level, values=[KeyValue(key=k, value=v) for k, v in values.items()])]))

    def breathe(self) -> None:
        """Once around: what a machine and a laser say every second, and a stranger's names."""
        self.say(f'{self.space[1:]}/step_sequencer', f'X to {EVIL}', goal='under way', stop='3', stops='12',
                 time_left_s='9')
        self.say('hall/multiplexer', 'left has the light', holder='left', queue='right', waits_s='17', held_for_s='3',
                 expected_s='20', held_s='30', grants='4', idle_share='0.02')
        self.say(f'{EVIL}/step_sequencer', EVIL)
        self.say(f'{self.space[1:]}/psd_driver', f'stalled {EVIL}', level=b'\x02')
        stamp = self.node.get_clock().now().to_msg()
        step = Step(run_id=EVIL, setup='ppp', index=2, phase=Step.DWELL)
        step.commanded.x = 0.1
        self.step.publish(step)
        self.length.publish(DisplacementMean(displacement=float('nan'), scatter=float('nan'), samples=50))
        curve = ErrorCurve(name=EVIL, unit='m', position=[0.0, 0.1], value=[0.0, 1e-6], sigma=[0.0, 1e-7])
        errors = GeometricErrors(status=EVIL, reduced_chi2=float('nan'), reference_temperature=float('inf'),
                                 curves=[curve], warnings=[EVIL])
        errors.header.stamp = stamp
        self.errors.publish(errors)

    def close(self) -> None:
        base.end(self.node, self._context)


@pytest.fixture
def machine(ros_domain) -> Iterator[Machine]:
    made = Machine('/left')
    yield made
    made.close()


def command(*arguments: str) -> list[str]:
    return [sys.executable, '-m', 'stepdiag_ros.cli.main', 'web', *arguments]


@pytest.fixture
def served(machine, tmp_path) -> Iterator[tuple[Machine, int]]:
    """The page of a machine that runs, and its port."""
    process = subprocess.Popen(command('--port', '0'), stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    line = process.stdout.readline()
    address = re.match(r'stepdiag: http://127\.0\.0\.1:(\d+)/', line)
    assert address, line + process.stdout.read()
    yield machine, int(address[1])
    process.send_signal(signal.SIGINT)
    said = process.communicate(timeout=60)[0]
    assert process.returncode == 0 and 'Traceback' not in said, said


def asked(port: int, path: str, method: str = 'GET', **headers: str) -> tuple[int, dict[str, str], str]:
    link = http.client.HTTPConnection('127.0.0.1', port, timeout=60)
    link.request(method, path, headers=headers)
    answer = link.getresponse()
    body = answer.read().decode()
    link.close()
    return answer.status, {key.lower(): value for key, value in answer.getheaders()}, body


def listen(port: int, query: str = '', origin: str | None = None) -> Iterator[dict]:
    """What the websocket tells; nothing where it refuses."""
    with socket.create_connection(('127.0.0.1', port), timeout=60) as link:
        ws = WSConnection(ConnectionType.CLIENT)
        headers = [] if origin is None else [(b'origin', origin.encode())]
        link.sendall(ws.send(Request(host=f'127.0.0.1:{port}', target=f'/live{query}', extra_headers=headers)))
        text = ''
        while data := link.recv(65536):
            ws.receive_data(data)
            for event in ws.events():
                if isinstance(event, RejectConnection):
                    return
                if isinstance(event, TextMessage):
                    text += event.data
                    if event.message_finished:
                        yield json.loads(text, parse_constant=lambda name: pytest.fail(f'{name} is no JSON'))
                        text = ''


def until(port: int, query: str, condition, machine: Machine) -> dict:
    """The first message that fulfils a condition while the machine breathes."""
    patience = Patience(60)
    for told in listen(port, query):
        if condition(told):
            return told
        assert not patience.over(), told
        machine.breathe()
    raise AssertionError('the server has closed')


def test_it_tells_the_hall_and_the_machine_in_plain_json(served):
    machine, port = served
    told = until(port, '?machine=/left', lambda t: t.get('machine', {}).get('errors') and t['hall']['lights'], machine)
    hall = told['hall']
    assert hall['lights'][0] | {'queue': []} == {
        'name': '/hall', 'holder': 'left', 'held_s': 3.0, 'expected_s': 20.0, 'queue': [], 'used_s': 30.0, 'grants': 4,
        'idle_share': 0.02}
    assert hall['lights'][0]['queue'] == [['right', '17']]
    left = next(m for m in hall['machines'] if m['name'] == '/left')
    assert left == {'name': '/left', 'under_way': True, 'stop': 3, 'stops': 12, 'left_s': 9.0, 'doing': f'X to {EVIL}'}
    assert {'node': '/left/psd_driver', 'text': f'stalled {EVIL}'} in hall['troubles']
    errors = told['machine']['errors']
    assert errors['reduced_chi2'] is None and errors['reference_temperature'] is None    # what is no number is null
    assert errors['curves'][0]['value'] == [0.0, 1e-6] and not errors['complete']
    # A machine with a name that ROS does not take is told of, and nothing is subscribed of it.
    assert any(EVIL in m['name'] for m in hall['machines'])
    until(port, '', lambda t: t['hall']['machines'], machine)    # and it still runs


def test_a_machine_that_does_not_run_is_one_clear_line(served, tmp_path):
    machine, port = served
    told = until(port, '?machine=/nowhere', lambda t: t['hall']['machines'], machine)
    assert told['trouble'].startswith('no machine /nowhere runs; choose one of ') and 'machine' not in told
    process = subprocess.Popen(command('/nowhere', '--port', '0'), stdout=subprocess.PIPE, stderr=subprocess.PIPE,
                               text=True)
    while process.poll() is None:
        machine.breathe()
        time.sleep(0.2)
    out, said = process.communicate()
    assert process.returncode == 2 and out == '' and said.count('\n') == 1
    assert said.startswith('stepdiag: no machine /nowhere runs; those that run: ') and '/left' in said


def test_nothing_can_be_changed_and_no_stranger_reads(served):
    machine, port = served
    status, headers, page = asked(port, '/')
    assert status == 200 and '<main>' in page
    policy = headers['content-security-policy']
    assert "default-src 'none'" in policy and "script-src 'self'" in policy and 'unsafe' not in policy
    for method in ('POST', 'PUT', 'DELETE', 'PATCH'):
        assert asked(port, '/', method)[0] == 405
    assert asked(port, '/', Host='evil.example')[0] == 400                                     # DNS rebinding
    assert list(listen(port, origin='http://evil.example')) == []                             # a page from elsewhere
    assert next(listen(port, origin=f'http://127.0.0.1:{port}'))['hall'] is not None
    for path in ('/report/0', '/report/../../etc/passwd', '/report/%2e%2e%2fetc', '/page.py', '/../app.py'):
        status, _, text = asked(port, path)
        assert status == 404 and 'root:' not in text and 'Traceback' not in text
    assert 'there is nothing at /nothing' in asked(port, '/nothing')[2]


def test_a_report_of_a_bag_that_is_no_bag_is_one_line(served, tmp_path):
    machine, port = served
    bag = tmp_path / f'{EVIL.replace("/", "")}'
    (bag).mkdir()

    def finished(told: dict) -> bool:
        machine.recorder.publish(RecorderStatus(recording=False, bag=str(bag), topics=['/left/sequencer/step'],
                                                received=[1], lost=[0]))
        return bool(told['reports'])
    report, = until(port, '', finished, machine)['reports']
    assert report['machine'] == '/left' and report['name'] == bag.name
    status, headers, text = asked(port, report['address'])
    assert status == 500 and '&lt;img' in text and '<img' not in text and 'script-src' not in headers[
        'content-security-policy'] and 'Traceback' not in text


def test_serving_to_others_is_said_loudly(ros_domain):
    process = subprocess.Popen(command('--host', '0.0.0.0', '--port', '0'), stdout=subprocess.PIPE, text=True)
    said = process.stdout.readline()
    process.terminate()
    process.communicate(timeout=60)
    assert said.startswith('stepdiag: WARNING: the page is OPEN at 0.0.0.0') and process.returncode == 0


@pytest.mark.parametrize(('options', 'line'), [
    (('--host', '203.0.113.7', '--port', '0'), 'cannot be served'),
    (('--host', 'no such host', '--port', '0'), 'is no address of this computer')])
def test_an_address_that_cannot_be_had_is_one_line(ros_domain, options, line):
    done = subprocess.run(command(*options), capture_output=True, text=True, timeout=120)
    assert done.returncode == 2 and done.stderr.count('\n') == 1 and line in done.stderr


def test_a_port_that_is_taken_is_one_line(ros_domain):
    with socket.socket() as other:
        other.bind(('127.0.0.1', 0))
        other.listen()
        port = other.getsockname()[1]
        done = subprocess.run(command('--port', str(port)), capture_output=True, text=True, timeout=120)
    assert done.returncode == 2 and f'127.0.0.1:{port} cannot be served' in done.stderr and done.stderr.count('\n') == 1
