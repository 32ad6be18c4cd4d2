"""A bag by our writer, read by other people's programs.

Each reader must find the messages that were written, with their values, types and
QoS.  A test skips only where its reader is not installed, and says so.
"""

import hashlib
import importlib
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from stepdiag_ros.bag.codec import (
    encode_displacement,
    encode_scalar,
    encode_spot,
    encode_step,
    encode_string,
)
from stepdiag_ros.bag.qos import LATCHED, RELIABLE, parse_qos
from stepdiag_ros.bag.schemas import DEFINITIONS, DESCRIPTION, DISPLACEMENT, OCCASIONAL, SPOT, STEP, TOPICS
from stepdiag_ros.bag.writer import BagWriter

HERE = Path(__file__).parent
START = 1_790_000_000_000_000_000
BLOCKS, SAMPLES, PERIOD = 120, 25, 400_000    # 25 samples at 2.5 kHz a block
NAMESPACE = '/cell1'
# All topics of the contract but those that tell of clocks, which only running nodes write.
WRITTEN = {topic: kind for topic, kind in TOPICS.items() if topic not in OCCASIONAL and not topic.endswith('/timing')}


@pytest.fixture(scope='module', params=['none', 'zstd', 'lz4'])
def bag(request, tmp_path_factory) -> Path:
    """Every contract topic, several chunks, written as the recorder writes."""
    rng = np.random.default_rng(7)
    path = tmp_path_factory.mktemp(request.param) / 'cell'
    with BagWriter(path, compression=request.param, flush_period=0.02, sync_period=0.05) as writer:
        for relative, kind in WRITTEN.items():
            writer.add_topic(f'{NAMESPACE}/{relative}', kind, LATCHED if relative == DESCRIPTION else RELIABLE)

        def write(relative: str, data: bytes, stamp: int, sequence: int) -> None:
            writer.write(f'{NAMESPACE}/{relative}', data, stamp + 700_000, stamp, sequence)

        write(DESCRIPTION, encode_string('schema: 1\nmachine: {name: "Größe"}\n'), START, 1)
        for k in range(BLOCKS):
            t = START + k * SAMPLES * PERIOD
            write(DISPLACEMENT, encode_displacement(t, 'ppp', PERIOD / 1e9, rng.normal(size=(SAMPLES, 2)),
                                                    1.0, np.full(SAMPLES, 95)), t, k + 1)
            write(SPOT, encode_spot(t, 'ppp', PERIOD / 1e9, *rng.normal(size=(3, SAMPLES))), t, k + 1)
            write(STEP, encode_step(t, 'ppp/0/+', 'ppp', 0, -1, k, 255, (0.1 * k, 0.0, -1.0), k % 3), t, k + 1)
            for number, relative in enumerate(r for r in WRITTEN if r.startswith('environment/')):
                write(relative, encode_scalar(t, 'x', 20.0 + number + k / 7, 1e-4), t, k + 1)
            if k % 40 == 39:
                writer.flush()
    return path


@pytest.fixture(scope='module')
def file(bag) -> Path:
    found, = bag.glob('*.mcap')
    return found


def installed(module: str) -> None:
    pytest.importorskip(module, reason=f'{module} is not installed (requirements/test.txt)')


def program(name: str) -> str:
    """A console program of this environment."""
    found = shutil.which(name, path=str(Path(sys.executable).parent)) or shutil.which(name)
    if found is None:
        pytest.skip(f'{name} is not installed (requirements/test.txt)')
    return found


def expected() -> dict[str, int]:
    return {f'{NAMESPACE}/{r}': 1 if r == DESCRIPTION else BLOCKS for r in WRITTEN}


def values_written() -> tuple[np.ndarray, np.ndarray]:
    """Displacements (blocks, samples, 2) and spots (blocks, 3, samples) of the bag, drawn again."""
    rng = np.random.default_rng(7)
    pairs = [(rng.normal(size=(SAMPLES, 2)), rng.normal(size=(3, SAMPLES))) for _ in range(BLOCKS)]
    return np.array([p[0] for p in pairs]), np.array([p[1] for p in pairs])


