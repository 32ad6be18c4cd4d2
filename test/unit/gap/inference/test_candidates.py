"""The Jacobian correction of columns made of readings, against the same worked out whole."""

import numpy as np
import pytest

from stepdiag_ros.effects.base import Form
from stepdiag_ros.gap.alternatives.unmodelled import unknown_families
from stepdiag_ros.gap.inference.candidates import Candidate, Member, Screen
from stepdiag_ros.gap.inference.evidence import SIZES, log_mean
from stepdiag_ros.gap.inference.joint import fit_jointly
from stepdiag_ros.gap.inference.select_effects import noise_of
from test.unit.gap.inference.white_space import white_space

N = 60


@pytest.fixture
def forms() -> list[Form]:
    """Two forms made of readings and one that is not."""
    rng = np.random.default_rng(5)

    def form(label: str, count: int, made: bool) -> Form:
        slopes = np.zeros((count, N, 3))
        slopes.reshape(count, -1)[:, :N] = rng.normal(size=(count, N))
        return Form(label, rng.normal(size=(count, N, 1)), tuple('abc'[:count]), np.array([0.5, 0.2, 0.3])[:count],
                    by_reading=slopes if made else None)

    return [form('one', 2, True), form('two', 3, True), form('plain', 2, False)]


def _screen(forms: list[Form], data: np.ndarray, noise_dof: float) -> Screen:
    space = white_space(data)
    return Screen(space, [Candidate(form.label, '', form) for form in forms], noise_dof)


def _parts(screen: Screen, forms: list[Form], sizes: list[np.ndarray]) -> tuple[float, float, float, np.ndarray]:
    """Log determinant, what is left of the data with the price of the coefficients, what is left of the correction, and
    the share of the data's rows that is taken."""
    space = screen.parity
    seen = [np.concatenate([space.project(form), space.own_rows(form) if form.by_reading is not None
                            else np.zeros((len(space.own_data), len(form.columns)))]) for form in forms]
    z, data = np.concatenate([np.zeros((len(screen.data), 0)), *seen], axis=1), screen.data
    size = np.concatenate([np.zeros(0), *sizes])
    normal = z.T @ z + np.diag(size**-2.0)
    a = np.linalg.solve(normal, z.T @ data)
    left = data - z @ a
    taken = z @ np.linalg.solve(normal, z.T)
    return (float(np.linalg.slogdet(np.diag(size) @ normal @ np.diag(size))[1]),
            float(left[:N] @ left[:N] + np.sum((a / size)**2)), float(left[N:] @ left[N:]), np.diag(taken)[:N])


@pytest.mark.parametrize('noise_dof', [0.0, 40.0, 1e9])
@pytest.mark.parametrize('given', [(), (0,), (2,), (0, 2)])
def test_evidence_is_that_worked_out_whole(forms, noise_dof, given):
    """In sizes small enough that no direction of the set is left out, whatever is known of the noise."""
    rng = np.random.default_rng(6)
    data = np.tensordot([0.8, -0.6], forms[0].columns[:, :, 0], axes=1) + rng.normal(size=N)
    screen = _screen(forms, data, noise_dof)
    members = [Member(forms[i].label, i, 0.0, 2.0) for i in given]
    judged = screen.judge_all(members, range(3))
    held = [np.full(len(forms[i].columns), 2.0) for i in given]
    before = _parts(screen, [forms[i] for i in given], held)
    dof = N - float(np.sum(before[3]))
    for number in range(3):
        logs = []
        for size in SIZES:
            after = _parts(screen, [forms[i] for i in (*given, number)],
                           [*held, np.full(len(forms[number].columns), size)])
            logs.append(-0.5 * (after[0] - before[0]) + 0.5 * (before[2] - after[2])
                        - 0.5 * (dof + noise_dof) * np.log1p((after[1] - before[1]) / (noise_dof + before[1])))
        assert judged.log_bayes[number] == pytest.approx(log_mean(logs), abs=2e-3)


@pytest.mark.parametrize('size', [1.0, 1e3, 1e5])
def test_how_well_a_coefficient_is_known_does_not_drown_in_the_size_it_is_allowed(size):
    """Of a slip known to half a nanometre thirty micrometres are allowed: squared, that is where digits end."""
    rng = np.random.default_rng(8)
    one, other = rng.normal(size=(2, N))
    forms = [Form(label, column[None, :, None], ('a',), np.ones(1))
             for label, column in (('one', one), ('other', other))]
    screen = _screen(forms, 3.0 * one - 2.0 * other + rng.normal(size=N), 1e9)
    members = [Member(form.label, number, 0.0, size) for number, form in enumerate(forms)]
    known = np.linalg.inv(np.array([[one @ one, one @ other], [one @ other, other @ other]]) + np.eye(2) / size**2)
    for number in range(2):
        value, sigma = screen.with_sigmas(members, number)
        assert sigma == pytest.approx(np.sqrt(known[number, number]), rel=1e-3)
        assert value == pytest.approx(screen.sizes(members, number), abs=1e-2 * float(sigma[0]))


def test_places_of_one_setup_are_among_all_places_and_judged_as_alone(case):
    """Their columns are kept once; what each is worth is what it is worth in a screen of its own."""
    observation = case.observe()
    space = fit_jointly(observation, [], noise_of(observation)).parity
    forms = [form for form in unknown_families(observation.view)['places'] if form.label.startswith('spot_x: places')]
    screen = Screen(space, [Candidate('unknown', 'places', form) for form in forms], 100.0)
    width = screen._brought.width
    assert width == sum(len(f.columns) for f in forms if ' in ' not in f.label) \
        < sum(len(form.columns) for form in forms)
    together = screen.judge_all((), np.arange(len(forms))).log_bayes
    for number, form in enumerate(forms):
        alone = Screen(space, [Candidate('unknown', 'places', form)], 100.0)
        assert together[number] == pytest.approx(alone.judge_all((), [0]).log_bayes[0], abs=1e-6)
        np.testing.assert_allclose(screen.columns_of(number), alone.columns_of(0), atol=1e-9)
