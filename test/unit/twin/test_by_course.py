"""What follows no formula is adopted as a course in time; and where the simulator is held against a log it is read as
the log was: each beam is reset in each run, and what comes after a dwell is no part of it."""

from dataclasses import replace

import numpy as np
import pytest
import yaml

from stepdiag_ros.effects import effect_class
from stepdiag_ros.effects.course import Course
from stepdiag_ros.gap.diagnose import diagnose
from stepdiag_ros.gap.diagnosis import Diagnosis
from stepdiag_ros.gap.inference.joint import unexplained
from stepdiag_ros.twin.adopt import CLOSED, adopt
from stepdiag_ros.twin.against import without_known
from stepdiag_ros.twin.by_course import STEP, _columns, _hats, _times
from stepdiag_ros.twin.twin import Twin
from stepdiag_ros.virtual.cell import parse_cell
from stepdiag_ros.virtual.offline import simulate_log

from ..conftest import small_cell, times_left

# A hall: warm at noon, a door that is opened, then still.
HALL = {'course': {'seconds': [0.0, 60.0, 150.0, 170.0, 400.0, 1000.0],
                   'values': [[0, 0], [9e-6, -3e-6], [3e-6, 4e-6], [-7e-6, 4e-6], [-3e-6, -6e-6], [-3e-6, -6e-6]]}}


@pytest.fixture(scope='module')
def turned() -> Diagnosis:
    cell = small_cell({'beam_pointing_drift': HALL}, 0.5)
    few = replace(cell.description, plan=replace(cell.description.plan, steps=4))
    return diagnose(simulate_log(replace(cell, description=few)), [effect_class('beam_pointing_drift')()])


def test_what_follows_no_formula_is_a_course(turned, tmp_path, monkeypatch):
    adopted = adopt(turned)
    assert times_left(adopted.notes) <= CLOSED
    assert set(adopted.cell['effects']['beam_pointing_drift']) == {'course'}
    assert any('its course in time is taken over as a table' in note for note in adopted.notes)
    # Held against that cell the log has nothing wrong.
    path = tmp_path / 'adopted.yaml'
    path.write_text(yaml.safe_dump(adopted.cell))
    log, _ = without_known(turned.log, path)
    assert diagnose(log, [effect_class('beam_pointing_drift')()]).verdict == 'no_gap'
    # The check can fail: the formula alone does not do it.
    monkeypatch.setattr(effect_class('beam_pointing_drift'), 'course_of', ())
    assert times_left(adopt(turned).notes) > CLOSED


def test_what_the_machine_hides_of_a_course_goes_as_the_forms_went(monkeypatch):
    """How much scales and air changed together no log tells: the machine's errors are stated beside one answer, and the
    course must be of the same."""
    warmer = {'course': {'seconds': [0.0, 40.0, 90.0, 200.0, 600.0], 'values': [[0.0], [3.0], [9.0], [10.0], [14.0]]}}
    cell = small_cell({'air_refraction_drift': warmer}, 0.3)
    few = replace(cell.description, plan=replace(cell.description.plan, steps=4))
    found = diagnose(simulate_log(replace(cell, description=few)), [effect_class('air_refraction_drift')()])

    def farthest() -> float:
        """Of the ends of the axes' positioning errors, from those stated, in their uncertainties."""
        curves = adopt(found).cell['geometry']['curves']
        stated = {name: found.solution.curve(name) for name in ('EXX', 'EYY', 'EZZ')}
        return max(abs(curves[name]['value'][-1] - value[-1]) / sigma[-1] for name, (_, value, sigma) in stated.items())

    assert farthest() < 1.0
    monkeypatch.setattr('stepdiag_ros.twin.by_course.HIDDEN', 0.0)
    assert farthest() > 1.0


def test_readings_are_linear_in_the_amounts(turned):
    """Columns by derivatives, at once for all times of a course, against the difference of two simulated worlds."""
    twin = Twin(turned, small_cell({}, 0.5))
    times, begins = _times(turned.joint.observation, twin)
    assert begins.sum() == len(np.unique(turned.joint.observation.view.run)) and (np.diff(times) > 0.0).all()
    effect = effect_class('beam_pointing_drift')()
    sizes = np.array([p.high for p in effect.amounts()])
    still = Course(times, np.zeros((len(times), len(sizes))))
    columns = _columns(twin, effect, still, sizes, _hats(times, twin.seconds), twin.projected)
    walk = np.random.default_rng(3).normal(size=still.values.shape) * STEP
    made = twin.projected(twin.adds(effect.following(Course(times, walk * sizes)))[None])[:, 0]
    np.testing.assert_allclose(columns @ walk.ravel(), made, atol=1e-3 * np.abs(made).max())


