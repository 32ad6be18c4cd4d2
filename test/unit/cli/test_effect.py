"""``stepdiag effect check``: the guide's example passes, its mistakes do not."""

import json
from pathlib import Path

import pytest

from stepdiag_ros.cli.main import main
from stepdiag_ros.twin import effect_check
from test.some import some

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture
def example(tmp_path):
    text = (ROOT / 'docs' / 'how-to' / 'add_an_effect.md').read_text(encoding='utf-8')
    path = tmp_path / 'spindle_growth.py'
    path.write_text(text.split('```python\n')[1].split('```')[0], encoding='utf-8')
    return path


@pytest.mark.parametrize('steps', some(2, later=[4]))
def test_the_example_passes_and_says_with_what_it_is_confounded(example, capsys, monkeypatch, steps):
    """In the cell of the check, and in the same cell with half the steps."""
    monkeypatch.setattr(effect_check, 'CELL', effect_check.CELL.replace('steps: 4', f'steps: {steps}'))
    assert main(['effect', 'check', str(example), '--json']) == 0
    (found,) = json.loads(capsys.readouterr().out)['effects']
    assert found['passed'] and not found['problems']
    assert found['ratio'] == pytest.approx(1.0, abs=0.05)
    assert 'structural_thermal_drift' in found['confounded']


@pytest.mark.long
def test_a_course_from_the_first_dwell_on_is_not_passed(example, capsys):
    example.write_text(example.read_text().replace('view.elapsed', 'view.time'))
    assert main(['effect', 'check', str(example)]) == 1
    said = capsys.readouterr().out
    assert 'its code is run' in said and 'NOT PASSED' in said and 'amp is estimated 0.3' in said


def test_a_wrong_shape_is_one_line(example, capsys):
    example.write_text(example.read_text().replace('view.by_shift[2:]', 'view.by_shift[2]'))
    assert main(['effect', 'check', str(example)]) == 2
    said = capsys.readouterr().err
    assert said.count('\n') == 1 and 'SpindleGrowth.appearance' in said


def test_a_batch_goes_on_after_a_nan_in_one_bag(example, tmp_path, capsys):
    """The effect gives NaN for the log that has a line along X only."""
    from stepdiag_ros.bag.export import write_log
    from stepdiag_ros.twin.effect_check import CELL
    from stepdiag_ros.virtual.cell import parse_cell
    from stepdiag_ros.virtual.offline import simulate_log

    example.write_text(example.read_text().replace(
        'along_z = -view.by_shift[2:]', "along_z = -view.by_shift[2:] * (np.nan if len(view.run_ids) == 4 else 1.0)"))
    cell = parse_cell(CELL, 'cell.yaml')
    for name, setups in (('bad', ('lin_x',)), ('good', ('ppp', 'npp', 'pnp', 'nnp'))):
        write_log(simulate_log(cell, setups=setups), tmp_path / name)
    status = main(['gap', str(tmp_path / 'bad'), str(tmp_path / 'good'), '--effect', str(example),
                   '--out', str(tmp_path / 'out')])
    said = capsys.readouterr()
    assert status == 2
    assert 'SpindleGrowth.appearance' in said.err and 'not finite' in said.err and 'Traceback' not in said.err
    assert (tmp_path / 'out' / 'good' / 'gap.json').is_file() and not (tmp_path / 'out' / 'bad' / 'gap.json').exists()
