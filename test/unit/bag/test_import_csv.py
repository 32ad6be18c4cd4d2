"""CSV tables become contract logs."""

import numpy as np
import pytest

from stepdiag_ros.bag.export import write_log
from stepdiag_ros.bag.import_csv import import_csv
from stepdiag_ros.bag.reader import read_log
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.model.log import DWELL, NONE
from stepdiag_ros.model.path import stops

HEAD = 'cycle,direction,target_mm,measured_mm\n'


def table(tmp_path, text: str, name: str = 'stage_x.csv'):
    file = tmp_path / name
    file.write_text(text, encoding='utf-8')
    return file


def said(result, *parts: str) -> bool:
    return any(all(p in note for p in parts) for note in result.notes)


@pytest.mark.parametrize(('name', 'setup', 'planned', 'reversal_um'), [
    ('stage_a_x', 'lin_x', 9, 33.6), ('stage_a_z', 'lin_z', 5, 2.4), ('stage_b_x_back', 'lin_x', 5, None)])
def test_measured_stages_keep_their_reversal(tmp_path, shared, differs, name, setup, planned, reversal_um):
    """Cycle drift and reversal survive: the reversal error is that of the published evaluation."""
    result = import_csv(shared / 'real_data' / f'{name}.csv')
    bag = write_log(result.log, tmp_path / name)
    log = read_log(bag)
    assert differs(result.log, log) == []
    assert [w for w in log.warnings if 'psd/spot' not in w] == []
    assert log.steps.run_ids == (f'{setup}/0',) and log.description.setups[setup].stops == planned
    rows = np.genfromtxt(shared / 'real_data' / f'{name}.csv', delimiter=',', names=True)
    measured = log.displacement.values[:, 0]
    assert np.allclose(measured, (rows['measured_mm'] - rows['measured_mm'][0]) * 1e-3, atol=1e-15, rtol=0)
    if reversal_um is not None:
        at = log.steps.phase == DWELL
        index, direction = log.steps.index[at], log.steps.direction[at]
        mean = {(i, d): measured[(index == i) & (direction == d)].mean()
                for i in range(planned) for d in (-1, 1)}
        reversal = max(abs(mean[i, 1] - mean[i, -1]) for i in range(planned)) * 1e6
        assert reversal == pytest.approx(reversal_um, abs=0.15)


def test_stops_are_those_of_the_model(tmp_path, shared):
    """What is commanded is where the contract's own path has the stop."""
    log = import_csv(shared / 'real_data' / 'stage_a_x.csv').log
    path = stops(log.description, 'lin_x')
    assert np.allclose(log.steps.commanded, path.positions[log.steps.index], atol=1e-12)
    assert log.steps.axis[0] == NONE and set(log.steps.axis[3:].tolist()) == {0}


def test_choices_are_said(tmp_path):
    text = HEAD + '1,1,-20,-20.1\n1,1,0,0\n1,1,20,20.1\n1,-1,20,20.1\n1,-1,0,0.02\n1,-1,-20,-20.1\n'
    result = import_csv(table(tmp_path, text))
    assert said(result, 'axis X', 'guessed') and said(result, 'shifted by +20 mm')
    assert said(result, 'times are made up', '10 s') and said(result, 'one run')
    assert np.diff(result.log.displacement.time_ns).tolist() == [10_000_000_000] * 5
    assert not said(import_csv(table(tmp_path, text), axis='Y'), 'guessed')


def test_units_deviation_and_real_times(tmp_path):
    """The same measurement in other words is the same log."""
    one = import_csv(table(tmp_path, HEAD + '1,1,0,0.001\n1,1,10,10.002\n1,1,20,20.004\n'))
    two = import_csv(table(tmp_path, '# a comment\n\ntime_s;target_um;deviation_nm\n'
                           '5;0;1000\n15;10000;2000\n25;20000;4000\n'))
    assert np.allclose(one.log.displacement.values, two.log.displacement.values, atol=1e-15)
    assert np.array_equal(one.log.displacement.time_ns, two.log.displacement.time_ns)
    assert not said(two, 'made up') and said(two, 'no column direction') and said(two, 'no column cycle')


