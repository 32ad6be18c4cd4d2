"""The loop that holds a beam on a retroreflector, against its closed forms; the optics against reflected rays."""

import numpy as np
import pytest

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.model.regulation import (
    GAIN,
    Aim,
    Regulator,
    aims_of,
    angles_of,
    beam_axes,
    shortened,
    stable_gain,
    steered,
    told,
)

FRAME = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
FRAME = FRAME * np.sign(np.linalg.det(FRAME))


def test_a_beam_at_the_angles_of_the_arm_meets_the_centre():
    arm = np.random.default_rng(1).normal(size=(50, 3)) * 0.1 + 0.4 * FRAME[2]
    length, spot = steered(FRAME, angles_of(FRAME, arm), arm)
    np.testing.assert_allclose(length, np.linalg.norm(arm, axis=1), rtol=1e-14)
    np.testing.assert_allclose(spot, 0.0, atol=1e-15)


def test_the_spot_is_where_three_mirrors_of_a_corner_send_the_beam():
    """A cube corner traced mirror by mirror: the return is parallel, displaced by twice what misses the vertex, and the
    path to the vertex's foot is half of the way there and back."""
    rng = np.random.default_rng(2)
    corner = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    angles = np.array([0.11, -0.07])
    beam, first, second = (axis[0] for axis in beam_axes(FRAME, angles[None]))
    vertex = beam * 0.35 + 0.0008 * first - 0.0011 * second
    # Opened towards the beam: each mirror's normal against it.
    corner = corner * -np.sign(corner @ beam)[:, None]
    point, direction, path = np.zeros(3), beam, 0.0
    for _ in range(3):
        t = np.array([(vertex - point) @ n / (direction @ n) if direction @ n < 0.0 else np.inf for n in corner])
        t[t < 1e-9] = np.inf
        k = int(t.argmin())
        point, path = point + t[k] * direction, path + t[k]
        direction = direction - 2.0 * (direction @ corner[k]) * corner[k]
    back = -point @ direction            # to the plane through the station, normal to the beam
    home = point + back * direction
    length, spot = steered(FRAME, angles[None], vertex[None])
    np.testing.assert_allclose(direction, -beam, atol=1e-12)
    np.testing.assert_allclose([home @ first, home @ second], spot[0], atol=1e-15)
    np.testing.assert_allclose(0.5 * (path + back), length[0], rtol=1e-14)


def test_what_the_beam_misses_shortens_the_length_as_the_spot_says():
    arm = np.array([[0.02, -0.01, 0.4]]) @ FRAME
    right = angles_of(FRAME, arm)
    for off in (1e-4, 1e-3, 3e-3):
        length, spot = steered(FRAME, right + [off, -0.6 * off], arm)
        missing = np.linalg.norm(arm) - length[0]
        assert missing == pytest.approx(shortened(np.sum(spot ** 2), np.linalg.norm(arm)), rel=2.0 * off)
    # 1 mrad off at 0.4 m: L ε²/2.
    length, _ = steered(FRAME, right + [0.0, 1e-3], arm)
    assert np.linalg.norm(arm) - length[0] == pytest.approx(0.5e-6 * np.linalg.norm(arm), rel=1e-5)


def run(gain: float, delay: int, periods: int, begin: float = 1e-4, rate: float = 0.0) -> np.ndarray:
    """Errors [rad] of azimuth, period by period, of a beam whose command shows ``delay`` periods late."""
    regulator = Regulator(Aim(begin, 0.0, 0.5), 0.0, 5e-3, gain)
    commands = [regulator.command[0]] * (delay + 1)
    found = []
    for k in range(periods):
        error = rate * k - commands[-1 - delay]
        found.append(error)
        commands.append(regulator.next(np.array([2.0 * 0.5 * error, 0.0]))[0])
    return np.array(found)


def test_a_step_dies_out_as_a_power_of_one_less_the_gain():
    np.testing.assert_allclose(run(GAIN, 0, 40), -1e-4 * (1.0 - GAIN) ** np.arange(40), rtol=1e-9)


@pytest.mark.parametrize('delay', [0, 1, 2, 4])
def test_the_loop_is_stable_up_to_the_gain_of_the_closed_form(delay):
    limit = stable_gain(delay)
    below, above = (np.abs(run(share * limit, delay, 3000)) for share in (0.97, 1.03))
    assert below[-50:].max() < 0.1 * below[:50].max() and above[-50:].max() > 10.0 * above[:50].max()
    # By the polynomial's roots: z^(delay+1) − z^delay + gain.
    roots = np.roots([1.0, -1.0, *np.zeros(delay - 1), limit] if delay else [1.0, limit - 1.0])
    assert np.abs(roots).max() == pytest.approx(1.0, abs=1e-9)


def test_the_usual_gain_bears_four_periods_of_delay_and_not_six():
    assert stable_gain(4) > GAIN > stable_gain(6)


@pytest.mark.parametrize('delay', [0, 2])
def test_a_moving_retroreflector_is_trailed_by_rate_over_gain(delay):
    assert run(GAIN, delay, 400, rate=2e-4)[-1] == pytest.approx(2e-4 / GAIN, rel=1e-6)


def test_what_lies_within_the_deadband_is_left_alone_and_steps_of_the_mirrors_bring_it_to_rest():
    step = 2.4e-4
    regulator = Regulator(Aim(0.0, 0.0, 0.5), 0.6 * step, 5e-3)
    seen = []
    for _ in range(400):
        taken = np.round(regulator.command[0] / step) * step
        error = 0.03 + 0.31 * step - taken
        seen.append(error)
        regulator.next(np.array([error, 0.0]))
    assert abs(seen[-1]) <= 0.6 * step and len(set(seen[-100:])) == 1


def test_a_lost_beam_is_searched_and_found():
    regulator = Regulator(Aim(0.0, 0.0, 0.4), 0.0, 5e-3)
    there = np.array([0.021, -0.013])
    for period in range(3000):
        spot = 2.0 * 0.4 * (there - regulator.command)
        regulator.next(spot if np.abs(spot).max() < 5e-3 else None)
    assert period and not regulator.searching
    np.testing.assert_allclose(regulator.command, there, rtol=1e-3)


def test_aims_pass_as_text_and_bad_ones_are_refused():
    aims = {'a': Aim(0.1, -0.2, 0.4), 'b': Aim(0.0, 1e-17, 2.5)}
    assert aims_of(told(aims)) == aims and aims_of(told({})) == {}
    for bad in ('a=1,2', 'a=1,2,x', 'a=0,0,0', '=1,2,3', 'a=nan,0,1'):
        with pytest.raises(StepdiagError, match='setup=azimuth,elevation,distance'):
            aims_of([bad])
