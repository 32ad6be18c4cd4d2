"""What no effect of the vocabulary does is not given the name of one, and what one does keeps its name."""

from dataclasses import replace

import numpy as np
import pytest

from stepdiag_ros.effects import effect_class
from stepdiag_ros.effects.base import Effect
from stepdiag_ros.effects.cyclic_nonlinearity import CONTROLS, WAVELENGTHS
from stepdiag_ros.gap.alternatives.known_physics import BEARINGS, beyond_families
from stepdiag_ros.gap.alternatives.unmodelled import inconsistent_forms, unknown_families
from stepdiag_ros.gap.constants import SCATTER_ALARM
from stepdiag_ros.gap.summary.cross_validation import CrossValidation, excess_forecast
from test.some import some
from test.unit.gap.ring import Ring


class Leak(Effect):
    """The spot leaks into the length and saturates."""

    name = 'leak'

    def after_light(self, moment):
        moment.length = moment.length + 4e-5 * np.tanh(moment.spot[:, :1] / 5e-4)


class Twist(Effect):
    """The head turns with the direction of Z."""

    name = 'twist'

    def before_pose(self, moment):
        moment.turn = moment.turn + 4e-6 * moment.approach[:, [2]] * np.array([1.0, 0.5, 0.0])


class Bow(Effect):
    """Y's guideway bends into an S in the course of the log."""

    name = 'bow'

    def before_pose(self, moment):
        place = moment.commanded[:, 1] / 0.4
        size = 6.5e-6 * (1.0 - np.exp(-moment.seconds / 400.0)) * np.sin(2.0 * np.pi * place)
        moment.shift = moment.shift + size[:, None] * np.eye(3)[2]


@pytest.mark.parametrize(('kind', 'words'), some(
    (Leak, 'follows the spot'), later=[(Bow, 'changes its shape'), (Twist, 'turned by the direction of Z')]))
def test_physics_of_no_name_is_not_named(case, kind, words):
    found = case.diagnose(kind())
    assert not found.effects, [(e.name, e.probability) for e in found.effects]
    assert found.verdict == 'unexplained'
    assert words in found.unmodelled


@pytest.mark.long
def test_a_fringe_keeps_its_name(case):
    given = effect_class('cyclic_nonlinearity')(amp=1.2e-7, amp2=0.0, phase=0.4, wavelength=1.53e-6)
    found = case.diagnose(given)
    assert [e.name for e in found.effects] == ['cyclic_nonlinearity']
    assert found.verdict == 'explained'


def test_what_lives_in_one_group_cannot_differ_between_groups(case):
    view = case.observe().view
    slip = effect_class('count_slip')().appearance(view)[0]
    assert not list(inconsistent_forms(view, [slip]))
    everywhere = effect_class('psd_rotation')().appearance(view)[0]
    assert {'setup', 'repeat'} <= {form.label.split()[-1] for form in inconsistent_forms(view, [everywhere])}


def test_a_bad_forecast_is_seen_beyond_its_scatter():
    def gain(ratio, count=530):
        return excess_forecast(CrossValidation(ratio, ratio, count, 530.0, 'repeat 1', {}))[0]
    assert gain(0.8) == 0.0
    assert gain(1.0 + 3.0 * np.sqrt(2.0 / 530)) < SCATTER_ALARM < gain(1.8)
    assert gain(1.6, 20) < SCATTER_ALARM


def test_negative_controls_are_of_no_laser():
    """Neither a wavelength nor its half or double: those a real swing shows at too."""
    for wavelength in WAVELENGTHS:
        for factor in (0.5, 1.0, 2.0):
            assert min(abs(d / (factor * wavelength) - 1.0) for d in CONTROLS) > 0.02


def test_columns_fit_their_log(case):
    view = case.observe().view
    for family, forms in beyond_families(view).items():
        for form in forms:
            assert form.columns.shape[1:] == view.reading.shape, family
            assert np.all(np.isfinite(form.columns)) and np.any(form.columns), form.label


def test_a_mirror_that_slips_is_physics_and_no_shapeless_pattern(case):
    """Two columns that hold from a stop to the end of its setup; at e⁸ against a creep took its place."""
    view = case.observe().view
    forms = beyond_families(view)['slip']
    assert len(forms) == len(view.time) and all(len(form.names) == 2 for form in forms)
    shapeless = [form.label for family in unknown_families(view).values() for form in family]
    assert not [label for label in shapeless if label.startswith('mirror: jump')]
    # At the last stop of a setup it does no more than an error of one arrival.
    assert sum(form.of_one_arrival for form in forms) == len(set(view.setup))


def test_a_leak_between_two_bearings_is_followed(case):
    """The net of bearings is coarse; half a mesh away hardly anything of a leak must be left."""
    view = case.observe().view
    across = np.stack([np.linspace(-8e-4, 8e-4, len(view.time)), 4e-4 * np.sin(np.arange(len(view.time)))], axis=1)
    reading = view.model.copy()
    reading[:, view.beams:] = across
    angle = 0.5 * np.pi / BEARINGS
    leak = np.tanh(across @ (np.cos(angle), np.sin(angle)) / 1e-3)
    left = []
    for form in beyond_families(replace(view, model=reading))['leak']:
        columns = form.columns[:, :, 0].T
        left.append(np.linalg.norm(leak - columns @ np.linalg.lstsq(columns, leak, rcond=None)[0]))
    assert min(left) < 0.01 * np.linalg.norm(leak)


