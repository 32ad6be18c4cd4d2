"""Visibility: the norm in parity space, held against a brute-force fit and against chance."""

from dataclasses import replace

import numpy as np
import pytest

from stepdiag_ros.blind.cells import draw_cell, without_sensor_noise
from stepdiag_ros.blind.forms_machine import Backlash, ClockSkew
from stepdiag_ros.blind.logs import measure, stage_of
from stepdiag_ros.blind.visibility import Yardstick, _timed, true_parameters
from stepdiag_ros.blind.world import Order, make
from stepdiag_ros.estimate.enhanced import fit, readings_of
from stepdiag_ros.estimate.forward import ForwardModel
from stepdiag_ros.estimate.noise import NoiseModel, sensor_noise


@pytest.fixture(scope='module')
def scene():
    rng = np.random.default_rng(11)
    cell, conditions = draw_cell(rng, 'field', small=True)
    log = measure(cell, conditions)
    effect = Backlash(stage_of(cell, log, conditions.start_ns), rng)
    effect.size = 1.5e-6
    return cell, conditions, Yardstick(cell, log), effect


def white(yardstick: Yardstick, left: np.ndarray) -> np.ndarray:
    return np.concatenate([w(left.ravel()) for w in yardstick.white])


def test_truth_predicts_the_log(scene) -> None:
    cell, _, yardstick, _ = scene
    model = ForwardModel(cell.description, yardstick.table, yardstick.parameters)
    theta = true_parameters(cell, yardstick.parameters)
    apart = readings_of(yardstick.table) - model.predict(theta)
    spots = apart[:, -2:]
    # Spots need no reset: what is left is the repeatability of the attitude over some metres.
    assert np.abs(spots).max() < 2e-5
    assert np.abs(spots).max() > 0.0


def test_visibility_is_the_rise_of_chi_square(scene) -> None:
    cell, conditions, yardstick, effect = scene
    log = measure(cell, conditions, [effect])
    seen = yardstick.visibility(log)
    noise = NoiseModel(cell.description.noise.position_repeatability,
                       cell.description.noise.angle_repeatability,
                       sensor_noise(yardstick.table, cell.description.noise), 'belief')
    # Twice the effect and none of it, same noise: the cross terms cancel in the second difference.
    readings = readings_of(yardstick.table)
    delta = yardstick.change(log)
    chi2 = [fit(cell.description, yardstick.table, noise=noise, readings=readings + k * delta).chi2
            for k in (-1.0, 0.0, 1.0)]
    power = 0.5 * (chi2[0] + chi2[2]) - chi2[1]
    assert seen.total == pytest.approx(np.sqrt(power), rel=0.02)
    assert seen.total == seen.stops


def test_what_the_fit_can_imitate_is_not_seen(scene) -> None:
    cell, _, yardstick, _ = scene
    model = ForwardModel(cell.description, yardstick.table, yardstick.parameters)
    theta = true_parameters(cell, yardstick.parameters)
    _, jacobian, _ = model.jacobian(theta)
    rng = np.random.default_rng(3)
    step = 1e-6 * rng.standard_normal(yardstick.parameters.size)
    imitated = (jacobian @ step).reshape(readings_of(yardstick.table).shape)
    plain = np.linalg.norm(white(yardstick, imitated))
    left = np.linalg.norm(white(yardstick, yardstick.left(imitated)[0]))
    assert plain > 10.0
    assert left < 0.02 * plain


@pytest.mark.long
def test_what_is_left_is_what_a_fit_without_noise_leaves() -> None:
    """Also where turns of beam and mirror act to second order, and the Jacobian at the truth misleads tenfold."""
    made = make(Order('sealed', 20261129, 617, 'single', ('scale_thermal_expansion',)))
    yardstick, description = made.yardstick, made.cell.description
    delta, theta = yardstick.change(made.log), true_parameters(made.cell, yardstick.parameters)
    model = ForwardModel(description, yardstick.table, yardstick.parameters)
    present = np.isfinite(readings_of(yardstick.table))
    noise = NoiseModel(description.noise.position_repeatability, description.noise.angle_repeatability,
                       sensor_noise(yardstick.table, description.noise), 'belief')
    whole = fit(description, yardstick.table, noise, np.where(present, model.predict(theta) + delta, np.nan), theta)
    left = np.linalg.norm(white(yardstick, yardstick.left(delta)[0]))
    assert left == pytest.approx(np.sqrt(whole.chi2), rel=0.02)
    _, jacobian, _ = model.jacobian(theta)
    straight = delta.ravel() - jacobian @ (whole.theta - theta)
    assert np.linalg.norm(white(yardstick, straight)) > 5.0 * left


def test_visibility_grows_with_size(scene) -> None:
    cell, conditions, yardstick, effect = scene
    values = []
    for size in (1e-6, 3e-6):
        effect.size = size
        values.append(yardstick.visibility(measure(cell, conditions, [effect])).total)
    effect.size = 1.5e-6
    assert values[1] == pytest.approx(3.0 * values[0], rel=0.05)


def test_wrong_stamps_are_no_exchange_of_noise(scene) -> None:
    """Stamps off by so little that no dwell shows a move: nothing is seen inside the dwells, and in motion only
    what the two sensors' clocks differ by."""
    cell, conditions, _, _ = scene
    quiet = without_sensor_noise(cell)
    yardstick = Yardstick(cell, measure(cell, conditions), measure(quiet, conditions))
    effect = ClockSkew(stage_of(cell, yardstick.log, conditions.start_ns), np.random.default_rng(2))
    effect._drift, effect._sign, effect.size = 0.0, -1.0, 2e-3
    seen = {}
    for effect._sensor in ('psd', 'both'):
        seen[effect._sensor] = yardstick.visibility(measure(quiet, conditions, [effect]), inside='stamps').total
    assert yardstick._patterns(measure(quiet, conditions, [effect]), yardstick.still) < 0.1
    assert yardstick._patterns(measure(cell, conditions, [effect]), yardstick.log) > 3.0
    assert seen['psd'] > 3.0 and seen['both'] < 0.1


def test_samples_that_were_lost_hide_no_move(scene) -> None:
    """Untidy noise loses some; how well a clock is seen that is off was not a number then."""
    spot = scene[2].log.spot
    values = spot.values.copy()
    values[3] = np.nan
    whole, holed = _timed(spot, 0, 20, 1e-6), _timed(replace(spot, values=values), 0, 20, 1e-6)
    assert 0.0 < holed <= whole
