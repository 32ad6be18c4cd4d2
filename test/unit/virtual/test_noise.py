"""How noise falls: the distributions that a cell's noise_law states, and the same over the wire as simulated."""

from pathlib import Path

import numpy as np
import pytest
import yaml
from scipy import stats

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.model.log import DWELL, MOVE
from stepdiag_ros.virtual.cell import load_cell, parse_cell
from stepdiag_ros.virtual.cell_process import CellProcess
from stepdiag_ros.virtual.noise import NoiseLaw, NoiseLaws, Numbers, SensorNoise, Spread
from stepdiag_ros.virtual.offline import simulate_log

from .clients import clients

DEMO = Path(__file__).resolve().parents[3] / 'cells' / 'demo.yaml'
SIGMA = 2.0e-7
LAW = """
noise_law:
  displacement: {dof: 3, correlation: 0.6, quantum: 2.0e-9, dropouts: 0.1, burst: 8}
  spot: {dof: 4, correlation: 0.5, dropouts: 0.08, burst: 4, spikes: 0.02, spike_size: 40}
  position: {dof: 3, correlation: 0.7}
  angle: {correlation: -0.5}
"""


@pytest.mark.parametrize('dof', [2.5, 3.0, 10.0])
def test_tails_are_those_of_students_t_with_standard_deviation_one(dof):
    sample = Numbers(Spread(dof=dof), 1, 'x').draw(0, 40_000)[:, 0]
    scale = np.sqrt((dof - 2.0) / dof)
    assert stats.kstest(sample / scale, stats.t(dof).cdf).pvalue > 0.01
    assert stats.kstest(sample, stats.norm.cdf).pvalue < 1e-6 or dof > 9.0


@pytest.mark.parametrize('rho', [0.9, 0.5, -0.6])
def test_neighbours_correlate_as_an_autoregressive_process(rho):
    sample = Numbers(Spread(correlation=rho), 2, 'x').draw(0, 100_000, 2)
    assert np.abs(sample.std(axis=0) - 1.0).max() < 0.03
    for lag in (1, 2, 3):
        seen = np.corrcoef(sample[:-lag, 0], sample[lag:, 0])[0, 1]
        assert abs(seen - rho**lag) < 0.03
    assert abs(np.corrcoef(sample.T)[0, 1]) < 0.03   # the columns know nothing of each other


def test_a_correlated_number_depends_on_its_index_alone():
    spread = Spread(dof=3.0, correlation=0.8)
    whole = Numbers(spread, 3, 'x').draw(0, 500, 3)
    numbers = Numbers(spread, 3, 'x')
    parts = np.concatenate([numbers.draw(0, 7, 3), numbers.draw(7, 1, 3), numbers.draw(8, 92, 3)])
    np.testing.assert_array_equal(parts, whole[:100])
    np.testing.assert_array_equal(numbers.draw(40, 5, 3), whole[40:45])
    np.testing.assert_array_equal(numbers.draw(300, 200, 3), whole[300:])


def test_without_a_law_noise_is_normal_and_white():
    sensor = SensorNoise(NoiseLaw(), SIGMA, 4, 'spot')
    noise = sensor.readings(np.zeros((50_000, 1)), 0)[:, 0] / SIGMA
    assert stats.kstest(noise, stats.norm.cdf).pvalue > 0.01
    assert abs(np.corrcoef(noise[:-1], noise[1:])[0, 1]) < 0.02
    assert not sensor.dark(0, 1000).any() and not sensor.delays_ns(0, 1000).any()


def test_dropouts_come_in_bursts_of_the_stated_share():
    dark = SensorNoise(NoiseLaw(dropouts=0.08, burst=5), SIGMA, 5, 'spot').dark(0, 100_000)
    assert abs(dark.mean() - 0.08) < 0.006
    edges = np.flatnonzero(np.diff(np.concatenate([[0], dark.astype(int), [0]])))
    lengths = edges[1::2] - edges[::2]
    assert np.all(lengths % 5 == 0) and np.median(lengths) == 5


def test_spikes_duplicates_and_steps_have_their_shares_and_sizes():
    sensor = SensorNoise(NoiseLaw(spikes=0.01, spike_size=30.0), SIGMA, 6, 'spot')
    noise = sensor.readings(np.zeros((50_000, 1)), 0)[:, 0] / SIGMA
    far = np.abs(noise) > 15.0
    assert abs(far.mean() - 0.01) < 0.002 and abs(np.abs(noise[far]).mean() - 30.0) < 0.5
    assert 0.3 < (noise[far] > 0).mean() < 0.7
    sensor = SensorNoise(NoiseLaw(duplicates=0.2), SIGMA, 6, 'spot')
    parts = np.concatenate([sensor.readings(np.zeros((100, 1)), k) for k in range(0, 20_000, 100)])
    assert abs((np.diff(parts[:, 0]) == 0.0).mean() - 0.2) < 0.01
    coarse = SensorNoise(NoiseLaw(quantum=SIGMA), SIGMA, 6, 'spot').readings(np.zeros((1000, 1)), 0, 0.3 * SIGMA)
    steps = (coarse + 0.3 * SIGMA) / SIGMA
    np.testing.assert_allclose(steps, np.rint(steps), atol=1e-9)


