"""Knowing less never gives a smaller uncertainty; and what is claimed is kept."""

from dataclasses import replace

import numpy as np
import pytest

from stepdiag_ros.compensate.compensation import compensation
from stepdiag_ros.compensate.controls import CONTROLS
from stepdiag_ros.compensate.largest import largest, largest_of_all
from stepdiag_ros.estimate.evaluate import budget_of, evaluate, evaluate_in_full
from stepdiag_ros.estimate.gauge import to_reference_lines
from stepdiag_ros.estimate.methods import run_all, run_method
from stepdiag_ros.estimate.prediction import largest_deviation, predict
from stepdiag_ros.estimate.propagate import propagate
from stepdiag_ros.estimate.solution import Solution
from stepdiag_ros.model.budget import KINDS, MEASURED, Budget
from stepdiag_ros.model.log import Samples
from stepdiag_ros.model.machine import Curve, GeometricErrors
from test.some import some

from .vacuum import cell, describing, log_of, without_topics

OPEN = 1e-4
"""[m, rad]: an error that is no better known than this is open, and what holds it is the estimator's prior."""


def keeping(log, mask):
    columns = ('time_ns', 'run', 'setup', 'repeat', 'direction', 'index', 'axis', 'commanded', 'phase')
    return replace(log, steps=replace(log.steps, **{name: getattr(log.steps, name)[mask] for name in columns}))


def without_setup(log, name):
    return keeping(log, np.array([log.steps.setup_names[i] != name for i in log.steps.setup]))


def without_sigma(log, quantity):
    air = log.description.air
    if air is None:
        return log
    return describing(log, air=replace(air, sigma={k: v for k, v in air.sigma.items() if k != quantity}))


TOPICS = ('air_temperature', 'air_pressure', 'humidity', *(f'scale_temperature/{axis}' for axis in 'xyz'))
KNOWLEDGE = {
    **{name: lambda log, n=name: without_topics(log, n) for name in TOPICS},
    'air': lambda log: describing(log, air=None),
    **{f'air.sigma.{q}': lambda log, q=q: without_sigma(log, q) for q in ('temperature', 'pressure', 'humidity')},
    'material': lambda log: describing(log, scales={}),
    'material.x': lambda log: describing(log, scales={k: v for k, v in log.description.scales.items() if k != 'x'}),
    'budget': lambda log: describing(log, budget=None)}
READINGS = {
    **{name: lambda log, n=name: without_setup(log, n)
       for name in ('lin_x', 'lin_y', 'lin_z', 'ppp', 'npp', 'pnp', 'nnp')},
    'spots': lambda log: replace(log, spot=Samples.empty(2)),
    'repeats': lambda log: keeping(log, log.steps.repeat == 0),
    'backward': lambda log: keeping(log, log.steps.direction > 0)}
INPUTS = KNOWLEDGE | READINGS


@pytest.fixture(scope='module')
def full():
    return log_of(cell())


@pytest.fixture(scope='module')
def whole(full):
    return evaluate(full)


@pytest.mark.parametrize('seed', some(0, later=range(6)))
def test_every_uncertainty_grows_or_stays(full, whole, seed):
    """Inputs go one after the other, in drawn order.

    What readings there are also says how noisy they are: that estimate differs from subset to subset by some
    per cent, and so may U.
    """
    log, gone, before = full, [], whole
    for name in np.random.default_rng(seed).permutation(list(INPUTS))[:6]:
        log = INPUTS[name](log)
        gone.append(str(name))
        after = evaluate(log)
        grows(before, after, 0.94, gone)
        before = after


def grows(before, after, least, gone):
    """No error that is known is better known ``after`` than ``least`` times what it was ``before``."""
    less = dict(zip(after.names, after.sigma, strict=True))
    for key, sigma in zip(before.names, before.sigma, strict=True):
        if key in less and 0.0 < sigma < OPEN:
            assert less[key] > least * sigma, f'{key} without {", ".join(gone)}'


def cell_states(log, rng):
    """The log with the noise of arrivals stated, not estimated, and all else of the budget up to ten times off."""
    stated = {'position_repeatability': 3e-7, 'angle_repeatability': 2e-7}
    lines = [replace(c, value=stated.get(c.kind) if c.value is None else c.value * 10.0**rng.uniform(-1.0, 1.0))
             for c in budget_of(log.description).contributors]
    return describing(log, budget=Budget(tuple(lines)))


