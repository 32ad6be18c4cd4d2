"""Parity space holds what the fit leaves free, in units of the noise, and nothing else."""

from dataclasses import replace

import numpy as np
import pytest

from stepdiag_ros.effects.base import Form
from stepdiag_ros.estimate.enhanced import readings_of
from stepdiag_ros.estimate.noise import whiteners
from stepdiag_ros.gap.inference.candidates import Candidate, Screen
from stepdiag_ros.gap.inference.parity import contrasts, parity
from stepdiag_ros.gap.inference.select_effects import noise_of
from stepdiag_ros.gap.preprocess.observe import observe
from stepdiag_ros.virtual.offline import Visit, simulate_log


def _space(observation):
    return parity(observation, observation.fit, noise_of(observation), readings_of(observation.table))


def test_what_the_fit_can_imitate_is_not_seen(case):
    observation = case.observe()
    space = _space(observation)
    n, c = observation.fit.residual.shape
    columns = observation.fit.jacobian.toarray().T.reshape(-1, n, c)
    seen = np.linalg.norm(space.stop_part(columns), axis=0)
    # No more than the unknown would depart from its prior.
    assert np.all(seen < 1.01 * np.sqrt(np.diag(observation.fit.precision)))


def test_what_only_errors_beyond_all_machines_imitate_is_seen(case):
    observation = case.observe()
    space = _space(observation)
    n, c = observation.fit.residual.shape
    # Along the direction that the readings tell least, the readings move by what a hundred prior sigmas do.
    held = np.linalg.cholesky(observation.fit.precision)
    jacobian = observation.fit.jacobian.toarray()
    white = space.white_part(jacobian.T.reshape(-1, n, c))
    _, value, vector = np.linalg.svd(np.linalg.solve(held, white.T).T, full_matrices=False)
    gentle = int(np.flatnonzero(value > 0.3)[-1])
    step = 100.0 * np.linalg.solve(held.T, vector[gentle])
    seen = np.linalg.norm(space.stop_part((jacobian @ step).reshape(1, n, c)))
    assert value[gentle] < 1e3
    np.testing.assert_allclose(seen, 100.0 * value[gentle] / np.hypot(1.0, value[gentle]), rtol=1e-3)


def test_resets_are_taken_out_run_by_run_as_all_at_once(case):
    """Against a second way: one dense basis of all unknowns, each reset of each run among them."""
    observation = case.observe()
    noise, readings = noise_of(observation), readings_of(observation.table)
    space, result = parity(observation, observation.fit, noise, readings), observation.fit
    white = whiteners(observation.table, noise, result.arrival, result.present)
    held, jacobian = np.linalg.cholesky(result.precision).T, result.jacobian.toarray()
    whole = np.concatenate([*(w(jacobian) for w in white), held])
    basis = np.linalg.qr(whole / np.linalg.norm(whole, axis=0))[0]
    columns = np.random.default_rng(4).standard_normal((5, *readings.shape))
    seen = np.concatenate([*(w(columns.reshape(5, -1).T) for w in white), np.zeros((len(held), 5))])
    seen -= basis @ (basis.T @ seen)
    found = space.stop_part(columns)
    np.testing.assert_allclose(found.T @ found, seen.T @ seen, rtol=1e-7)
    residual = np.where(result.present, readings - result.model.predict(result.theta), 0.0)
    data = np.concatenate([*(w(residual.ravel()) for w in white), -held @ result.theta])
    np.testing.assert_allclose(found.T @ space.data[:space.stops], seen.T @ data, rtol=1e-5, atol=1e-6)
    rows = sum(len(w.rows) for w in white)
    assert space.dof[0] == round(rows - float(np.sum(basis[:rows]**2)))
    # The matrix of what all runs share does not grow with the runs.
    shared = space.projection.size - space.projection.readings
    assert shared == result.parameters.offset_first < len(result.theta)


def test_null_data_are_white(case):
    space = _space(case.observe())
    assert 0.85 < np.sum(space.data[:space.stops]**2) / space.dof[0] < 1.15
    assert 0.8 < np.sum(space.data[space.stops:]**2) / space.dof[1] < 1.25


def test_parts_of_dwells_held_too_noisy_make_nothing_surer(case):
    """They share their scale with the stops: half as loud as they are held to be they doubled the evidence of all."""
    observation = case.observe()
    space, rng = _space(observation), np.random.default_rng(4)
    form = Form('drawn', rng.normal(0.0, 1e-7, (1, *observation.fit.residual.shape)), ('a',), np.array([1.0]))
    column = space.project(form)[:, 0]
    data = space.data + 8.0 * column / np.linalg.norm(column)
    found = []
    for level in (1.0, 0.5):
        held = replace(space, data=np.concatenate([data[:space.stops], level * data[space.stops:]]))
        found.append(Screen(held, [Candidate('drawn', '', form)], 100.0).judge_all((), [0]).log_bayes[0])
    assert found[0] > 8.0 and found[1] < 1.05 * found[0]


