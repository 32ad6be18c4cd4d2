"""Budgets in YAML: what is read, and what is refused with line and key."""

import numpy as np
import pytest

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.model.budget import KINDS, Budget
from stepdiag_ros.model.standard_budget import standard_budget

LINE = '  - {name: a, kind: scale, type: B, distribution: normal, value: 2.0e-8, unit: m/m}'


def budget(*lines):
    return Budget.from_yaml('\n'.join(['schema: 1', 'contributors:', *lines]), 'mine.yaml')


def test_the_shipped_budget_names_every_kind_once():
    contributors = standard_budget().contributors
    assert sorted(c.kind for c in contributors) == sorted(KINDS)
    assert {c.type for c in contributors} == {'A', 'B'}


@pytest.mark.parametrize(('distribution', 'ratio'), [('normal', 1.0), ('rectangular', 3**-0.5),
                                                     ('triangular', 6**-0.5), ('arcsine', 2**-0.5)])
def test_standard_uncertainty_and_draws(distribution, ratio):
    c = budget(LINE.replace('normal', distribution)).contributors[0]
    assert c.standard == pytest.approx(2.0e-8 * ratio)
    drawn = c.draw(np.random.default_rng(0), (40_000, 1))
    assert abs(drawn.mean()) < 0.03
    assert drawn.std() == pytest.approx(1.0, abs=0.02)
    if distribution != 'normal':
        assert np.abs(drawn).max() * ratio <= 1.0 + 1e-12


def test_few_degrees_of_freedom_are_drawn_from_student():
    c = budget(LINE.replace('unit: m/m', 'unit: m/m, dof: 5')).contributors[0]
    drawn = c.draw(np.random.default_rng(0), (100_000, 1))
    assert drawn.std() == pytest.approx(np.sqrt(5.0 / 3.0), rel=0.02)


def test_cosine_errors_only_shorten():
    text = '  - {name: c, kind: cosine, type: B, value: 2.0e-4, unit: rad}'
    drawn = budget(text).contributors[0].draw(np.random.default_rng(0), (50_000, 1))
    assert drawn.min() >= -1.0
    assert drawn.mean() == pytest.approx(0.0, abs=0.02)
    assert drawn.std() == pytest.approx(1.0, abs=0.03)


@pytest.mark.parametrize(('line', 'said'), [
    (LINE.replace('scale', 'scales'), "mine.yaml:4: kind: 'scales' is not known"),
    ('  - {name: t, kind: [1], type: B, value: 0.1, unit: K}', 'mine.yaml:4: kind: [1] is not known'),
    (LINE.replace('normal', '{a: 1}'), "mine.yaml:4: distribution: {'a': 1} is not known"),
    (LINE.replace('m/m', 'ppm'), "mine.yaml:4: unit: 'ppm'; scale is given in m/m"),
    (LINE.replace('type: B', 'type: C'), "mine.yaml:4: type: 'C'"),
    (LINE.replace('normal', 'gaussian'), "mine.yaml:4: distribution: 'gaussian'"),
    (LINE.replace('2.0e-8', '-1.0'), 'mine.yaml:4: value: -1.0; give a number in m/m'),
    (LINE.replace('2.0e-8', 'true'), 'mine.yaml:4: value: True'),
    (LINE.replace('2.0e-8', '.nan'), 'mine.yaml:4: value: nan'),
    (LINE.replace('2.0e-8', 'from log'), 'mine.yaml:4: value: a log does not say scale'),
    (LINE.replace('value', 'valeu'), 'mine.yaml:4: valeu: unknown key'),
    (LINE.replace('unit: m/m', 'unit: m/m, dof: 1'), 'mine.yaml:4: dof: 1'),
    (LINE.replace('name: b', 'name: a'), "mine.yaml:4: name: 'a' comes twice"),
    ('  - 7', 'mine.yaml:4: contributors: each entry is a mapping'),
    ('  - {name: t, kind: scale_temperature, type: B, value: 0.1, unit: K}', 'mine.yaml:4: coefficient: missing'),
])
def test_mistakes_name_line_and_key(line, said):
    with pytest.raises(StepdiagError) as caught:
        budget(LINE, line)
    message = str(caught.value)
    assert said in message
    assert '\n' not in message


@pytest.mark.parametrize('text', ['', 'schema: 2', 'schema: 1', 'schema: 1\ncontributors: []',
                                  'schema: 1\nbudget: 3', '[1, 2', 'schema: 1\ncontributors: {a: 1}'])
def test_no_budget_at_all(text):
    with pytest.raises(StepdiagError, match=r'^mine\.yaml:\d+: '):
        Budget.from_yaml(text, 'mine.yaml')