@pytest.mark.parametrize('seed', some(1, later=range(8)))
def test_whatever_the_budget_every_uncertainty_grows_or_stays(full, seed):
    """Drawn budgets, in which now the mirror's form, now the tool, now the detector leads; every other order begins
    with the tilts, without which rotations are open."""
    rng = np.random.default_rng(100 + seed)
    log, gone = cell_states(full, rng), []
    order = [str(name) for name in rng.permutation([name for name in INPUTS if name != 'budget'])][:5]
    before = evaluate(log)
    for name in (['spots'] if seed % 2 else []) + order:
        log = INPUTS[name](log)
        gone.append(name)
        after = evaluate(log)
        grows(before, after, 0.97, gone)
        before = after


def figures(log):
    """U of the largest deviation in the volume and of E and B of ISO 230-6."""
    solution, machine = evaluate(log), log.description.machine
    test = run_method('body_diagonal', log)
    return {'volumetric': largest_deviation(solution, machine)[1], **{k: test.sigma_m[k] for k in ('Ed', 'Bd')}}


@pytest.fixture(scope='module')
def known(full):
    return figures(full)


@pytest.mark.parametrize('name', some('spots', 'repeats', 'air_temperature', 'lin_x', later=['air', 'material']))
def test_the_volume_and_the_diagonals_are_no_better_known(full, known, name):
    less = figures(INPUTS[name](full))
    for what, sigma in known.items():
        assert less[what] > 0.94 * sigma, what


@pytest.mark.parametrize('name', sorted(KNOWLEDGE))
def test_what_is_known_about_a_log_only_helps(full, whole, name):
    less = evaluate(KNOWLEDGE[name](full))
    assert np.all(less.sigma >= (1.0 - 5e-3) * whole.sigma)


def test_no_method_is_certain_without_repeats(full):
    results, _ = run_all(READINGS['repeats'](READINGS['backward'](full)))
    assert len(results) >= 6
    for method, result in results.items():
        if not isinstance(result, Solution):
            assert min(result.sigma_m.values()) > 1e-8, method
            assert any('noise that the cell declares' in remark for remark in result.remarks), method
            continue
        for name in {n for n, _ in result.names}:
            assert result.sigma[[i for i, (n, _) in enumerate(result.names) if n == name]].max() > 1e-8, (method, name)
        assert result.traceability.air == 'topics'
        if method != 'enhanced':
            assert any('noise that the cell declares' in warning for warning in result.warnings)


def trial(seed):
    """Pulls of a drawn cell: its air, sensors, scales' material and detector zeros are off as the budget says."""
    rng = np.random.default_rng(1000 + seed)
    of = cell(('psd_zero: 0.0', 'psd_zero: 1.0e-6'), seed=seed)
    by_cell = seed % 2 == 1
    air = of.air
    if by_cell:
        air = replace(air, temperature=air.temperature + 0.5 * rng.standard_normal(),
                      pressure=air.pressure + 100.0 * rng.standard_normal(), sensors=('scale',))
    curves = dict(of.geometry.curves)
    for axis, letter in enumerate('XYZ'):
        own, material = curves[f'E{letter * 2}'], of.description.scales[letter.lower()]
        slope = (material.expansion + material.sigma * rng.standard_normal()) * (air.scale_temperature[axis] - 20.0)
        curves[f'E{letter * 2}'] = Curve(own.position, own.value + slope * np.asarray(own.position))
    log = log_of(replace(of, air=air, geometry=GeometricErrors(curves, of.geometry.square)))
    half = {'air_temperature': 0.1, 'air_pressure': 30.0, 'humidity': 0.03}
    log = replace(log, environment={name: replace(series, value=series.value + rng.uniform(-1.0, 1.0)
                                                  * half.get(name, 0.1)) for name, series in log.environment.items()})
    solution, truth = evaluate(log), to_reference_lines(of.geometry)
    assert solution.traceability.air == ('cell' if by_cell else 'topics')
    found = []
    for (name, knot), value, sigma in zip(solution.names, solution.value, solution.sigma, strict=True):
        if knot != 0:
            true = truth.square[name] if knot < 0 else float(
                truth.curves[name](np.asarray(solution.positions[name])[[knot]])[0])
            found.append((value - true) / sigma)
    return np.array(found)


@pytest.mark.long
def test_intervals_hold_the_truth():
    """Monte Carlo of whole cells: of the k = 2 intervals 95 % and more hold the truth."""
    every = np.array([trial(seed) for seed in range(16)])
    assert np.mean(np.abs(every) < 2.0) > 0.93
    assert np.sqrt(np.mean(every**2)) > 0.5    # and they are not so wide that they say nothing


