"""The clients against the virtual instruments: real processes, real sockets."""

import dataclasses
import json
import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import yaml

from stepdiag_ros.devices.base import DeviceError
from stepdiag_ros.devices.hostclock import HOST
from stepdiag_ros.devices.ids3010 import PAUSE_S, Ids3010
from stepdiag_ros.devices.linuxcnc_rsh import LinuxCncRsh
from stepdiag_ros.devices.modbus_psd import ModbusPsd
from stepdiag_ros.devices.psd_signal import SpotOptics
from stepdiag_ros.model.machine import tool_pose
from stepdiag_ros.model.sensor import measure
from stepdiag_ros.nodes.patience import Patience
from stepdiag_ros.virtual.cell import load_cell
from stepdiag_ros.virtual.cell_process import CellProcess
from stepdiag_ros.virtual.history import SharedHistory, now_ns
from stepdiag_ros.virtual.serving import MOTION_FILE

DEMO = Path(__file__).resolve().parents[3] / 'cells' / 'demo.yaml'


def cell_file(folder: Path, *changes: tuple[str, str]) -> Path:
    text = DEMO.read_text(encoding='utf-8')
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    path = folder / 'cell.yaml'
    path.write_text(text, encoding='utf-8')
    return path


@dataclasses.dataclass
class Taken:
    """Blocks of one device laid end to end."""

    blocks: list

    def __getattr__(self, name: str) -> np.ndarray:
        return np.concatenate([getattr(block, name) for block in self.blocks])

    @property
    def time_ns(self) -> np.ndarray:
        return np.concatenate([block.stamp_ns + (
            block.accuracy.taken_ns if len(block.accuracy.taken_ns) else
            np.rint(np.arange(len(block.x_m)) * block.period_s * 1e9).astype(np.int64)) for block in self.blocks])


def take(device, samples: int, period_s: float = 1e-3) -> Taken:
    """So many samples: on a busy computer a block has fewer than were asked for."""
    blocks, count = [], 0
    while count < samples:
        blocks.append(device.read_block(min(samples, 100), period_s))
        count += len(blocks[-1].x_m if hasattr(blocks[-1], 'x_m') else blocks[-1].quality)
    return Taken(blocks)


@dataclasses.dataclass
class Bench:
    cell: object
    endpoints: dict
    cnc: LinuxCncRsh
    runtime: Path

    def interferometer(self, **more) -> Ids3010:
        where = self.endpoints['interferometer']
        return Ids3010(where['host'], where['port'], **more)

    def psd(self, **more) -> ModbusPsd:
        where = self.endpoints['psd']
        return ModbusPsd(where['host'], where['port'], where['stream_port'], **more)

    def go(self, *place: float) -> None:
        self.cnc.move(np.array(place), 0.5)
        while not self.cnc.in_position():
            time.sleep(0.002)


def control(endpoints: dict) -> LinuxCncRsh:
    where = endpoints['cnc']
    return LinuxCncRsh(where['host'], where['port'], setup_codes=where['setup_codes'])


@pytest.fixture(scope='module')
def bench(tmp_path_factory):
    folder = tmp_path_factory.mktemp('bench')
    path = cell_file(folder)
    with CellProcess(path, folder / 'runtime') as process:
        endpoints = process.start()
        cnc = control(endpoints)
        cnc.connect()
        cnc.make_ready()
        yield Bench(load_cell(path), endpoints, cnc, folder / 'runtime')
        cnc.close()


def test_the_control_gets_ready_and_says_so(bench):
    bench.cnc.make_ready()
    state = bench.cnc.state()
    assert state == {'estop': False, 'on': True, 'homed': True, 'idle': True, 'mode': 'mdi'}


def test_readings_are_the_machine_s(bench):
    """Displacement and spot against the contract's closed forms, noise and repeatability aside."""
    cell = bench.cell
    machine, setup = cell.description.machine, cell.description.setups['npp']
    bench.cnc.select_setup('npp')
    places = np.array([[0.2, 0.0, 0.0], [0.1, 0.08, 0.06], [0.0, 0.16, 0.12]])
    length, spot = measure(machine, setup, cell.misalignments['npp'],
                           *tool_pose(cell.geometry, places, np.array(machine.tool)))
    meter, detector = bench.interferometer(), bench.psd()
    meter.connect()
    detector.connect()
    bench.go(*places[0])
    meter.reset()
    for place, expected, point in zip(places, length - length[0], spot, strict=True):
        bench.go(*place)
        time.sleep(0.05)
        np.testing.assert_allclose(bench.cnc.position(), place, atol=1e-7)
        block = take(meter, 100)
        assert block.displacement_m.shape[1] == 1
        assert abs(block.displacement_m.mean() - expected[0]) < 3e-6
        assert 3e-9 < block.displacement_m.std() < 8e-9
        assert block.quality.max() > 50 and 1.0002 < block.blocks[0].refractive_index < 1.0003
        light, now = detector.read_block(100, 1e-3), time.time_ns()
        while light.stamp_ns < now:   # a stream that was not read brings what was before first
            light = detector.read_block(100, 1e-3)
        # Two metres out and back at 0.2 µrad, and a sixth of a micrometre of quantisation.
        assert abs(np.mean(light.x_m) - point[0]) < 5e-6 and abs(np.mean(light.y_m) - point[1]) < 5e-6
        assert np.mean(light.intensity_V) == pytest.approx(8.0, abs=0.01)
    meter.close()
    detector.close()