def test_late_samples_show_where_the_machine_was():
    sensor = SensorNoise(NoiseLaw(late=0.25, delay=0.004), SIGMA, 7, 'spot')
    late = sensor.delays_ns(0, 40_000)
    assert abs((late > 0).mean() - 0.25) < 0.01
    assert abs(late[late > 0].mean() - 2.0e6) < 5e4 and late.max() <= 4_000_000


def test_late_samples_reach_the_simulated_log():
    text = DEMO.read_text()
    plain = simulate_log(parse_cell(text, str(DEMO)), setups=('lin_x',))
    late = simulate_log(parse_cell(text + 'noise_law: {displacement: {late: 1.0, delay: 0.004}}', str(DEMO)),
                        setups=('lin_x',))
    np.testing.assert_array_equal(plain.displacement.time_ns, late.displacement.time_ns)
    np.testing.assert_array_equal(plain.spot.values, late.spot.values)   # the other sensor is as it was
    move = (plain.steps.time_ns[plain.steps.phase == MOVE][1], plain.steps.time_ns[plain.steps.phase == DWELL][1])
    inside = (plain.displacement.time_ns > move[0]) & (plain.displacement.time_ns < move[1])
    difference = plain.displacement.values[inside, 0] - late.displacement.values[inside, 0]
    assert difference.max() > 1e-4   # at 0.5 m/s up to 4 ms are up to 2 mm


def test_arrivals_follow_their_law():
    cell = parse_cell(DEMO.read_text() + 'noise_law: {position: {correlation: 0.9}}', str(DEMO))
    assert cell.noise_law == NoiseLaws(position=Spread(correlation=0.9))
    sample = Numbers(cell.noise_law.position, cell.seed, 'position').draw(0, 4000, 3)
    assert abs(np.corrcoef(sample[:-1, 1], sample[1:, 1])[0, 1] - 0.9) < 0.03


@pytest.mark.parametrize(('text', 'named'), [
    ('noise_law: {spot: {dof: 2}}', 'noise_law.spot.dof'), ('noise_law: {spot: {burst: 0}}', 'noise_law.spot.burst'),
    ('noise_law: {position: {quantum: 1e-9}}', 'noise_law.position'), ('noise_law: {beam: {}}', 'noise_law'),
    ('noise_law: {displacement: {dropouts: 1.5}}', 'noise_law.displacement.dropouts'),
    ('noise_law: {displacement: {correlation: 1.0}}', 'noise_law.displacement.correlation')])
def test_a_law_that_cannot_be_is_refused_by_its_key(text, named):
    with pytest.raises(StepdiagError, match=named):
        parse_cell(DEMO.read_text() + text, str(DEMO))


def _summary(values: np.ndarray, dark: np.ndarray) -> dict[str, float]:
    """What a law shows in readings at rest: shares, tails, correlation."""
    good = values[~dark]
    middle = np.median(good)
    scale = np.median(np.abs(good - middle))
    pairs = ~dark[:-1] & ~dark[1:]
    rank = stats.spearmanr(values[:-1][pairs], values[1:][pairs]).statistic
    return {'dark': dark.mean(), 'scale': scale, 'tails': np.mean(np.abs(good - middle) > 6.0 * scale), 'rank': rank}


def test_over_the_wire_noise_falls_as_it_does_in_simulation(tmp_path):
    file = tmp_path / 'cell.yaml'
    file.write_text(yaml.safe_dump(yaml.safe_load(DEMO.read_text()) | yaml.safe_load(LAW)))
    cell = load_cell(file)
    with (CellProcess(file, tmp_path / 'runtime') as process,
          clients(process.start(), 'ppp') as (_, meter, detector)):
        meter.reset()
        lengths, spots = [], []
        while sum(len(block.quality) for block in lengths) < 4000:
            lengths.append(meter.read_block(200, 1e-3))
        while sum(len(block.x_m) for block in spots) < 4000:
            spots.append(detector.read_block(200, 1e-3))
    length = np.concatenate([block.displacement_m[:, 0] for block in lengths])
    live = {'displacement': _summary(length, np.concatenate([block.quality for block in lengths]) == 0)}
    spot = np.concatenate([block.x_m for block in spots])
    live['spot'] = _summary(np.nan_to_num(spot), np.isnan(spot))
    # At rest a simulated log is the truth and the same noise.
    for name, sigma, columns in (('displacement', 5e-9, 1), ('spot', 2e-7, 2)):
        law = getattr(cell.noise_law, name)
        sensor = SensorNoise(law, sigma, cell.seed, name)
        said = _summary(sensor.readings(np.zeros((20_000, columns)), 0)[:, 0], sensor.dark(0, 20_000))
        assert abs(live[name]['dark'] - said['dark']) < 0.03
        assert abs(live[name]['scale'] / said['scale'] - 1.0) < 0.1
        assert abs(live[name]['tails'] - said['tails']) < 0.015
        assert abs(live[name]['rank'] - said['rank']) < 0.08
    simulated = simulate_log(cell, setups=('ppp',))
    assert abs(np.mean(simulated.displacement.health == 0) - 0.1) < 0.03
    assert abs(np.isnan(simulated.spot.values[:, 0]).mean() - 0.08) < 0.03
