"""ISO 230-2 on numbers by hand and on measured stages."""

import numpy as np
import pytest

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.estimate.iso230_2 import evaluate, from_rows


def stage(file):
    cycle, direction, target, measured = np.loadtxt(file, delimiter=',', skiprows=1, unpack=True)
    return from_rows(cycle, direction, target * 1e-3, measured * 1e-3, fit_reference=True)


def test_by_hand():
    # Up: 0 ± 1, 2 ± 1 (s = √2); down: 1 ± 0, 5 ± 2 (s = 0, 2√2)
    up, down = [[-1.0, 1.0], [1.0, 3.0]], [[1.0, 3.0], [1.0, 7.0]]
    result = evaluate([0.0, 1.0], up, down)
    root = np.sqrt(2.0)
    assert result.B == 3.0
    assert result.mean_reversal == -2.0
    assert result.M == 3.0
    assert (result.E, result.E_up, result.E_down) == (5.0, 2.0, 4.0)
    assert result.R_up == pytest.approx(4 * root)
    assert result.R_down == pytest.approx(8 * root)
    # Target 1: 2√2 + 4√2 + 3 = 11.49 against R_i↓ = 8√2 = 11.31.
    assert result.R == pytest.approx(6 * root + 3.0)
    assert result.A == pytest.approx(5 + 4 * root - (0 - 2 * root))
    assert result.A_up == pytest.approx(2 + 4 * root)


@pytest.mark.parametrize(('name', 'reversal_um'), [('stage_a_x', 33.6), ('stage_a_z', 2.4)])
def test_published_reversal_of_real_stages(shared, name, reversal_um):
    result = stage(shared / 'real_data' / f'{name}.csv')
    assert result.runs == 5
    assert result.B * 1e6 == pytest.approx(reversal_um, abs=0.05)
    assert result.E >= result.B
    assert result.A > result.E


def test_scale_and_zero_of_the_reference_do_not_matter():
    rng = np.random.default_rng(2)
    cycle = np.repeat(np.arange(3), 10)
    direction = np.tile(np.repeat([1, -1], 5), 3)
    target = np.tile(np.linspace(0.0, 0.2, 5), 6)
    measured = target + rng.normal(0.0, 1e-6, 30) + 2e-6 * direction
    plain = from_rows(cycle, direction, target, measured, fit_reference=True)
    turned = from_rows(cycle, direction, target, 1.02 * measured - 0.3, fit_reference=True)
    for figure in 'AERBM':
        assert getattr(turned, figure) == pytest.approx(getattr(plain, figure), rel=1e-9)


def test_single_run_has_no_repeatability():
    result = evaluate([0.0, 1.0], [0.0, 1.0], [0.0, 2.0])
    assert result.R is None
    assert result.A is None
    assert result.E == 2.0


def test_bad_input_is_named():
    with pytest.raises(StepdiagError, match='2 runs up but 1 down'):
        evaluate([0.0], [[0.0], [0.0]], [[0.0]])
    with pytest.raises(StepdiagError, match='no complete cycle in direction -1'):
        from_rows([1, 1], [1, 1], [0.0, 1.0], [0.0, 1.0])
    with pytest.raises(StepdiagError, match='not a number'):
        evaluate([0.0, 1.0], [[0.0, np.nan]], [[0.0, 1.0]])


def test_cycles_with_zeros_of_their_own_do_not_enlarge_r():
    """Arrivals that err independently, each cycle counted from its own first one: s is theirs again, R too."""
    rng, cycles, targets = np.random.default_rng(4), 5, 6
    found, plain, true = [], [], []
    for _ in range(400):
        up, down = rng.normal(0.0, 1e-6, (2, cycles, targets))
        down[:, -1] = up[:, -1]     # the way down begins where the way up ended
        place = np.arange(targets) * 0.1
        zero = up[:, :1]
        free = evaluate(place, up, down)
        own, naive = evaluate(place, up - zero, down - zero, zeroed=True), evaluate(place, up - zero, down - zero)
        found.append([np.mean(own.s_up**2), np.mean(own.s_down**2), own.R])
        plain.append(naive.R)
        true.append([np.mean(free.s_up**2), np.mean(free.s_down**2), free.R])
        assert own.B == pytest.approx(naive.B, abs=1e-15) and own.E == pytest.approx(naive.E, abs=1e-15)
    found, true = np.mean(found, axis=0), np.mean(true, axis=0)
    assert found == pytest.approx(true, rel=0.03)
    assert np.mean(plain) > 1.25 * true[2]      # what a third too large is made of
