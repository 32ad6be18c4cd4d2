"""The part held out: every repeat in turn, or the last ones of an only run."""

import numpy as np
import pytest

from stepdiag_ros.bag.import_csv import import_csv
from stepdiag_ros.effects import all_effects, effect_class
from stepdiag_ros.gap import diagnose
from stepdiag_ros.gap.summary.cross_validation import Closing, closing, closing_over_setups


def test_every_repeat_is_foretold_once(case):
    joint = case.diagnose().joint
    found = closing(joint)
    assert found.count == int(joint.fit.present.sum())
    assert 'each repeat' in found.held_out
    assert found.before == found.after == pytest.approx(1.0, abs=4.0 * np.sqrt(2.0 / found.count))


def test_an_effect_found_closes_the_gap(case):
    found = case.diagnose(effect_class('backlash')(B=[4e-6, 0.0, 3e-6])).closing
    assert found.before > 1.2
    assert found.after < 1.0 + 0.1 * (found.before - 1.0) + 4.0 * np.sqrt(2.0 / found.count)
    assert found.after_m < found.before_m


def test_each_setup_is_foretold_from_the_others(case):
    quiet, moved = case.diagnose(), case.diagnose(effect_class('backlash')(B=[4e-6, 0.0, 3e-6]))
    found = closing_over_setups(quiet.joint)
    assert found.count == int(quiet.joint.fit.present.sum()) and 'each setup' in found.held_out
    assert found.before == found.after == pytest.approx(1.0, abs=5.0 * np.sqrt(2.0 / found.count))
    found = moved.over_setups
    assert found.before > 1.2 and found.after < 1.0 + 0.1 * (found.before - 1.0) + 5.0 * np.sqrt(2.0 / found.count)
    assert moved.to_json_dict()['over_setups'] == found.to_json_dict()


def test_the_last_cycles_of_an_only_run_are_foretold_from_those_before(tmp_path):
    """A table of five cycles with 20 µm of lost motion and 1 µm of noise."""
    rng = np.random.default_rng(2)
    file = tmp_path / 'stage_x.csv'
    places = [*range(0, 90, 10), *range(80, -10, -10)]
    file.write_text('cycle,direction,target_mm,measured_mm\n' + ''.join(
        f'{cycle},{sign},{at},{at + 0.01 * sign + 0.001 * rng.standard_normal()}\n'
        for cycle in range(1, 6) for at, sign in zip(places, [1] * 9 + [-1] * 9, strict=True)))
    found = diagnose(import_csv(file).log, [kind() for kind in all_effects().values()])
    assert [e.name for e in found.effects] == ['backlash']
    assert found.closing.held_out == 'the last 2 of 5 repeats, foretold from those before'
    assert found.closing.count == 36 and found.over_setups is None
    assert found.closing.before > 50.0
    assert found.closing.after == pytest.approx(1.0, abs=5.0 * np.sqrt(2.0 / 36))


def test_what_a_badly_known_noise_may_make_is_not_left_over():
    def left(noise_dof):
        return Closing(1.5, 1.3, 900, noise_dof, 'each repeat', 0.0, 0.0, 0.0).left
    assert left(1e5) == pytest.approx(0.6)
    assert left(300.0) == 0.0
