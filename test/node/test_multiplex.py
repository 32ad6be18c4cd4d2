"""Two machines behind one laser: each in its namespace, one at a time."""

import os
import signal
import subprocess
import sys
import threading
import time

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


def test_machines_wait_for_a_late_multiplexer_and_take_turns(pair, eventually):
    cell, folder = pair
    left, right = cell.operator_of('/left'), cell.operator_of('/right')
    doing, outcomes = [], {}
    late = cell.pids()['multiplexer']
    os.kill(late, signal.SIGKILL)     # as where machines are up before the multiplexer

    def measure(operator, name) -> None:
        outcomes[name] = operator.calibrate(dwell_s=0.5, feedback=lambda f: doing.append((name, f.doing)))
    threads = [threading.Thread(target=measure, args=pair) for pair in ((left, 'left'), (right, 'right'))]
    for thread in threads:
        thread.start()
    for name in ('left', 'right'):
        eventually(lambda name=name: any(of == name and text.startswith('waiting for the multiplexer')
                                         for of, text in doing))
    assert not outcomes
    cell.watch()      # starts it again
    seen = subprocess.run([sys.executable, '-m', 'stepdiag_ros.cli.main', 'watch', '--once'], capture_output=True,
                          text=True, timeout=120.0)
    for thread in threads:
        thread.join()
    assert {name: outcome.how for name, outcome in outcomes.items()} == {'left': 'succeeded', 'right': 'succeeded'}, \
        outcomes
    # In the terminal: who has the light, and how far each is.
    assert seen.returncode == 0 and all(word in seen.stdout for word in ('left', 'right', 'light')), seen
    assert any(text.startswith('waiting for the light: place 1') for _, text in doing)
    # A look before the start, four runs each; it says so once a second.
    eventually(lambda: int({v.key: v.value for v in left.health('multiplexer').values}['grants']) >= 2 * (1 + 4))
    for operator in (left, right):
        operator.bring('recorder', 'inactive')
    spans = []
    for name in ('log', 'log_right'):
        log = read_log(folder / name)
        assert len(log.steps) == 36 and len(log.displacement)
        # A sample that was answered late has no quality.
        assert not [w for w in log.warnings if 'dwell' in w and 'signal quality' not in w]
        times, run = log.steps.time_ns, log.steps.run
        spans += [(times[run == n].min(), times[run == n].max()) for n in set(run)]
    # Never two at once: no run of one machine overlaps one of the other.
    spans.sort()
    assert all(end <= begin for (_, end), (begin, _) in zip(spans, spans[1:], strict=False))
    assert read_log(folder / 'log_right').namespace == '/right'


def test_a_multiplexer_that_dies_is_started_again_and_never_two_have_the_light(pair):
    """Its queue dies with it: the holder's run is broken off and repeated, who waits asks anew, nobody is forgotten."""
    cell, folder = pair
    killed_s: list[float] = []
    outcomes = {}

    def measure(name: str) -> None:
        def feedback(told) -> None:
            # The first that measures has the light; the other waits for it.
            if told.stop >= 1 and told.doing.startswith(('X to', 'Y to', 'Z to')) and not killed_s:
                killed_s.append(time.monotonic())
                os.kill(cell.pids()['multiplexer'], signal.SIGKILL)
        outcomes[name] = cell.operator_of(f'/{name}').calibrate(dwell_s=1.5, feedback=feedback)
    threads = [threading.Thread(target=measure, args=(name,)) for name in ('left', 'right')]
    for thread in threads:
        thread.start()
    while any(thread.is_alive() for thread in threads):
        cell.watch()
        time.sleep(0.1)
    assert killed_s and cell.restarts == 1
    assert {name: outcome.how for name, outcome in outcomes.items()} == {'left': 'succeeded', 'right': 'succeeded'}, \
        {name: outcome.message for name, outcome in outcomes.items()}
    assert any('broken off' in outcome.message for outcome in outcomes.values())
    spans = []
    for name in ('left', 'right'):
        cell.operator_of(f'/{name}').bring('recorder', 'inactive')
        log = read_log(folder / ('log' if name == 'left' else 'log_right'))
        assert log.namespace == f'/{name}'
        # Each reading with a signal is of a run of its own machine: never two had the light.
        seen = log.displacement.time_ns[log.displacement.health > 0]
        times, run = log.steps.time_ns, log.steps.run
        spans += [(times[run == n].min(), times[run == n].max(), name) for n in sorted(set(run))]
        assert len(seen)
        assert {run_id.rsplit('/', 1)[0] if run_id.count('/') == 3 else run_id for run_id in log.steps.run_ids} == {
            'ppp/0/+', 'ppp/0/-', 'lin_x/0/+', 'lin_x/0/-'}
    spans.sort()
    assert all(end <= begin for (_, end, _), (begin, _, _) in zip(spans, spans[1:], strict=False)), spans
