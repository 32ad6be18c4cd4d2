"""The sealed world's effects: all of the vocabulary, forms of their own, acting in proportion."""

import numpy as np
import pytest

from stepdiag_ros.blind.forms_instrument import COUNTS, CountSlip
from stepdiag_ros.blind.hidden import ANY, Hidden, Stage, profile
from stepdiag_ros.blind.outsiders import OUTSIDERS
from stepdiag_ros.blind.vocabulary import NAMES, VOCABULARY
from stepdiag_ros.blind.world import LARGE, Order, draw_target, make
from stepdiag_ros.effects import VOCABULARY as CONTRACT
from test.some import some

ALL = [kind.name for kind in (*VOCABULARY, *OUTSIDERS)]


def test_vocabulary_is_the_contracts() -> None:
    assert NAMES == CONTRACT


def test_outside_is_outside() -> None:
    names = {kind.name for kind in OUTSIDERS}
    assert len(names) >= 10
    assert not names & set(CONTRACT)
    assert all(kind.outside for kind in OUTSIDERS)
    assert not any(kind.outside for kind in VOCABULARY)


@pytest.mark.parametrize('seed', range(12))
def test_time_profiles_start_at_zero_and_reach_one(seed: int) -> None:
    along, _ = profile(np.random.default_rng(seed), 1800.0)
    values = along(np.linspace(0.0, 1800.0, 400))
    assert values[0] == pytest.approx(0.0, abs=1e-12)
    assert np.ptp(values) == pytest.approx(1.0, abs=1e-9)


@pytest.mark.parametrize('name', some(*ALL[::12], later=ALL))
def test_every_effect_can_be_seen_and_leaves_a_whole_log(name: str) -> None:
    category = 'single' if name in NAMES else 'outside'
    made = make(Order('develop', 7, 1, category, (name,), 'field', small=True))
    entry = made.truth['effects'][0]
    assert entry['name'] == name
    assert entry['visibility']['total'] >= 3.0
    assert entry['size'] > 0.0
    assert sum(share['share'] for share in made.truth['shares']) == pytest.approx(1.0)
    assert np.isfinite(made.log.displacement.values).all()
    assert np.isfinite(made.log.spot.values).all()
    # The same noise acts with and without it: what differs is the effect alone.
    bare = made.yardstick.log
    assert len(bare.displacement) == len(made.log.displacement)
    assert not (np.array_equal(bare.displacement.values, made.log.displacement.values)
                and np.array_equal(bare.spot.values, made.log.spot.values)
                and np.array_equal(bare.displacement.time_ns, made.log.displacement.time_ns)
                and np.array_equal(bare.spot.time_ns, made.log.spot.time_ns))


def test_weather_of_the_topics_is_the_weather_that_acts() -> None:
    for number in range(1, 9):
        made = make(Order('develop', 7, number, 'single', ('air_refraction_drift',), 'field', small=True))
        if 'air_temperature' in made.log.environment:
            break
    else:
        pytest.fail('no log of eight holds the air topics; half of them should')
    effect: Hidden = made.effects[0]
    series = made.log.environment['air_temperature']
    before = made.yardstick.log.environment['air_temperature']
    seconds = (series.time_ns - series.time_ns[0]) * 1e-9
    warm, _, _ = effect.weather(seconds)
    np.testing.assert_allclose(series.value - before.value, warm, atol=1e-9)
    # The instrument keeps to one index of air.
    assert np.ptp(made.log.displacement.refractive_index) < 1e-12


def test_same_order_same_log() -> None:
    order = Order('develop', 7, 3, 'single', ('backlash',), 'varied', small=True)
    first, second = make(order), make(order)
    np.testing.assert_array_equal(first.log.displacement.values, second.log.displacement.values)
    assert first.truth == second.truth
    other = make(Order('sealed', 7, 3, 'single', ('backlash',), 'varied', small=True))
    assert other.truth['errors'] != first.truth['errors']


def test_null_log_holds_nothing_but_noise() -> None:
    made = make(Order('develop', 7, 5, 'null', (), 'field', small=True))
    assert made.truth['effects'] == []
    assert 'visibility' not in made.truth
    assert made.effects == ()


def wide_stage() -> Stage:
    """Six runs of a minute, two in each of three setups, with pauses."""
    begin = np.array([0.0, 70.0, 400.0, 470.0, 800.0, 870.0])
    return Stage(None, 930.0, np.stack([begin, begin + 60.0], axis=1), np.repeat(np.arange(3), 2), wide=True)


@pytest.mark.parametrize('seed', range(4))
@pytest.mark.parametrize('begins', ANY)
def test_profiles_of_wide_worlds_begin_as_drawn(begins: str, seed: int) -> None:
    stage = wide_stage()
    (along,), (kind,) = stage.profiles(np.random.default_rng(seed), 1, {begins: 1.0})
    starts = stage.runs[:, 0]
    assert along(np.zeros(1))[0] == pytest.approx(0.0, abs=1e-12)
    assert np.ptp(along(np.linspace(0.0, stage.span_s, 2000))) > 0.1
    again = {'run': starts, 'setup': starts[::2]}.get(begins)
    if again is not None:
        np.testing.assert_allclose(along(again), 0.0, atol=1e-12)
        assert np.all(np.abs(along(again + 30.0)) > 1e-6)
    if begins == 'door':
        assert not along(np.linspace(0.0, 0.15 * stage.span_s, 50)).any()
    if begins == 'jump':
        assert set(along(np.linspace(0.0, stage.span_s, 2000))) == {0.0, 1.0}
    if begins == 'rest':   # cools in the pause between two setups
        assert along(np.array([399.0]))[0] < along(np.array([129.0]))[0]
    assert kind.endswith(begins) or begins == 'log'


def test_slips_of_wide_worlds_are_whole_counts() -> None:
    made = make(Order('develop', 7, 6, 'single', ('count_slip',), 'field', small=True, wide=True))
    slip = made.effects[0]
    assert isinstance(slip, CountSlip)
    unit = made.truth['effects'][0]['count_m']
    assert unit in COUNTS
    change = (made.log.displacement.values - made.yardstick.log.displacement.values)[:, 0]
    np.testing.assert_allclose(change / unit, np.rint(change / unit), atol=1e-6)
    assert np.abs(change).max() > 0.9 * unit


def test_wide_worlds_hold_larger_effects() -> None:
    drawn = [[draw_target(np.random.default_rng(seed), False, wide) for seed in range(400)] for wide in (False, True)]
    assert max(drawn[0]) <= LARGE < max(drawn[1]) <= 4.0 * LARGE