@pytest.mark.parametrize('dwell', [0.12, 0.6])
def test_slopes_and_bends_of_samples_that_are_alike_are_white(case, dwell):
    """Of six samples the contrasts beyond a bend hardly tell of a bend; of thirty they tell, and it counts once."""
    space = _space(observe(case.untidy('{spot: {correlation: 0.77}}', dwell=dwell)))
    degree, channel = np.unravel_index(space._bin_places, space._bin_present.shape)[1:]
    inside = space.data[space.stops:]
    for which in (0, 1):
        assert 0.7 < np.mean(inside[(degree == which) & (channel > 0)]**2) < 1.2


def test_each_setup_has_its_own_noise_inside_the_dwells(case):
    """One setup with less light: its noisier spot is noise there, and no scatter beyond it."""
    log = case.log()
    quiet = observe(log)
    dim = quiet.table.setup == quiet.table.setup_names.index('pnp')
    values = log.spot.values.copy()
    rng = np.random.default_rng(3)
    for lo, hi in quiet.table.spot_rows[dim]:
        values[lo:hi] += 4e-7 * rng.standard_normal((hi - lo, 2))
    observation = observe(replace(log, spot=replace(log.spot, values=values)))
    ratio = observation.bin_sigma / quiet.bin_sigma
    np.testing.assert_allclose(ratio[dim, 1:], np.sqrt(5.0), rtol=0.1)
    np.testing.assert_allclose(ratio[~dim], 1.0)
    space = _space(observation)
    mine = np.flatnonzero(dim[space.row] & space.of_spot & (np.arange(space.size) >= space.stops))
    assert 0.8 < np.mean(space.data[mine]**2) < 1.25


def test_data_are_not_changed_by_an_error_of_the_machine(case):
    """Adding what a change of the errors would add moves nothing in parity space."""
    observation = case.observe()
    space = _space(observation)
    rng = np.random.default_rng(1)
    change = (observation.fit.jacobian @ (rng.normal(size=observation.fit.parameters.size) * 1e-6))
    shifted = space.stop_part(change.reshape(1, *observation.fit.residual.shape))
    assert np.linalg.norm(shifted) < 0.05


def test_what_columns_of_readings_owe_to_noise(case):
    """A column that holds the noise of the readings correlates with it: by as much as is taken off, in the mean."""
    space = _space(case.observe())
    rng = np.random.default_rng(2)
    n, c = case.observe().view.reading.shape
    length, turn = rng.uniform(0.0, 0.05, n * c), 2.0 * np.pi / 1.5e-6
    found, corrections = [], []
    for _ in range(200):
        noise = np.zeros(n * c)
        for white in space.projection.white:
            noise[white.rows] = white.factor @ rng.normal(size=len(white.rows))
        phase = turn * (np.round(length / 1.5e-6) * 1.5e-6 + noise)
        form = Form('swing', np.sin(phase).reshape(1, n, c), ('a',), np.ones(1),
                    by_reading=(turn * np.cos(phase)).reshape(1, n, c))
        found.append(float(space.stop_part(noise.reshape(1, n, c))[:, 0] @ space.project(form)[:space.stops, 0]))
        corrections.append(-float(space.own_rows(form)[:, 0] @ space.own_data) / space.level)
    error = np.std(found) / np.sqrt(len(found))
    assert np.mean(corrections) > 20.0 * error
    assert abs(np.mean(found) - np.mean(corrections)) < 5.0 * error


def test_the_whole_correction_is_what_a_reading_that_hardly_grows_costs(case):
    """Of small swings the rows of the second order say all; of one by which the reading stands still they leave much
    out, and what falls while its length grows is next to impossible."""
    space = _space(case.observe())
    n, c = case.observe().view.reading.shape
    swing = np.cos(np.random.default_rng(4).uniform(-np.pi, np.pi, (n, c)))
    share = space.level * space.own_share.reshape(n, c)
    for size in (0.01, 0.3, 0.9):
        exact = float(np.sum(share * np.log(1.0 - size * swing)))
        assert space.log_jacobian(size * swing) == pytest.approx(exact, rel=1e-12)
        rows = float(-np.sum(share * (size * swing + 0.5 * (size * swing)**2)))
        assert space.beyond_rows(size * swing) == pytest.approx(exact - rows, abs=1e-9)
    assert abs(space.beyond_rows(0.01 * swing)) < 1e-4 * share.sum()
    assert space.beyond_rows(0.99 * swing) < -0.02 * share.sum()
    assert space.log_jacobian(1.5 * swing) < -share.sum()


