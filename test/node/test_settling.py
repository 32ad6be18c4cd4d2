"""A running cell settles by itself what its log leaves open: by a run that it can make, or it says why not."""

import json
import re
import subprocess
import sys

import pytest

from stepdiag_ros.bag.reader import read_log
from stepdiag_ros.cli.settled import answer_words
from stepdiag_ros.effects import all_effects
from stepdiag_ros.nodes.settling import NOTHING_HELPS, SETTLED, TIME_IS_UP, settle

PLAN = ['ppp', 'lin_x']
CELL = """
schema: 1
seed: 20
machine: {name: open, chain: FXYZ, volume: [0.20, 0.16, 0.12], tool: [0.0, 0.0, -0.12]}
plan: {steps: 3, order: XYZ, repeats: 2}
setups:
  ppp: {standoff: 0.20, psd_offset: [0.02, 0.0], beams: [[0.0, 0.0]]}
  npp: {standoff: 0.20, psd_offset: [0.02, 0.0], beams: [[0.0, 0.0]]}
  pnp: {standoff: 0.20, psd_offset: [0.02, 0.0], beams: [[0.0, 0.0]]}
  nnp: {standoff: 0.20, psd_offset: [0.02, 0.0], beams: [[0.0, 0.0]]}
  lin_x: {standoff: 0.20, psd_offset: [0.02, 0.0], beams: [[0.0, 0.0]], length: 0.20, stops: 2}
noise: {displacement: 5.0e-9, spot: 2.0e-7, position_repeatability: 3.0e-7, angle_repeatability: 2.0e-7}
geometry:
  drawn: {positioning: 8.0e-6, straightness: 4.0e-6, angle: 2.0e-5, squareness: 1.5e-5}
misalignments:
  drawn: {laser: 3.0e-4, mirror: 2.0e-4, psd_zero: 0.0}
effects: {psd_zero_offset: {x: 6.0e-4, y: -4.5e-4}}   # one diagonal and one line do not tell it from other causes
air: {compensated: true, period: 1.0}
motion: {feed: 0.5, acceleration: 8.0, jerk: 800.0, in_position: 1.0e-9, settling: 0.002, dwell: 0.12}
sampling: {interferometer: 200.0, psd: 200.0, block: 0.05}
"""


@pytest.fixture(scope='module')
def cell(module_domain, tmp_path_factory):
    """A cell whose plan of one diagonal and one line leaves seven causes open."""
    from stepdiag_ros.nodes.bringup import Bringup
    folder = tmp_path_factory.mktemp('open')
    path = folder / 'open.yaml'
    path.write_text(CELL, encoding='utf-8')
    with Bringup(path, bag_folder=folder, runtime=folder / 'run') as running:
        yield running


@pytest.fixture(scope='module')
def bag(cell):
    """What the plan measured, closed."""
    path = cell.runtime.parent / 'plan'
    cell.operator.new_log(str(path))
    assert cell.operator.calibrate(setups=PLAN).succeeded
    cell.operator.bring('recorder', 'inactive')
    return path


def effects():
    return [kind() for kind in all_effects([]).values()]


def bags(bag):
    return sorted(path.name for path in bag.parent.glob(f'{bag.name}*'))


def test_time_is_up_when_the_next_run_is_longer(cell, bag):
    found = settle(cell.operator, bag, effects(), time_s=3.0)
    assert found.how == TIME_IS_UP and 'psd_zero_offset' in found.open
    assert found.wanted.seconds > 3.0 and not found.rounds
    words = answer_words(found, 3.0)
    assert 'Time is up' in words and f'mounts {found.wanted.code}' in words
    assert bags(bag) == ['plan']


@pytest.mark.long
def test_what_hands_alone_could_do_is_left_to_them(cell, bag, restart_sequencer):
    # The control mounts by code what the plan has measured: once more as it stands that tells nothing new.
    restart_sequencer(cell, '-p', "setup_codes:=['ppp=M101','lin_x=M105']")
    try:
        found = settle(cell.operator, bag, effects(), time_s=3600.0)
    finally:
        restart_sequencer(cell)
    assert found.how == NOTHING_HELPS and len(found.open) > 1 and not found.rounds
    assert 'No run that this cell makes without hands' in answer_words(found, 3600.0)
    assert bags(bag) == ['plan']


@pytest.mark.long
def test_the_cell_makes_the_run_that_separates(cell, bag):
    said = []
    found = settle(cell.operator, bag, effects(), time_s=3600.0, say=said.append)
    assert found.how == SETTLED and not found.open
    assert 1 <= len(found.rounds) <= 3 and said == list(found.rounds)
    first = found.rounds[0]
    assert 'psd_zero_offset' in first.open and len(first.open) > 2
    assert first.able.code not in PLAN and first.able.run.error < 0.05
    steps = read_log(first.bag).steps
    assert {steps.setup_names[i] for i in steps.setup} == {first.able.code}
    zero, = (f for f in found.diagnosis.effects if f.name == 'psd_zero_offset')
    assert zero.probability > 0.95
    for axis, true in (('x', 6.0e-4), ('y', -4.5e-4)):
        assert abs(zero.parameters[axis] - true) < max(4.0 * zero.sigma[axis], 2.0e-5)
    assert answer_words(found, 3600.0).startswith('settled after 1 further run')
    document = found.to_json_dict()
    assert document['how'] == SETTLED and document['rounds'][0]['bag'] == str(first.bag)
    assert json.loads(json.dumps(document['rounds']))


@pytest.mark.long
def test_the_command_says_each_round_and_the_answer(ros_domain, tmp_path):
    path, log = tmp_path / 'open.yaml', tmp_path / 'log'
    path.write_text(CELL, encoding='utf-8')
    done = subprocess.run([sys.executable, '-m', 'stepdiag_ros.cli.main', 'calibrate', str(path), '--setups', *PLAN,
                           '--bag', str(log), '--until-settled'],
                          capture_output=True, text=True, timeout=800, check=False)
    assert re.search(r"further run 1: open: .*Spot sensor's zero is off \(\d+ %\).* The cell mounts \w+ and measures "
                     r'it, which the log does not hold; expected to decide with odds of .* to one; takes about '
                     r'\d+ s; log: .*log_further_1', done.stderr), done.stderr
    assert re.search(r"settled after \d further runs?: .*position sensor's zero", done.stdout), done.stdout
    assert f'stepdiag gap {log} --further {log}_further_1' in done.stdout
    assert done.returncode == (0 if 'status ok' in done.stdout else 1)