class Shear(Effect):
    """The detector's axes are not square to each other."""

    name = 'shear'

    def after_light(self, moment):
        moment.spot = moment.spot + 0.03 * moment.spot[:, ::-1]


class HalfPlane(Effect):
    """The detector's gain along x is another on one side of its middle."""

    name = 'half_plane'

    def after_light(self, moment):
        x = moment.spot[:, 0]
        moment.spot = np.column_stack([np.where(x > 0.0, 1.05 * x, x), moment.spot[:, 1]])


class CutBeam(Effect):
    """Towards one end of Z's travel the mirror's edge cuts the beam: light is lost, and the spot's middle moves."""

    name = 'cut_beam'

    def after_light(self, moment):
        cut = 0.3 * np.clip(moment.commanded[:, 2] / 0.3 - 0.5, 0.0, None) ** 2
        moment.intensity = moment.intensity * (1.0 - cut)
        moment.spot = moment.spot + cut[:, None] * np.array([3e-4, -1e-4])


@pytest.mark.parametrize(('kind', 'words'), some(
    (Shear, 'not square'), later=[(HalfPlane, 'one side'), (CutBeam, 'follow the')]))
def test_a_detector_that_no_effect_describes_is_not_named(case, kind, words):
    found = case.diagnose(kind())
    assert not [e.name for e in found.effects if e.probability > 0.85], [(e.name, e.probability) for e in found.effects]
    assert words in found.unmodelled or found.verdict != 'explained'


def test_a_standoff_off_is_what_a_fit_of_the_wrong_description_leaves(case):
    """The form against the difference of two worlds, one with another standoff: an independent way to its column."""
    import yaml

    from stepdiag_ros.virtual.cell import parse_cell
    from stepdiag_ros.virtual.offline import simulate_log
    body = yaml.safe_load(case.quiet)
    body['setups']['npp']['standoff'] += 1e-3
    here, there = (simulate_log(parse_cell(text)) for text in (case.quiet, yaml.safe_dump(body, sort_keys=False)))
    from stepdiag_ros.gap.preprocess.observe import observe
    view = observe(here).view
    moved = observe(there).view.reading - view.reading
    forms = {f.label: f for f in beyond_families(view)['standoff']}
    form = forms['the description: the standoff of npp is off']
    mine = view.setup == view.setup_names.index('npp')
    expected = form.columns[0][mine][:, -2:] * 1e-3
    np.testing.assert_allclose(moved[mine][:, -2:], expected, atol=0.02 * np.abs(expected).max())


@pytest.mark.long
def test_a_ringing_mirror_is_no_servo(case):
    found = case.diagnose(Ring())
    assert not found.effects, [(e.name, e.probability) for e in found.effects]
    assert found.verdict == 'unexplained'
    assert 'mirror: rings after each move at 5.' in found.unmodelled


def test_what_rings_in_the_world_rings_in_the_form(case):
    """The form against the difference of two worlds, one of which rings: an independent way to its columns."""
    still, rings = case.observe(), case.observe(Ring())
    form = next(f for f in beyond_families(still.view)['ring'] if f.label.startswith('mirror: rings after each move'))
    form = form.retune({'frequency_Hz': 5.13, 'tau_s': 0.28})
    moved = (rings.bins - still.bins).ravel()
    columns = np.asarray(form.inside).reshape(len(form.names), -1)
    keep = np.isfinite(moved)
    size, *_ = np.linalg.lstsq(columns.T[keep], moved[keep], rcond=None)
    left = moved[keep] - size @ columns[:, keep]
    # A bin is half a period long and has six samples: their mean is not quite that of the curve.
    assert np.linalg.norm(left) < 0.06 * np.linalg.norm(moved[keep])
    # About u, v: cosines of 0, sines of 0.8 and −0.6.
    np.testing.assert_allclose(size, 4e-5 * np.array([0.0, 0.8, 0.0, -0.6]), atol=2e-6)


class Sinks(Effect):
    """Z's drive is off while it stands: it sinks in each dwell, and the next move fetches it back."""

    name = 'sinks'

    def before_pose(self, moment):
        moment.position = moment.position - 7e-7 * np.maximum(moment.since_arrival, 0.0)[:, None] * np.eye(3)[2]


@pytest.mark.long
def test_what_sinks_in_each_dwell_is_no_drift(case):
    # Each setup sees it under an angle of its own.
    found = case.diagnose(Sinks())
    assert not found.effects, [(e.name, e.probability) for e in found.effects]
    assert found.verdict == 'unexplained'
    labels = [found.screen.candidates[m.candidate].form.label for m in found.raw[0].members]
    assert 'displacement: inside the dwells, another slope in each setup' in labels