def check_messages(messages: Iterator[tuple[str, object]]) -> None:
    """Counts, order and every value of decoded messages."""
    seen: dict[str, int] = {}
    displacement, spot = values_written()
    for topic, m in messages:
        k = seen.get(topic, 0)
        seen[topic] = k + 1
        stamp = START + k * SAMPLES * PERIOD
        if topic == f'{NAMESPACE}/{DESCRIPTION}':
            assert m.data == 'schema: 1\nmachine: {name: "Größe"}\n'
            continue
        assert m.header.stamp.sec * 10**9 + m.header.stamp.nanosec == stamp
        if topic == f'{NAMESPACE}/{DISPLACEMENT}':
            assert np.array_equal(np.asarray(m.displacement), displacement[k].ravel())
            assert (m.beams, m.refractive_index, bytes(m.quality)) == (2, 1.0, bytes([95]) * SAMPLES)
        elif topic == f'{NAMESPACE}/{SPOT}':
            assert np.array_equal(np.stack([m.x, m.y, m.intensity]), spot[k])
            assert m.header.frame_id == 'ppp'
        elif topic == f'{NAMESPACE}/{STEP}':
            assert (m.run_id, m.setup, m.direction, m.index, m.axis, m.phase) == \
                ('ppp/0/+', 'ppp', -1, k, 255, k % 3)
            assert (m.commanded.x, m.commanded.z) == (0.1 * k, -1.0)
        else:
            assert m.variance == 1e-4
    assert seen == expected()


def test_rosbags(bag):
    installed('rosbags')
    from rosbags.highlevel import AnyReader
    with AnyReader([bag]) as reader:
        assert reader.message_count == sum(expected().values())
        for connection in reader.connections:
            profile, = parse_qos(LATCHED if connection.topic.endswith(DESCRIPTION) else RELIABLE, '')
            stored, = connection.ext.offered_qos_profiles
            assert stored.depth == profile['depth']
            assert stored.durability.name.lower() == profile['durability']
        check_messages((c.topic, reader.deserialize(raw, c.msgtype)) for c, _, raw in reader.messages())


def test_rosbags_finds_the_same_types(bag):
    """Hash and definition that the bag carries are what rosbags computes from the texts."""
    installed('rosbags')
    from rosbags.rosbag2 import Reader
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore
    store = get_typestore(Stores.ROS2_JAZZY)
    for name, text in DEFINITIONS.items():
        if name.startswith('stepdiag_msgs'):
            store.register(get_types_from_msg(text, name))
    with Reader(bag) as reader:
        assert len(reader.connections) == len(WRITTEN)
        for connection in reader.connections:
            assert connection.digest == store.hash_rihs01(connection.msgtype)
            assert get_types_from_msg(connection.msgdef.data, connection.msgtype)


@pytest.mark.parametrize('module', ['mcap_ros2', 'mcap_ros2_support_fast'])
def test_mcap_ros2_support(file, module):
    """Both decoders of ROS 2 messages for the mcap library, CRCs checked."""
    installed(module)
    factory = importlib.import_module(f'{module}.decoder').DecoderFactory
    with open(file, 'rb') as stream:
        reader = make_reader(stream, decoder_factories=[factory()], validate_crcs=True)
        check_messages((c.topic, m) for _, c, _, m in reader.iter_decoded_messages())


@pytest.fixture(scope='session')
def node_packages(tmp_path_factory) -> Path:
    """Foxglove's packages in the locked versions, kept between runs beside other caches."""
    node, npm = shutil.which('node'), shutil.which('npm')
    if node is None or npm is None:
        pytest.skip('node or npm is not installed: @mcap/core cannot be run')
    lock = (HERE / 'node' / 'package-lock.json').read_bytes()
    cache = Path(os.environ.get('XDG_CACHE_HOME', Path.home() / '.cache')) / 'stepdiag_ros'
    place = cache / f'node-{hashlib.sha256(lock).hexdigest()[:16]}'
    if not (place / 'node_modules').is_dir():
        fresh = tmp_path_factory.mktemp('node')
        for name in ('package.json', 'package-lock.json'):
            shutil.copy(HERE / 'node' / name, fresh)
        done = subprocess.run([npm, 'ci', '--ignore-scripts', '--no-audit', '--no-fund'], cwd=fresh,
                              capture_output=True, text=True)
        if done.returncode:
            pytest.skip('npm cannot install @mcap/core and @foxglove/rosmsg2-serialization: '
                        + (done.stderr.strip().splitlines() or ['no message'])[-1])
        cache.mkdir(parents=True, exist_ok=True)
        try:
            shutil.move(fresh, place)
        except OSError:
            if not (place / 'node_modules').is_dir():    # else another run was faster
                raise
    return place