def test_each_beam_is_reset_in_each_run():
    """Three beams have three zeros a run: with one for all a log without any effect left twice its noise."""
    cell = small_cell({}, 0.1)
    setups = {name: replace(setup, beams=((0.0, 0.0), (0.01, 0.0), (0.0, 0.01)))
              for name, setup in cell.description.setups.items()}
    found = diagnose(simulate_log(replace(cell, description=replace(cell.description, setups=setups))),
                     [effect_class('backlash')()])
    adopted = adopt(found)
    assert found.joint.fit.model.beams == 3 and times_left(adopted.notes) <= CLOSED


def test_what_is_beyond_a_dwell_is_the_next_move(diagnosed):
    """A last bin of which the early samples are missing has its middle late, and half of its width behind the dwell."""
    found = diagnosed('')
    view = found.joint.observation.view
    late = view.bin_time.copy()
    late[::7, -1] += 0.9 * (late[0, -1] - late[0, -2])
    observation = replace(found.joint.observation, view=replace(view, bin_time=late))
    found = replace(found, joint=replace(found.joint, observation=observation))
    cell = parse_cell(yaml.safe_dump(adopt(found).cell), 'adopted')
    rest = unexplained(found.joint.parity, ())[:found.joint.parity.stops]
    assert Twin(found, cell).left([])[1] < 1.1 * float(rest @ rest) / found.joint.parity.dof[0]


@pytest.mark.parametrize('given, said', [
    ({'seconds': [0, 1]}, 'course is a mapping of seconds and values'),
    ([1, 2], 'course is a mapping of seconds and values'),
    ({'seconds': [1, 0], 'values': [[0, 0], [0, 0]]}, 'does not rise'),
    ({'seconds': [0, float('nan')], 'values': [[0, 0], [0, 0]]}, 'does not rise'),
    ({'seconds': [0, 1], 'values': [[0, 0]]}, 'wants 2 rows'),
    ({'seconds': [0, 1], 'values': [[0, 'a'], [0, 0]]}, 'rows of numbers'),
    ({'seconds': [], 'values': []}, 'list of 1 to'),
])
def test_a_wrong_course_is_one_line(given, said):
    with pytest.raises(ValueError, match=said):
        effect_class('beam_pointing_drift')(course=given)


def test_a_course_that_no_effect_could_have_is_refused():
    cell = small_cell({'beam_pointing_drift': {'course': {'seconds': [0], 'values': [[1.0, 0.0]]}}})
    with pytest.raises(Exception, match='course: amp is 1; give'):
        simulate_log(cell)
    with pytest.raises(ValueError, match='backlash: has no course'):
        effect_class('backlash')(course={'seconds': [0], 'values': [[1.0]]})


@pytest.mark.parametrize('name', ['air_refraction_drift', 'ambient_light', 'beam_pointing_drift', 'mirror_mount_creep',
                                  'psd_gain', 'psd_rotation', 'psd_zero_offset', 'scale_thermal_expansion',
                                  'squareness_drift', 'structural_thermal_drift'])
def test_a_course_of_what_the_formula_says_is_the_formula(name):
    """Every effect that takes a course does with it what it does with its formula."""
    kind = effect_class(name)
    values = {p.name: [0.3 * p.high] * p.size if p.size > 1 else 0.3 * p.high for p in kind.parameters}
    values |= {p.name: 50.0 for p in kind.parameters if p.name == 'tau'} | {n: 0.0 for n in ('spread', 'swing', 'dP')
                                                                           if n in values}
    seconds = np.arange(0.0, 2000.0, 0.5)
    since = -np.expm1(-seconds / 50.0) if 'tau' in values else np.ones(len(seconds))
    amounts = np.concatenate([np.atleast_1d(values[n]) for n in kind.course_of])
    course = {'seconds': seconds.tolist(), 'values': (since[:, None] * amounts).tolist()}
    kept = {n: values[n] for n in kind.course_keeps}
    # Of one setup: what is mounted anew has in others a beginning of its own.
    logs = [simulate_log(_of_one_setup({name: v})) for v in (values, {**kept, 'course': course})]
    for samples in ('displacement', 'spot'):
        made, wanted = (getattr(log, samples).values for log in logs[::-1])
        apart = np.abs(made - wanted).max()
        assert apart < 2e-3 * np.abs(wanted - getattr(simulate_log(_of_one_setup({})), samples).values).max() + 1e-12


def _of_one_setup(effects):
    cell = small_cell(effects, 0.1)
    one = replace(cell.description, setups={'ppp': cell.description.setups['ppp']})
    motion = replace(cell.motion, mount=0.0)
    return replace(cell, description=one, motion=motion)