def test_environment(bench):
    meter = bench.interferometer()
    meter.connect()
    air = meter.environment()
    assert air['air_temperature'] == pytest.approx(20.3, abs=0.1)
    assert air['air_pressure'] == pytest.approx(101100.0, abs=50.0)
    assert air['humidity'] == pytest.approx(0.42, abs=0.05)
    meter.close()


def test_every_sample_that_was_due_is_there_or_counted_as_missed(bench):
    bench.cnc.select_setup('ppp')
    bench.go(0.0, 0.0, 0.0)
    for device in (bench.interferometer(), bench.psd(), bench.psd(mode='poll')):
        device.connect()
        taken = take(device, 1000)
        time_ns = taken.time_ns
        assert np.all(np.diff(time_ns) > 0)
        assert abs(HOST.now_ns() - time_ns[-1]) < 20_000_000_000
        missed = sum(block.accuracy.missed for block in taken.blocks[1:])
        gaps = np.diff(time_ns) * 1e-6
        due, about = gaps.sum(), 0.02 * gaps.sum() + 50
        # Of a computer that stood still for long it is taken that nobody wanted samples meanwhile.
        stood = gaps[gaps > 1e3 * PAUSE_S].sum()
        assert due - stood - about < len(time_ns) + missed < due + about
        device.close()


def test_samples_are_stamped_with_the_time_at_which_they_were_taken(bench):
    """In motion at a known speed the reading tells the time; both sensors agree with the control's clock."""
    bench.cnc.select_setup('lin_x')
    bench.go(0.0, 0.0, 0.0)
    meter = bench.interferometer()
    meter.connect()
    meter.reset()
    bench.cnc.move(np.array([0.2, 0.0, 0.0]), 0.1)
    blocks = []
    while not bench.cnc.in_position():   # the control stops when its client is silent
        blocks.append(meter.read_block(50, 1e-3))
    taken = Taken(blocks)
    meter.close()
    history = SharedHistory(bench.runtime / MOTION_FILE)
    history.follow()
    known = np.concatenate([block.accuracy.uncertainty_ns for block in taken.blocks]) * 1e-9
    world_ns = taken.time_ns - (HOST.now_ns() - now_ns())
    _, _, actual, _ = history.locate(world_ns, bench.cell.motion.settling)
    off = np.abs(taken.displacement_m[:, 0] - actual[:, 0])
    moving = (actual[:, 0] > 0.01) & (actual[:, 0] < 0.19)
    assert moving.sum() > 100
    # 20 µm of geometric errors, and what 0.1 m/s makes of the time's uncertainty; servers late in a queue besides.
    assert np.mean(off[moving] < 3.0e-5 + 0.1 * (known[moving] + 1e-4)) > 0.95
    assert np.median(off[moving]) < 0.1 * 2e-3   # on any computer better than two milliseconds


def test_ten_thousand_samples_a_second(bench):
    """The samples come; how fast is a matter for the bench."""
    for device in (bench.interferometer(), bench.psd()):
        device.connect()
        taken = take(device, 2000, 1e-4)
        first = taken.blocks[0]
        assert len(first.displacement_m if hasattr(first, 'displacement_m') else first.x_m) >= 10
        device.close()


def test_registers_by_request_agree_with_the_stream(bench):
    bench.cnc.select_setup('ppp')
    bench.go(0.1, 0.1, 0.1)
    means = []
    for mode in ('poll', 'stream'):
        detector = bench.psd(mode=mode)
        detector.connect()
        block = take(detector, 200)
        means.append([block.x_m.mean(), block.y_m.mean(), block.intensity_V.mean()])
        detector.close()
    np.testing.assert_allclose(means[0][:2], means[1][:2], atol=2e-7)
    assert means[0][2] == pytest.approx(means[1][2], abs=1e-3)