def test_node_mcap_core_with_foxglove_serialization(bag, file, node_packages, tmp_path):
    script = shutil.copy(HERE / 'node' / 'read_bag.mjs', node_packages / f'read_bag.{os.getpid()}.mjs')
    try:
        done = subprocess.run(['node', script, str(file)], capture_output=True, text=True)
    finally:
        Path(script).unlink()
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found['profile'] == 'ros2' and found['metadata'] == ['rosbag2'] and found['attachments'] == 0
    assert found['messages'] == sum(expected().values()) and found['chunks'] >= 3
    assert {t: v['count'] for t, v in found['topics'].items()} == expected()
    for topic, about in found['topics'].items():
        relative = topic.removeprefix(f'{NAMESPACE}/')
        assert about['type'] == WRITTEN[relative] and about['encoding'] == 'cdr'
        assert about['qos'] == (LATCHED if relative == DESCRIPTION else RELIABLE)
        assert (about['first_sequence'], about['last_sequence']) == (1, about['count'])
    displacement, spot = values_written()
    topics = found['topics']
    # Sums in the order of the messages, as the script adds them: equal to the last bit.
    assert topics[f'{NAMESPACE}/{DISPLACEMENT}']['sum'] == float(np.cumsum(displacement.ravel())[-1])
    assert topics[f'{NAMESPACE}/{SPOT}']['sum'] == float(np.cumsum(spot[:, 0].ravel())[-1])
    assert topics[f'{NAMESPACE}/{DESCRIPTION}']['text'].endswith('{name: "Größe"}\n')


def test_pymcap_cli_doctor(file):
    """Structure of the container against the MCAP specification: no warning, no error."""
    done = subprocess.run([program('pymcap-cli'), 'doctor', '--format', 'jsonl', '--strict-message-order',
                           str(file)], capture_output=True, text=True)
    findings = [json.loads(line) for line in done.stdout.splitlines() if line.startswith('{')]
    worse = [f for f in findings if str(f.get('severity', '')).lower() in ('warning', 'error')]
    assert done.returncode == 0 and worse == [], done.stdout + done.stderr
    assert findings, 'the doctor said nothing: has its output changed?'


def test_pymcap_cli_doctor_sees_damage(file, tmp_path):
    """The check above can fail."""
    data = bytearray(file.read_bytes())
    data[len(data) // 2] ^= 0x55
    (tmp_path / 'bad.mcap').write_bytes(data)
    done = subprocess.run([program('pymcap-cli'), 'doctor', str(tmp_path / 'bad.mcap')], capture_output=True)
    assert done.returncode != 0


def recording_contract() -> dict:
    """What backplane-tracecheck shall demand of the bag: all of its checks switched on."""
    span = [START, START + BLOCKS * SAMPLES * PERIOD]
    rate = 1e9 / (SAMPLES * PERIOD)
    topics = {}
    for relative, kind in WRITTEN.items():
        count = expected()[f'{NAMESPACE}/{relative}']
        topics[f'{NAMESPACE}/{relative}'] = {
            'required': True, 'message_encoding': 'cdr', 'schema_name': kind, 'schema_encoding': 'ros2msg',
            'min_count': count, 'max_count': count}
        if relative != DESCRIPTION:
            topics[f'{NAMESPACE}/{relative}'] |= {
                'time_basis': 'publish_time', 'clock_confirmed': True, 'min_rate_hz': 0.95 * rate,
                'max_rate_hz': 1.05 * rate, 'max_gap_ns': SAMPLES * PERIOD, 'check_regression': True,
                'sequence': 'increment_mod32', 'interval_ns': span,
                'boundary_tolerance_ns': 2 * SAMPLES * PERIOD}
    return {'version': 1, 'name': 'step-diagonal calibration', 'profile': 'ros2',
            'metadata': {'rosbag2': {'serialized_metadata': None}}, 'topics': topics}


def tracecheck(bag: Path, contract: dict, out: Path) -> tuple[int, dict[str, str]]:
    out.mkdir()
    (out / 'contract.json').write_text(json.dumps(contract))
    done = subprocess.run([program('tracecheck'), 'check', str(bag), '--contract', str(out / 'contract.json'),
                           '--out', str(out / 'report')], capture_output=True, text=True)
    assert done.returncode in (0, 1), done.stderr
    report = json.loads((out / 'report' / 'report.json').read_text())
    return done.returncode, {check['id']: check['status'] for check in report['checks']}


def test_backplane_tracecheck(bag, tmp_path):
    """Topics, schemas, counts, rates, gaps, order, sequence numbers, coverage, metadata.yaml."""
    status, checks = tracecheck(bag, recording_contract(), tmp_path / 'good')
    assert status == 0 and set(checks.values()) == {'pass'}, checks
    assert {f'C{k:02d}' for k in range(1, 12)} <= checks.keys()


def test_backplane_tracecheck_sees_a_missing_message(bag, tmp_path):
    contract = recording_contract()
    contract['topics'][f'{NAMESPACE}/{SPOT}']['min_count'] += 1
    del contract['topics'][f'{NAMESPACE}/{SPOT}']['max_count']
    status, checks = tracecheck(bag, contract, tmp_path / 'short')
    assert status == 1 and checks['C05'] == 'fail'