def test_directions_and_cycles_from_the_order(tmp_path, shared):
    """Left out, the columns come back as they were."""
    file = shared / 'real_data' / 'stage_a_x.csv'
    full = import_csv(file).log
    bare = '\n'.join(','.join(line.split(',')[2:]) for line in file.read_text().split())
    less = import_csv(table(tmp_path, bare + '\n')).log
    for key in ('direction', 'repeat', 'index'):
        assert np.array_equal(getattr(full.steps, key), getattr(less.steps, key)), key


def test_reference_at_the_other_end_is_turned_round(tmp_path):
    result = import_csv(table(tmp_path, HEAD + '1,1,0,5\n1,1,10,-5\n1,1,20,-15\n'))
    assert said(result, 'turned round')
    assert result.log.displacement.values[:, 0].tolist() == pytest.approx([0.0, 0.010, 0.020])
    assert said(import_csv(table(tmp_path, HEAD + '1,1,0,0\n1,1,1,1000\n')), 'check the units')


def test_noise_is_that_of_the_table(tmp_path):
    """Last digit for a reading, spread of the repeats for an arrival."""
    rows = ''.join(f'{c},1,{t},{t + (0.001 if c % 2 else -0.001):.4f}\n' for c in (1, 2) for t in (0, 10))
    noise = import_csv(table(tmp_path, HEAD + rows)).log.description.noise
    assert noise.displacement == pytest.approx(1e-7 / 12 ** 0.5)
    assert noise.position_repeatability == pytest.approx(np.std([1e-6, -1e-6], ddof=1))


@pytest.mark.parametrize(('text', 'complaint'), [
    ('', r'is empty'),
    (HEAD, r'has 0 measurement'),
    (HEAD + '1,1,0,0\n', r'has 1 measurement'),
    ('cycle,direction,target,measured_mm\n1,1,0,0\n', r"column 'target' has no unit"),
    ('target_inch,measured_mm\n0,0\n1,1\n', r"column 'target_inch' has no unit that is known"),
    ('target_mm,measured_mm,spindle\n0,0,1\n', r"column 'spindle' is not known"),
    ('target_mm,target_um,measured_mm\n0,0,1\n', r'column target is there twice'),
    ('measured_mm\n0\n1\n', r'target_<unit> is missing'),
    ('target_mm\n0\n1\n', r'one of the columns measured'),
    ('target_mm,measured_mm,deviation_mm\n0,0,0\n', r'one of the columns measured'),
    (HEAD + '1,1,0,0\n1,1,ten,10\n', r"line 3: target_mm is 'ten'"),
    (HEAD + '1,1,0,0\n1,1,10,nan\n', r"line 3: measured_mm is 'nan'"),
    (HEAD + '1,1,0,0\n1,1,10\n', r'line 3 has 3 columns, the first line names 4'),
    (HEAD + '1,1,0,0\n1,2,10,10\n', r'line 3: direction must be'),
    (HEAD + '1,1,5,0\n1,1,5,10\n', r'all targets are alike'),
    (HEAD + '1,1,0,0\n1,1,10,10\n1,1,25,25\n', r'target 10 mm is off the even spacing'),
    ('time_s,target_mm,measured_mm\n1,0,0\n1,10,10\n', r'time_s must rise')])
def test_bad_tables(tmp_path, text, complaint):
    with pytest.raises(StepdiagError, match=complaint) as error:
        import_csv(table(tmp_path, text))
    assert '\n' not in str(error.value)


def test_other_mistakes(tmp_path):
    good = HEAD + '1,1,0,0\n1,1,10,10\n'
    with pytest.raises(StepdiagError, match=r'does not tell the axis.*--axis'):
        import_csv(table(tmp_path, good, 'stage.csv'))
    with pytest.raises(StepdiagError, match='--axis'):
        import_csv(table(tmp_path, good), axis='w')
    with pytest.raises(StepdiagError, match='--cadence'):
        import_csv(table(tmp_path, good), cadence_s=0.0)
    with pytest.raises(StepdiagError, match='cannot be read'):
        import_csv(tmp_path / 'none_x.csv')
    (tmp_path / 'bytes_x.csv').write_bytes(b'\xff\xfe\x00target')
    with pytest.raises(StepdiagError, match='not a text file'):
        import_csv(tmp_path / 'bytes_x.csv')