def test_driver_parameters_of_the_detector(bench):
    """A driver that believes the detector turned by 90° swaps its axes."""
    straight, turned = bench.psd(), bench.psd(optics=SpotOptics(rotation=np.pi / 2, gain=(2.0, 1.0)))
    results = []
    for detector in (straight, turned):
        detector.connect()
        block = take(detector, 200)
        results.append((block.x_m.mean(), block.y_m.mean()))
        detector.close()
    assert results[1][1] == pytest.approx(2.0 * results[0][0], abs=4e-7)
    assert results[1][0] == pytest.approx(-results[0][1], abs=4e-7)


def test_stop_brings_the_machine_to_rest(bench):
    bench.cnc.select_setup('ppp')
    bench.go(0.0, 0.0, 0.0)
    bench.cnc.move(np.array([0.2, 0.16, 0.12]), 0.02)
    time.sleep(0.3)
    bench.cnc.stop()
    place = bench.cnc.position()
    assert 0.0 < place[0] < 0.2
    np.testing.assert_allclose(place / place[0], [1.0, 0.8, 0.6], rtol=1e-4)
    time.sleep(0.1)
    np.testing.assert_allclose(bench.cnc.position(), place, atol=2e-9)
    bench.go(0.05, 0.0, 0.0)   # and it goes on from there
    np.testing.assert_allclose(bench.cnc.position(), [0.05, 0.0, 0.0], atol=1e-7)


@pytest.mark.parametrize('gone', [False, True], ids=['link open', 'link gone'])
def test_a_stop_does_not_wait_for_the_watchdog(bench, gone):
    """Whoever takes the signs of life is gone: that hinders every further move, and no stop."""
    bench.go(0.0, 0.0, 0.0)
    where, watch = bench.endpoints['cnc'], socket.create_server(('127.0.0.1', 0))
    client = LinuxCncRsh(where['host'], where['port'], watch_port=watch.getsockname()[1], stop_timeout_s=3.0)
    client.connect()
    client.move(np.array([0.2, 0.0, 0.0]), 0.02)
    watch.close()
    with pytest.raises(DeviceError, match='watchdog of the machine control'):
        while True:
            client.in_position()
    if gone:
        client._link.close()
    client.stop()
    assert 0.0 < client.position()[0] < 0.1
    client.close()
    bench.cnc.connect()
    bench.go(0.0, 0.0, 0.0)


@pytest.mark.parametrize(('place', 'feed', 'words'), [
    ((0.5, 0.0, 0.0), 0.1, "X's positive limit"), ((0.0, -0.1, 0.0), 0.1, "Y's negative limit"),
    ((0.0, 0.0, np.nan), 0.1, 'three coordinates'), ((0.0, 0.0, 0.0), 0.0, 'feed above zero')])
def test_moves_that_must_not_be(bench, place, feed, words):
    with pytest.raises(DeviceError, match=words):
        bench.cnc.move(np.array(place), feed)
    bench.cnc.connect()
    assert bench.cnc.in_position() in (True, False)


def ask(where: dict, data: bytes, answers: int) -> bytes:
    """What the server says to raw bytes, until so many objects have ended."""
    with socket.create_connection((where['host'], where['port']), 10.0) as connection:
        connection.sendall(data)
        got = b''
        while got.count(b'"id":') < answers or not got.rstrip().endswith(b'}'):
            more = connection.recv(65536)
            assert more, f'closed after {got!r}'
            got += more
        return got


@pytest.mark.parametrize('params', [b'{"a":1}', b'[1e999]', b'[[]]', b'"x"', b'[9]'])
def test_parameters_that_are_none_are_answered_by_an_error(bench, params):
    request = b'{"jsonrpc":"2.0","method":"com.attocube.sen.adjustment.getContrastInPermille","params":%s,"id":5}'
    assert json.loads(ask(bench.endpoints['interferometer'], request % params, 1))['error']['code'] == -32602


@pytest.mark.parametrize('end', [b'', b'\n', b'\r\n'])
def test_the_interferometer_takes_both_framings(bench, end):
    request = b'{"jsonrpc":"2.0","method":"com.attocube.sen.displacement.getAbsolutePositions",' \
              b'"params":[],"id":5,"api":2}'
    line = ask(bench.endpoints['interferometer'], request + end, 1)
    answer = json.loads(line)
    assert answer['id'] == 5 and len(answer['result']) == 4
    assert all(isinstance(value, int) for value in answer['result'])
    many = ask(bench.endpoints['interferometer'], (request + end) * 3, 3)
    assert many.count(b'"result"') == 3