def test_what_is_corrected_once_is_not_corrected_again(case):
    """Given a form made of readings, the same form once more says nothing, as for any other form."""
    space = _space(case.observe())
    n, c = case.observe().view.reading.shape
    phase, length = np.random.default_rng(3).uniform(-1.0, 1.0, (1, n, c)), np.arange(c) == 0
    swing = Form('swing', np.sin(phase) * length, ('a',), np.full(1, 3e-8), by_reading=4e6 * np.cos(phase) * length)
    screen = Screen(space, [Candidate('swing', '', swing), Candidate('again', '', swing)], 1e9)
    first = screen.by_cause()['swing']
    assert first.log_bayes > 6.0, 'the correction alone speaks for the form'
    assert screen.by_cause((first,))['again'].log_bayes < 0.5


def test_a_fringe_owes_less_to_less_noise(case):
    space = _space(case.observe())
    assert 0.8 < space.level <= 1.0
    quiet = replace(space, data=0.5 * space.data)
    assert quiet.level == pytest.approx(0.25 * space.level, rel=0.3)


def test_what_one_axis_always_leaves_keeps_its_shape(case):
    """Large contrasts in all dwells after moves of one axis are no outliers, though most dwells are still."""
    observation = case.observe()
    shape = np.array([4.0, -1.0, -1.0, -1.0, -1.0])
    mine = observation.table.axis == 2
    bins = observation.bins.copy()
    bins[mine, :, 0] += 100.0 * observation.bin_sigma[mine, :1] * shape
    space = _space(replace(observation, bins=bins))
    form = Form('creep', np.zeros((1, *observation.view.reading.shape)), ('a',), np.ones(1),
                inside=np.where(mine[:, None, None], shape[:, None] * np.eye(3)[0], 0.0)[None])
    column, data = space.bin_part(form.inside)[:, 0], space.data[space.stops:]
    rows = column != 0.0
    rest = data - column * (column @ data) / (column @ column)
    assert np.sum(rest[rows] ** 2) < 0.01 * np.sum(data[rows] ** 2)
    # A single dwell in which something happened is held down.
    bins = observation.bins.copy()
    bins[np.flatnonzero(mine)[3], :, 0] += 1e3 * observation.bin_sigma[0, 0] * shape
    assert np.abs(_space(replace(observation, bins=bins)).data[space.stops:]).max() < 20.0


def test_a_dwell_in_which_something_happened_once_says_nothing_of_drifts(case):
    """A slip inside a dwell is no slope; what only begins fast, as creep does, stays, held to a limit."""
    observation = case.observe()
    shape = np.array([-2.0, -1.0, 0.0, 1.0, 2.0]) * observation.bin_sigma[0, 0]
    table, quiet = observation.table, _space(observation)

    def changed(stops, sizes):
        bins = observation.bins.copy()
        bins[stops, :, 0] += np.multiply.outer(sizes, shape)
        space = _space(replace(observation, bins=bins))
        inside = space.data[space.stops:]
        assert np.abs(inside).max() < 20.0
        return quiet.size - space.size, np.abs(inside).max()

    run = np.flatnonzero(table.run == table.run[0])
    gone, most = changed(run[7:8], np.array([1e3]))
    assert gone == len(shape) - 1 and most < 6.0
    gone, most = changed(run, 1e3 / (1.0 + 2.0 * np.arange(len(run))))
    assert gone == 0 and most > 5.9


def test_the_first_piece_of_a_watch_shows_as_much_of_a_drift_as_the_next(case):
    """It is as long as they are, not as short as the dwells before runs, and so no outlier among these."""
    observation = observe(simulate_log(case.cell, visits={'nnp': Visit(watch=60.0)}))
    (watch,) = observation.view.watches
    time = observation.view.bin_time
    bins = observation.bins.copy()
    bins[:, :, 0] += 1e-7 * (time - time.mean(axis=1, keepdims=True))
    space = _space(replace(observation, bins=bins))
    own = (np.arange(len(space.data)) >= space.stops) & (space.channel == 0)
    slopes = [np.abs(space.data[own & (space.row == stop)]).max() for stop in watch]
    np.testing.assert_allclose(slopes, np.mean(slopes), rtol=0.2)


def test_what_goes_on_evenly_has_a_slope_and_nothing_else():
    rng = np.random.default_rng(3)
    time = np.sort(rng.uniform(0.0, 0.6, (7, 5)), axis=1)
    found = contrasts(time)
    np.testing.assert_allclose(found @ found.transpose(0, 2, 1), np.broadcast_to(np.eye(4), (7, 4, 4)), atol=1e-9)
    np.testing.assert_allclose(found @ np.ones(5), 0.0, atol=1e-9)
    seen = (found @ (3.0 * time - 1.0)[:, :, None])[:, :, 0]
    assert np.all(seen[:, 0] > 0.0)
    np.testing.assert_allclose(seen[:, 1:], 0.0, atol=1e-9)
