"""The part held out: every repeat in turn, or the last ones of an only run."""

import numpy as np
import pytest

from stepdiag_ros.bag.import_csv import import_csv
from stepdiag_ros.effects import all_effects
from stepdiag_ros.gap import diagnose
from stepdiag_ros.gap.summary.cross_validation import (
    CrossValidation,
    Distance,
    cross_validated,
    cross_validated_by_setup,
)
from stepdiag_ros.model.description import Description


def test_every_repeat_is_predicted_once(unaffected):
    joint = unaffected.joint
    found = cross_validated(joint)
    assert found.count == int(joint.fit.present.sum())
    assert 'each repeat' in found.held_out
    assert found.before == found.after == pytest.approx(1.0, abs=4.0 * np.sqrt(2.0 / found.count))


def test_an_effect_found_closes_the_gap(lost_motion):
    found = lost_motion.cross_validation
    assert found.before > 1.2
    assert found.after < 1.0 + 0.1 * (found.before - 1.0) + 4.0 * np.sqrt(2.0 / found.count)
    assert found.after_m < found.before_m
    low, high = found.gap.after_95
    assert low < found.after_m < high < 2.0 * found.after_m and found.gap.before_95[0] > high
    assert 0.5 < found.gap.closed_95[0] < 1.0 - found.gap.left <= found.gap.closed_95[1] <= 1.0
    assert found.to_json_dict()['after_95_m'] == [low, high]


def test_each_setup_is_predicted_from_the_others(unaffected, lost_motion):
    found = cross_validated_by_setup(unaffected.joint)
    assert found.count == int(unaffected.joint.fit.present.sum()) and 'each setup' in found.held_out
    assert found.before == found.after == pytest.approx(1.0, abs=5.0 * np.sqrt(2.0 / found.count))
    found = lost_motion.over_setups
    assert found.before > 1.2 and found.after < 1.0 + 0.1 * (found.before - 1.0) + 5.0 * np.sqrt(2.0 / found.count)
    assert lost_motion.to_json_dict()['over_setups'] == found.to_json_dict()


def test_the_last_cycles_of_an_only_run_are_predicted_from_those_before(tmp_path):
    """A table of five cycles with 20 µm of lost motion and 1 µm of noise."""
    rng = np.random.default_rng(2)
    file = tmp_path / 'stage_x.csv'
    places = [*range(0, 90, 10), *range(80, -10, -10)]
    file.write_text('cycle,direction,target_mm,measured_mm\n' + ''.join(
        f'{cycle},{sign},{at},{at + 0.01 * sign + 0.001 * rng.standard_normal()}\n'
        for cycle in range(1, 6) for at, sign in zip(places, [1] * 9 + [-1] * 9, strict=True)))
    found = diagnose(import_csv(file).log, [kind() for kind in all_effects().values()])
    assert [e.name for e in found.effects] == ['backlash']
    assert found.cross_validation.held_out == 'the last 2 of 5 repeats, predicted from those before'
    assert found.cross_validation.count == 36 and found.over_setups is None
    assert found.cross_validation.before > 50.0
    low, high = found.cross_validation.gap.after_95
    assert 0.5e-6 < low < 1e-6 < high < 3e-6
    assert found.cross_validation.after == pytest.approx(1.0, abs=5.0 * np.sqrt(2.0 / 36))


def of_distance(noise_dof, **distance):
    return CrossValidation(1.5, 1.3, 900, noise_dof, 'each repeat', {'displacement': Distance(**distance)})


def test_what_a_badly_known_noise_may_make_is_not_left_over():
    sharp = {'before': 2e-6, 'after': 1.8e-6, 'floor': 1e-6, 'sigma': 1e-7}
    assert of_distance(1e5, **sharp).left == pytest.approx(0.6)
    assert of_distance(300.0, **sharp).left == 0.0


def test_a_forecast_as_wide_as_the_gap_closes_nothing():
    wide = of_distance(300.0, before=7e-5, after=6.9e-5, floor=2e-5, sigma=6e-5)
    assert wide.left == pytest.approx((6.9**2 - 4.0) / (49.0 - 4.0))


def test_the_gap_is_the_error_of_held_out_readings(lost_motion):
    """Against a second way: the misfit of lengths of one repeat, predicted by hand from the other."""
    joint = lost_motion.joint
    found, fit, table = cross_validated(joint), joint.fit, joint.observation.table
    assert found.channel == 'displacement' and found.after_m < found.before_m
    # A prediction from one other repeat has that one's noise too.
    assert found.floor_m < found.after_m < np.sqrt(2.0) * found.floor_m
    squares, count = 0.0, 0
    for repeat in (0, 1):
        train = np.repeat(table.repeat != repeat, fit.residual.shape[1])
        jacobian, added = fit.jacobian.toarray(), sum(a.contribution for a in joint.active)
        readings = np.concatenate([table.displacement, table.spot], axis=1) - added
        rest = (readings - fit.model.predict(fit.theta)).ravel()
        white = [w for w in joint.parity.projection.white if train[w.rows[0]]]
        columns = np.concatenate([w(jacobian) for w in white])
        along = columns.T @ np.concatenate([w(rest) for w in white])
        step = np.linalg.solve(columns.T @ columns + fit.precision, along)
        error = (rest - jacobian @ step).reshape(fit.residual.shape)[:, 0]
        for run in np.unique(table.run[table.repeat == repeat]):
            own = error[table.run == run]
            squares, count = squares + np.sum((own - own.mean())**2), count + len(own) - 1
    # By hand the effects are taken as fitted to all of the log.
    assert found.after_m == pytest.approx(np.sqrt(squares / count), rel=0.1)


def test_a_table_with_made_up_times_names_no_cause_that_times_tell(shared):
    log = import_csv(shared / 'real_data' / 'stage_b_x_back.csv').log
    assert not log.description.timed and not Description.from_yaml(log.description.to_yaml()).timed
    found = diagnose(log, [kind() for kind in all_effects().values()])
    assert not found.effects and 'made up' in found.unmodelled
    assert found.cross_validation.after_m > 0.9 * found.cross_validation.before_m > found.cross_validation.floor_m
