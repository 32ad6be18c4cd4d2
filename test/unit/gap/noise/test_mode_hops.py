"""Mode hops: steps inside dwells, distinguished from slips, from what settles and from noise."""

from types import SimpleNamespace

import numpy as np
import pytest

from stepdiag_ros.effects.base import Effect, Moment
from stepdiag_ros.gap.noise.mode_hops import mode_hops, steps

COUNT, SIZE, PERIOD_NS = 200, 20, 20_000_000
DISTANCE = np.linspace(0.3, 1.2, COUNT)
NOISE = 4e-9


def _seen(inside=0.0, seed=3):
    """Mode hops found in white dwells with ``inside`` (COUNT, SIZE) [m] on top."""
    values = NOISE * np.random.default_rng(seed).standard_normal((COUNT, SIZE)) + inside
    begin = np.arange(COUNT) * 3 * SIZE * PERIOD_NS
    rows = np.arange(COUNT)[:, None] * SIZE + np.array([0, SIZE])
    table = SimpleNamespace(displacement_rows=rows, dwell_ns=begin, done_ns=begin + SIZE * PERIOD_NS)
    return mode_hops(SimpleNamespace(values=values.reshape(-1, 1)), table, DISTANCE)


def _steps(sizes):
    """Steps of ``sizes`` [m by stop] in the middle of some dwells."""
    inside = np.zeros((COUNT, SIZE))
    for row, size in sizes.items():
        inside[row, SIZE // 2:] = size
    return inside


def test_steps_of_one_share_of_the_length_are_hops():
    rows = (20, 70, 71, 130, 190)
    seen = _seen(_steps({row: (-1) ** row * 1e-7 * DISTANCE[row] for row in rows}))
    assert tuple(seen.rows) == rows
    assert seen.unit == pytest.approx(1e-7, rel=0.05)
    assert np.all(np.diff(seen.step) > 0.0)


@pytest.mark.parametrize('sizes', [{}, {20: 4e-8, 70: -4e-8, 190: 4e-8}, {20: 5e-8, 190: 3e-8}, {70: 1e-7}],
                         ids=['noise', 'one amount', 'any amounts', 'a single step'])
def test_noise_and_slips_are_no_hops(sizes):
    assert _seen(_steps(sizes)) is None


def test_samples_that_go_with_those_before_them_are_no_steps():
    """Alike by 0.78, now and then far off: a null log had two 'hops'.  Taken for white three dwells stepped,
    made white ten, for a sample that is far off takes those after it along."""
    rng = np.random.default_rng(4)
    values = np.zeros((2 * COUNT, SIZE))
    fresh = rng.standard_t(4.2, values.shape)
    values[:, 0] = fresh[:, 0] / np.sqrt(1.0 - 0.78**2)
    for k in range(1, SIZE):
        values[:, k] = 0.78 * values[:, k - 1] + fresh[:, k]
    rows = np.arange(2 * COUNT)[:, None] * SIZE + np.array([0, SIZE])
    found = steps(NOISE * values.ravel(), SimpleNamespace(displacement_rows=rows))
    assert len(found[0]) <= 1


def test_what_settles_is_no_hop():
    settling = np.exp(-np.arange(SIZE) / 3.0) * 1e-7 * DISTANCE[:, None]
    assert _seen(settling) is None


class Hopping(Effect):
    """A laser that hops between two units forty times in a log."""

    def after_light(self, moment: Moment) -> None:
        other = np.floor(moment.seconds / 21.7) % 2
        moment.length = moment.length * (1.0 + 4e-7 * other)[:, None]


def test_a_laser_that_hops_has_no_name(case):
    diagnosis = case.diagnose(Hopping())
    assert diagnosis.verdict == 'unexplained'
    assert 'hop' in diagnosis.unmodelled