def headlines(log, solution=None):
    """U that the commands print first: page, map, tables, all by the solution's covariance."""
    solution = evaluate(log) if solution is None else solution
    machine = log.description.machine
    points = np.stack(np.meshgrid(*(np.linspace(0.0, v, 4) for v in machine.volume), indexing='ij'), -1).reshape(-1, 3)
    field = predict(solution, machine, points)
    found = compensation(solution, machine, CONTROLS['sinumerik'], np.zeros(3))
    return {'report': largest_of_all(solution, machine)[1], 'map': float(np.median(field.sigma_m)),
            'compensate before': found.worst_before[1], 'compensate after': found.worst_after[1],
            'compensate as measured': found.worst(found.as_measured)[1],
            'verify': largest(solution, machine, np.asarray(machine.tool), field)[1]}


@pytest.mark.long
def test_what_the_commands_print_first_grows_or_stays(full):
    """All that is known about a log taken away bit by bit; a quantile of 400 draws differs by some per cent itself."""
    log, before = full, headlines(full)
    for name in ('budget', 'air.sigma.temperature', 'scale_temperature/x', 'material', 'humidity', 'air_pressure',
                 'air_temperature', 'air'):
        log = KNOWLEDGE[name](log)
        after = headlines(log)
        for what, spread in before.items():
            assert after[what] > 0.93 * spread, (what, name)
        before = after
    assert before['compensate after'] > 30.0 * headlines(full)['compensate after']


def every_method(log):
    """Standard uncertainties of all that `stepdiag compare` shows, by method and figure."""
    found = {}
    for method, result in run_all(log)[0].items():
        pairs = zip(result.names, result.sigma, strict=True) if isinstance(result, Solution) else result.sigma_m.items()
        found |= {(method, figure): sigma for figure, sigma in pairs}
    return found


@pytest.mark.long
def test_every_method_of_compare_grows_or_stays(full):
    """What is known about the log taken away bit by bit, by all methods of the literature too."""
    log, before = full, every_method(full)
    assert len({method for method, _ in before}) >= 8
    for names in (('budget',), ('scale_temperature/x', 'material'), ('humidity', 'air_pressure'),
                  ('air_temperature', 'air')):
        for name in names:
            log = KNOWLEDGE[name](log)
        after = every_method(log)
        for key, sigma in before.items():
            # Temperatures that are no longer taken into account take their own noise along, a part in a thousand.
            assert after[key] >= 0.995 * sigma or sigma > OPEN, (key, names)
        before = after


@pytest.mark.long
@pytest.mark.parametrize('name', sorted(READINGS))
def test_every_method_of_compare_with_fewer_readings_grows_or_stays(full, name):
    """A method of the literature weighs all setups alike, so that one which scattered more by chance may be missed
    with gain; E and B, the largest of the diagonals that are there, are other figures without one."""
    less = every_method(READINGS[name](full))
    for key, sigma in every_method(full).items():
        if isinstance(key[1], tuple):
            assert less.get(key, np.inf) >= 0.8 * sigma or sigma > OPEN, key


@pytest.mark.long
def test_every_contributor_reaches_errors_and_headlines(full):
    """A contributor ten times as large makes no U smaller, and some larger, in errors and in what is printed first."""
    whole = evaluate_in_full(full)

    def with_lines(lines, setting=whole.setting):
        return propagate(lines, setting, whole.fit, whole.solution).solution
    lines = whole.lines
    plain = with_lines(lines)
    printed = headlines(full, plain)
    for kind in KINDS:
        larger = Budget(tuple(replace(c, value=10.0 * (c.value or 0.0)) if c.kind == kind and c.value is not None else c
                              for c in lines.contributors))
        if larger.contributors == lines.contributors:
            assert kind in MEASURED     # from the log
            continue
        if kind == 'expansion_coefficient':     # where the cell states the material, its own σ counts
            known = whole.setting.conditions
            poor = replace(known, expansion_sigma=tuple(10.0 * s for s in known.expansion_sigma))
            solution = with_lines(lines, replace(whole.setting, conditions=poor))
        else:
            solution = with_lines(larger)
        assert np.all(solution.sigma >= (1.0 - 1e-9) * plain.sigma), kind
        assert np.any(solution.sigma > (1.0 + 1e-6) * plain.sigma), kind
        now = headlines(full, solution)
        assert all(now[what] > 0.97 * printed[what] for what in now), kind
        assert any(now[what] > (1.0 + 1e-9) * printed[what] for what in now), kind