def test_methods_that_it_does_not_know(bench):
    for method in ('com.attocube.ids.system.getCurrentMode', 'nonsense'):
        answer = json.loads(ask(bench.endpoints['interferometer'], json.dumps(
            {'jsonrpc': '2.0', 'method': method, 'id': 'x'}).encode(), 1))
        assert answer['error']['code'] == -32601 and answer['id'] == 'x'


def test_older_firmware_without_newlines_and_three_beams(tmp_path):
    path = cell_file(tmp_path, ('namespace: sen, newline: true', 'namespace: ids, newline: false'),
                     ('  ppp: {standoff: 0.20, psd_offset: [0.02, 0.0], beams: [[0.0, 0.0]]}',
                      '  ppp: {standoff: 0.20, psd_offset: [0.02, 0.0], '
                      'beams: [[0.0, 0.0], [0.02, 0.0], [0.0, 0.02]]}'),
                     ('  compensated: true', '  compensated: false\n  sensors: []'))
    with CellProcess(path, tmp_path / 'runtime') as process:
        endpoints = process.start()
        cnc = control(endpoints)
        cnc.connect()
        cnc.make_ready()
        cnc.select_setup('ppp')
        cnc.move(np.array([0.0, 0.0, 0.0]), 0.5)
        meter = Ids3010('127.0.0.1', endpoints['interferometer']['port'], beams=3, newline=False)
        meter.connect()
        assert meter.namespace == 'com.attocube.ids'
        assert meter.environment() == {}
        while not cnc.in_position():
            time.sleep(0.002)
        meter.reset()
        block = meter.read_block(50, 1e-3)
        assert block.displacement_m.shape[1] == 3 and block.refractive_index == 1.0
        assert np.abs(block.displacement_m).max() < 1e-7
        meter.close()
        cnc.close()


def running(marker: str) -> list[str]:
    found = []
    for entry in Path('/proc').iterdir():
        if entry.name.isdigit():
            try:
                line = (entry / 'cmdline').read_bytes().decode(errors='replace')
            except OSError:
                continue
            if marker in line:
                found.append(entry.name)
    return found


@pytest.mark.parametrize('how', [signal.SIGTERM, signal.SIGINT, signal.SIGKILL])
def test_the_cell_s_process_leaves_nothing(tmp_path, how):
    runtime, stated = tmp_path / 'runtime', tmp_path / 'truth.json'
    process = subprocess.Popen(
        [sys.executable, '-m', 'stepdiag_ros.virtual.cell_process', str(cell_file(tmp_path)),
         '--runtime', str(runtime), '--truth', str(stated)], stdout=subprocess.PIPE, text=True)
    try:
        patience = Patience(60)
        while not stated.exists() and not patience.over():
            assert process.poll() is None
            time.sleep(0.05)
        endpoints = yaml.safe_load((runtime / 'endpoints.yaml').read_text())
        assert endpoints['pid'] == process.pid and endpoints['psd']['stream_port'] > 0
        assert json.loads(stated.read_text())['machine'] == 'demo'
        assert len(running(str(runtime))) == 4
        os.kill(process.pid, how)
        process.wait(30)
        while running(str(runtime)) and not patience.over():
            time.sleep(0.05)
        assert running(str(runtime)) == []
        if how != signal.SIGKILL:
            assert process.returncode == 0
            assert list(runtime.iterdir()) == []
    finally:
        process.kill()
        process.communicate()


def test_a_server_that_dies_ends_the_cell(tmp_path):
    runtime = tmp_path / 'runtime'
    process = subprocess.Popen(
        [sys.executable, '-m', 'stepdiag_ros.virtual.cell_process', str(cell_file(tmp_path)),
         '--runtime', str(runtime)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        patience = Patience(60)
        while not (runtime / 'endpoints.yaml').exists() and not patience.over():
            time.sleep(0.05)
        victim = next(pid for pid in running(str(runtime)) if int(pid) != process.pid)
        os.kill(int(victim), signal.SIGKILL)
        _, errors = process.communicate(timeout=30)
        assert process.returncode == 2 and 'ended by itself' in errors and 'Traceback' not in errors
        assert running(str(runtime)) == []
    finally:
        process.kill()
        process.communicate()


def test_a_cell_file_that_is_wrong_is_one_line(tmp_path):
    path = cell_file(tmp_path, ('  dwell: 0.06', '  dwell: soon'))
    done = subprocess.run([sys.executable, '-m', 'stepdiag_ros.virtual.cell_process', str(path)],
                          capture_output=True, text=True, timeout=60)
    assert done.returncode == 2 and done.stdout == ''
    assert done.stderr.count('\n') == 1 and 'motion.dwell' in done.stderr
