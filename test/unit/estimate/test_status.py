"""When an evaluation is ok, and when not."""

from dataclasses import replace

import numpy as np
import pytest

from stepdiag_ros.estimate.enhanced import fit
from stepdiag_ros.estimate.evaluate import solution_of
from stepdiag_ros.estimate.noise import NoiseModel
from stepdiag_ros.estimate.planned import filled, observe, planned_table
from stepdiag_ros.estimate.status import HEAVY_TAILS, chi2_limit, reasons


@pytest.fixture
def measured(plan_of, draw_errors):
    """``make(repeats, names)``: description and stops with repeatable noise of 1 µm on all readings."""
    def make(repeats=2, **plan):
        description = plan_of(steps=2, repeats=repeats, **plan)
        table = planned_table(description)
        readings = observe(description, table, draw_errors(description.machine, 2))
        return description, filled(table, readings + np.random.default_rng(2).normal(0.0, 1e-6, readings.shape))
    return make


def quiet(table, size=1e-6):
    """Noise of the stops as :fixture:`measured` draws it."""
    return NoiseModel(1e-9, 1e-9, np.full((len(table), 3), size), 'repeats', (100, 100))


def test_noise_alone_is_ok(measured):
    description, table = measured()
    assert solution_of(fit(description, table, quiet(table)), table).status == 'ok'


@pytest.mark.parametrize('factor', [2.5, 70.0, 1e4])
def test_residuals_larger_than_noise_are_not(measured, factor):
    description, table = measured()
    status = solution_of(fit(description, table, quiet(table, 1e-6 / factor)), table).status
    assert status.startswith('not ok: ') and 'times as large as the noise' in status


def test_without_spots_it_is_not_ok(measured):
    description, table = measured()
    blind = replace(table, spot=np.full_like(table.spot, np.nan))
    status = solution_of(fit(description, blind, quiet(table)), blind).status
    assert 'no tilts in setup ppp, npp, pnp, nnp' in status


def test_without_lengths_at_most_stops_it_is_not_ok(measured):
    description, table = measured()
    lost = (table.setup == 0) & (table.index > 0)
    dark = replace(table, displacement=np.where(lost[:, None], np.nan, table.displacement))
    assert reasons(fit(description, dark, quiet(table)), dark) == [
        f'no lengths in setup {table.setup_names[0]}: interferometer/displacement is missing or cannot be used at '
        'most of its stops']


def test_three_beams_need_no_spots(measured):
    description, table = measured(beams=((0.0, 0.0), (0.03, 0.0), (0.0, 0.03)))
    blind = replace(table, spot=np.full_like(table.spot, np.nan))
    noise = NoiseModel(1e-9, 1e-9, np.full((len(table), 5), 1e-6), 'repeats', (100, 100))
    assert reasons(fit(description, blind, noise), blind) == []


def test_lines_alone_need_no_spots(measured):
    description, table = measured(names=('lin_x',), repeats=10)
    blind = replace(table, spot=np.full_like(table.spot, np.nan))
    assert reasons(fit(description, blind, quiet(table)), blind) == []


def test_without_degrees_of_freedom_it_is_not_ok(measured):
    description, table = measured(repeats=1, names=('lin_x',))
    one = table.select(np.arange(2))
    status = solution_of(fit(description, replace(one, spot=np.full_like(one.spot, np.nan)), quiet(one)), one).status
    assert '0 degrees of freedom: nothing checks the model' in status


def test_the_limit_knows_how_well_the_noise_is_known(measured):
    description, table = measured()
    result = fit(description, table, quiet(table))
    limits = [chi2_limit(replace(result, noise=replace(result.noise, **more))) for more in (
        {'dof': (100000, 100000)}, {'dof': (30, 30)}, {'source': 'belief'})]
    assert HEAVY_TAILS < limits[0] < limits[1] and limits[0] < limits[2]
