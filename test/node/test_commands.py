"""The commands that work with a running graph, as a user calls them."""

import json
import signal
import subprocess
import sys
import threading
import time

from stepdiag_ros.bag.export import write_log
from stepdiag_ros.bag.reader import read_log
from stepdiag_ros.cli.demo import demo_cell, same_result
from stepdiag_ros.estimate import evaluate
from stepdiag_ros.nodes.patience import Patience
from stepdiag_ros.virtual.cell import load_cell
from stepdiag_ros.virtual.offline import simulate_log

STEPDIAG = [sys.executable, '-m', 'stepdiag_ros.cli.main']


def test_the_demo_shows_errors_beside_the_truth(ros_domain, cell_file, tmp_path):
    out = tmp_path / 'out'
    done = subprocess.run([*STEPDIAG, 'demo', '--cell', str(cell_file), '--out', str(out), '--json'],
                          capture_output=True, text=True, timeout=300)
    report = json.loads(done.stdout)
    assert done.returncode == (0 if report['agrees'] else 1), done.stderr
    assert report['live_equals_bag'] and report['stops'] == 12
    assert report['within_k2'] > 0.8
    assert (out / 'errors.png').stat().st_size > 10_000
    assert json.loads((out / 'solution.json').read_text())['dof'] == report['evaluation']['dof']
    assert same_result(evaluate(read_log(out / 'log')).to_json_dict(), report['evaluation'])


def test_the_demos_cell_is_there():
    assert load_cell(demo_cell()).description.plan.steps >= 2


def test_calibrate_brings_a_cell_up_and_writes_a_bag(ros_domain, cell_file, tmp_path):
    bag = tmp_path / 'log'
    done = subprocess.run([*STEPDIAG, 'calibrate', str(cell_file), '--bag', str(bag), '--steps', '2',
                           '--setups', 'ppp'], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith('succeeded: 14 stops in 2 runs') and str(bag) in done.stdout
    assert 'reduced chi2' in done.stdout and '14/14' in done.stderr
    log = read_log(bag)
    assert log.description.plan.steps == 2 and log.steps.index.max() == 6


def _hears_ctrl_c() -> None:
    """Tests that run in the background of a shell are started deaf to SIGINT, and so would be their children."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def test_ctrl_c_cancels_a_calibration_and_leaves_a_whole_bag(ros_domain, cell_file, tmp_path):
    bag = tmp_path / 'log'
    # Long dwells: however late the first line comes through on a busy machine, stops are left to cancel.
    said = []
    with subprocess.Popen([*STEPDIAG, 'calibrate', str(cell_file), '--bag', str(bag), '--dwell', '6.0'],
                          stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
                          preexec_fn=_hears_ctrl_c) as running:
        reader = threading.Thread(target=lambda: said.extend(running.stderr), daemon=True)
        reader.start()
        patience = Patience(120)
        while not any('calibrating' in line for line in said):
            assert running.poll() is None and not patience.over()
            time.sleep(0.1)
        time.sleep(9.0)
        running.send_signal(signal.SIGINT)
        output = running.stdout.read()
        assert running.wait(90) == 130
        reader.join(10)
    assert 'canceled: stopped on request' in output and 'the machine stands still' in output
    log = read_log(bag)
    assert 0 < (log.steps.phase == 2).sum() < 12
    assert not [w for w in log.warnings if 'recover' in w or 'lost' in w]


def test_calibrate_needs_a_machine(ros_domain):
    done = subprocess.run([*STEPDIAG, 'calibrate'], capture_output=True, text=True, timeout=120)
    assert done.returncode == 2
    assert done.stderr == ('stepdiag: no machine is running; name a cell file, or start one with '
                           'stepdiag up\n')


def test_a_log_replayed_onto_topics_gives_a_solver_the_same_bits(ros_domain, cell_file, tmp_path):
    from stepdiag_ros.nodes.operator import Operator
    bag = write_log(simulate_log(load_cell(cell_file)), tmp_path / 'log')
    with open(tmp_path / 'solver.log', 'wb') as log:
        solver = subprocess.Popen([sys.executable, '-m', 'stepdiag_ros.nodes.evaluation_solver',
                                   '--ros-args', '-r', '__ns:=/again'], stdout=log, stderr=log)
    try:
        with Operator('/again') as operator:
            operator.bring('evaluation_solver', 'active')
            done = subprocess.run([*STEPDIAG, 'replay', str(bag), '--live', '--speed', '5', '--into',
                                   'again', '--wait', '60', '--json'], capture_output=True, text=True,
                                  timeout=200)
            assert done.returncode == 0, done.stderr
            assert json.loads(done.stdout)['acknowledged']
            live = operator.evaluate()
    finally:
        solver.terminate()
        solver.wait(30)
    assert same_result(live, json.loads(json.dumps(evaluate(read_log(bag)).to_json_dict())))


def test_replay_at_full_speed_prints_what_evaluate_finds(cell_file, tmp_path):
    bag = write_log(simulate_log(load_cell(cell_file)), tmp_path / 'log')
    done = subprocess.run([*STEPDIAG, 'replay', str(bag), '--json'], capture_output=True, text=True,
                          timeout=200)
    assert done.returncode == 0, done.stderr
    assert same_result(json.loads(done.stdout),
                       json.loads(json.dumps(evaluate(read_log(bag)).to_json_dict())))


def test_a_bag_that_exists_is_not_written_over(cell_file, tmp_path):
    done = subprocess.run([*STEPDIAG, 'calibrate', str(cell_file), '--bag', str(tmp_path)],
                          capture_output=True, text=True, timeout=120)
    assert done.returncode == 2 and 'exists already' in done.stderr and done.stderr.count('\n') == 1


def test_a_machine_that_is_not_up_is_said_before_anything_is_waited_for(ros_domain):
    done = subprocess.run([*STEPDIAG, 'calibrate', '/nosuch'], capture_output=True, text=True, timeout=120)
    assert done.returncode == 2 and done.stderr.count('\n') == 1
    assert 'no sequencer answers at /nosuch/run_step_diagonal; is the cell up?' in done.stderr
