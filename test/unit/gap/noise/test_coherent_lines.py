"""Lines that keep their phase from dwell to dwell: found far below the noise, not confused with noise, moves, air."""

import numpy as np
import pytest

from stepdiag_ros.gap.constants import COHERENT_ALARM, GROWS
from stepdiag_ros.gap.noise.coherent_lines import find_coherent_lines
from stepdiag_ros.gap.noise.incoherent_lines import find_lines
from stepdiag_ros.gap.preprocess.dwells import dwells_of

RUNS, COUNT, SIZE, PERIOD_S = 6, 50, 30, 0.02
PATH_M = np.tile(np.linspace(0.3, 1.7, COUNT), RUNS)
RUN = np.repeat(np.arange(RUNS), COUNT)


def _times(seed=1):
    """Dwells of 0.6 s every 2 s or so, as moves of unequal length leave them, of samples that an instrument takes at
    its own pace; (RUNS · COUNT, SIZE) [s]."""
    begin = np.cumsum(1.6 + 0.4 * np.random.default_rng(seed).random(RUNS * COUNT))
    return PERIOD_S * (np.rint(begin[:, None] / PERIOD_S) + np.arange(SIZE))


def _swing(hertz, wander=0.0, seed=4):
    """A unit swing in the time of the log; ``wander``: standard deviation [rad] of its phase from dwell to dwell."""
    phase = wander * np.cumsum(np.random.default_rng(seed).standard_normal((RUNS * COUNT, 1)), axis=0)
    return np.sin(2.0 * np.pi * hertz * _times() + phase)


def _dwells(extra=0.0, seed=3):
    """Dwells of unit noise with ``extra`` (RUNS · COUNT, SIZE) on top."""
    values = np.random.default_rng(seed).standard_normal((RUNS * COUNT, SIZE)) + extra
    rows = np.arange(RUNS * COUNT)[:, None] * SIZE + np.array([0, SIZE])
    time_ns = np.rint(_times() * 1e9).astype(np.int64)
    return dwells_of(values.ravel(), time_ns.ravel(), rows, np.arange(RUNS * COUNT) % 6, time_ns[:, 0])


def _found(dwells):
    return find_coherent_lines(dwells, RUN, PATH_M, COHERENT_ALARM)


def test_white_noise_stays_well_below_the_alarm():
    assert max(_found(_dwells(seed=seed)).log_bayes for seed in range(20)) < COHERENT_ALARM - 4.0


@pytest.mark.parametrize('hertz', [4.3, 11.7, 22.3])
def test_a_line_is_found_where_no_dwell_shows_it(hertz):
    dwells = _dwells(0.15 * _swing(hertz))
    assert find_lines(dwells)[0].log_bayes < 3.0
    found = _found(dwells)
    assert found.log_bayes > COHERENT_ALARM and found.log_growth < 0.0
    assert found.frequency == pytest.approx(hertz, abs=0.01)
    assert found.amplitude == pytest.approx(0.15, abs=4.0 * found.sigma)


def test_a_frequency_above_half_the_sampling_rate_is_seen_as_its_alias():
    assert _found(_dwells(0.15 * _swing(43.3))).frequency == pytest.approx(50.0 - 43.3, abs=0.01)


def test_a_phase_that_wanders_in_seconds_is_followed_over_a_few_dwells():
    found = _found(_dwells(0.4 * _swing(11.7, wander=0.4)))
    assert found.log_bayes > COHERENT_ALARM
    assert found.frequency == pytest.approx(11.7, abs=0.1)


def test_a_smooth_background_is_no_line():
    rng = np.random.default_rng(8)
    walk = np.cumsum(rng.standard_normal((RUNS * COUNT, SIZE)), axis=1)
    assert max(_found(_dwells(size * walk)).log_bayes for size in (0.1, 1.0)) < COHERENT_ALARM - 4.0


def test_what_moves_leave_at_the_pace_of_the_moves_is_no_line():
    left = 3.0 * np.exp(-np.arange(SIZE) / 5.0)[None] * np.where(np.arange(RUNS * COUNT) % 6 < 3, 1.0, -0.5)[:, None]
    assert _found(_dwells(left)).log_bayes < COHERENT_ALARM - 4.0


def test_a_swing_that_grows_with_the_path_is_told_from_one_that_does_not():
    near, far = (_found(_dwells(0.25 * _swing(4.3) * size)) for size in (1.0, PATH_M[:, None]))
    assert far.log_bayes > COHERENT_ALARM and far.log_growth > GROWS
    assert near.log_growth < -GROWS


def test_runs_seen_from_other_sides_may_have_other_amplitudes():
    side = np.array([1.0, -0.6, 0.1, 0.8, -1.0, 0.3])[RUN][:, None]
    assert _found(_dwells(0.25 * side * _swing(11.7))).frequency == pytest.approx(11.7, abs=0.01)
