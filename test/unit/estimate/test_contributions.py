"""What a part contributed, held against an estimate without it."""

from dataclasses import replace

import numpy as np
import pytest

from stepdiag_ros.estimate.contributions import contribution_words, contributions, listed
from stepdiag_ros.estimate.enhanced import fit
from stepdiag_ros.estimate.evaluate import evaluate, solution_of
from stepdiag_ros.estimate.metres import in_metres
from stepdiag_ros.model.description import Noise
from stepdiag_ros.virtual.offline import simulate_log

from .test_of_ways import BODY, LINES, THREE, cell_of


@pytest.fixture(scope='module')
def log():
    log = simulate_log(cell_of(THREE | LINES | BODY))
    return replace(log, description=replace(log.description, noise=Noise()))


def test_the_uncertainty_without_a_part_is_that_of_an_estimate_without_it(log):
    table = in_metres(log).table
    result = fit(log.description, table)
    parts = {part.kind: part for part in contributions(log.description, table, result)}
    assert [*parts] == ['face step diagonal', 'line', 'body diagonal']
    assert sum(part.readings for part in parts.values()) == result.present.sum()
    whole = solution_of(result, table)
    for kind, part in parts.items():
        mine = np.isin(table.setup, [table.setup_names.index(name) for name in part.setups])
        left = table.select(~mine)
        # The same knots: without the lines there would be others.
        noise = replace(result.noise, spread=None) if result.noise.spread is not None \
            else replace(result.noise, sensor=result.noise.sensor[~mine])
        alone = solution_of(fit(log.description, left, noise,
                                theta=result.theta, parameters=result.parameters), left)
        for name, factor in part.narrowed.items():
            rows = [i for i, (n, _) in enumerate(whole.names) if n == name]
            assert factor == pytest.approx(alone.sigma[rows].max() / whole.sigma[rows].max(), rel=0.02), (kind, name)
    assert {'EYX', 'EZX', 'EXY', 'EXZ', 'EYZ', 'EZY'} <= set(parts['face step diagonal'].settled)
    assert {'EXX', 'EYY', 'EZZ'} <= set(parts['line'].narrowed)


def test_it_is_said(log):
    solution = evaluate(log)
    lines = listed(solution.parts)
    assert len(lines) == 3 and all('times the noise' in line for line in lines)
    assert 'without it open: EYX' in lines[0]
    assert [part['kind'] for part in solution.to_json_dict()['parts']] == [part.kind for part in solution.parts]
    assert contribution_words(replace(solution.parts[0], narrowed={}, settled=())).startswith('every error')


def test_a_log_of_one_kind_has_no_parts():
    log = simulate_log(cell_of(LINES))
    table = in_metres(log).table
    assert contributions(log.description, table, fit(log.description, table, linear_laser=1e-5)) == ()
