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


def test_machines_take_turns(pair):
    cell, folder = pair
    left, right = cell.operator_of('/left'), cell.operator_of('/right')
    doing, outcomes = [], {}

    def measure(operator, name) -> None:
        outcomes[name] = operator.calibrate(dwell_s=0.5, feedback=lambda f: doing.append((name, f.doing)))
    threads = [threading.Thread(target=measure, args=pair) for pair in ((left, 'left'), (right, 'right'))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert {name: outcome.how for name, outcome in outcomes.items()} == {'left': 'succeeded', 'right': 'succeeded'}, \
        outcomes
    assert any(text.startswith('waiting for the light: place 1') for _, text in doing)
    usage = {v.key: v.value for v in left.health('multiplexer').values}
    assert int(usage['grants']) >= 2 * (1 + 4)      # a look before the start, four runs each
    for operator in (left, right):
        operator.bring('recorder', 'inactive')
    spans = []
    for name in ('log', 'log_right'):
        log = read_log(folder / name)
        assert len(log.steps) == 36 and len(log.displacement)
        assert not [w for w in log.warnings if 'hold no usable' in w or 'dwell' in w]
        times, run = log.steps.time_ns, log.steps.run
        spans += [(times[run == n].min(), times[run == n].max()) for n in set(run)]
    # Never two at once: no run of one machine overlaps one of the other.
    spans.sort()
    assert all(end <= begin for (_, end), (begin, _) in zip(spans, spans[1:], strict=False))
    assert read_log(folder / 'log_right').namespace == '/right'
