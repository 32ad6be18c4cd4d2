"""Lean patterns from physics that no effect of the vocabulary has.

A shapeless pattern of many columns pays so much for what it could have fitted that a wrong name with few columns
beats it.  What physics may do beside the vocabulary is therefore offered in few parameters too: what acts in another
cell of the table of where and how (:mod:`~stepdiag_ros.gap.alternatives.where_and_how`), and what is no cell of it:
readings bent at long range, the spot that leaks into the length or the length into the spot, a detector that is sheared
or has another gain on one side of its middle, a standoff that is not as described, readings that follow the light
received (a beam cut by the mirror's edge), a mirror's arm or a laser's stand that rings after each move, a mirror that
slips in its mount.  None has a name here; which of them a log shows is reported in its label.
"""

from collections.abc import Iterator
from itertools import product

import numpy as np

from stepdiag_ros.effects.base import Effect, Form, StopView
from stepdiag_ros.effects.fading import by_last_moves, fading_columns, last_arrivals, swing_means
from stepdiag_ros.effects.tuning import tunable
from stepdiag_ros.gap.alternatives.unmodelled import NAME, lasting_jumps, pattern_form
from stepdiag_ros.gap.alternatives.where_and_how import BEARINGS, table_families

KNEES = (0.2, 0.35, 0.5, 0.65, 0.8)
"""Shares of the range of lengths tried beyond which a reading is bent, or at which a leak of it saturates; tuned."""
LAST_KNEE = 0.95
SPOTS_M = (2.5e-4, 4e-4, 6.3e-4, 1e-3)
"""Spots from which a leak saturates [m], so close that between two of them little is lost; tuned."""
LEAST_MISSING = 0.01
"""Standard deviation of the light that is missing, as a share of the most, from which readings may follow it."""
RINGS = 8
"""Directions in the detector's plane, evenly over half a turn."""
RINGS = (1.5, 3.0, 5.0, 8.0, 12.0)
"""Frequencies [Hz] tried of what rings, …"""
RING_TAU = 0.1
"""… with the time constant [s] with which it dies away; both are tuned."""


class Beyond(Effect):
    """All of these as one effect without a name, for those who ask what it would do in a further run."""

    name = NAME
    title = 'Something that no effect known here does.'

    def appearance(self, view: StopView) -> list[Form]:
        return [form for forms in beyond_families(view).values() for form in forms]


def beyond_families(view: StopView) -> dict[str, list[Form]]:
    """The forms by family; each counts as one effect does, however many forms it has."""
    families = {'range': _at_long_range(view), 'leak': _leak(view),
                'detector': _detector(view), 'standoff': _standoff(view), 'light': _light(view),
                'ring': _ringing(view), 'slip': lasting_jumps(view, 'mirror', view.by_mirror, 1e-5)}
    forms = {family: list(found) for family, found in families.items()} | table_families(view)
    return {family: found for family, found in forms.items() if found}


def _lengths(view: StopView, label: str, patterns: np.ndarray, scale: float) -> Form:
    return pattern_form(view, label, patterns, slice(0, view.beams), scale)


def _at_long_range(view: StopView) -> Iterator[Form]:
    """Lengths compressed or stretched beyond a part of the range, straight on or as the square."""
    far = view.distance / max(float(np.nanmax(np.abs(view.distance))), 1e-9)
    yield from (_bent(view, far, knee) for knee in KNEES)
    yield _lengths(view, 'displacement: bent over the range', np.stack([far**2, far**3]), 2e-6)


def _bent(view: StopView, far: np.ndarray, knee: float) -> Form:
    """Lengths bent where the share ``far`` (n, beams) of their range is beyond a ``knee``."""
    knee = min(knee, LAST_KNEE)
    excess = np.maximum(far - knee, 0.0) / (1.0 - knee)
    return tunable(_lengths(view, f'displacement: bent beyond {100 * knee:.0f} % of the range', excess[None]**2, 2e-6),
                    'knee', knee, lambda other: _bent(view, far, other))


def _leak(view: StopView) -> Iterator[Form]:
    """The spot shows in the length: by its distance from the middle, or along one direction, saturating; or the length
    in the spot."""
    spot = view.spot_model
    radius = np.linalg.norm(spot, axis=1) / 1e-3
    size = max(float(np.nanmax(radius)), 1e-3)
    yield _lengths(view, "displacement: follows the spot's distance, squared", (radius / size)[None] ** 2, 1e-6)
    yield _lengths(view, "displacement: follows the spot's distance, squared and cubed",
                   np.stack([(radius / size) ** 2, (radius / size) ** 3]), 1e-6)
    for angle in np.arange(BEARINGS) * np.pi / BEARINGS:
        yield from (_leaking(view, float(angle), knee) for knee in SPOTS_M)
    # And the other way about, anywhere in the detector's plane: the length to the mirror, or as it is counted.
    distance = view.distance[:, 0]
    for what, length in (('distance', distance), ('displacement', distance - np.nanmin(distance))):
        most = max(float(np.nanmax(length)), 1e-9)
        yield from (_followed(view, what, length, knee * most) for knee in KNEES)


def _leaking(view: StopView, angle: float, knee: float) -> Form:
    """The spot along a bearing [rad] shows in the length, saturating at ``knee`` [m]."""
    spot = view.spot_model
    along, across = spot @ (np.cos(angle), np.sin(angle)), spot @ (-np.sin(angle), np.cos(angle))
    leak = np.tanh(along / knee)
    # Between two bearings to first order: half a mesh away a strong leak would fit no longer.
    between = np.pi / BEARINGS / np.sqrt(12.0)
    return tunable(_lengths(
        view, f'displacement: follows the spot at {np.degrees(angle):.0f}°, saturating at {knee * 1e3:.1g} mm',
        np.stack([leak, between * (1.0 - leak**2) * across / knee]), 1e-6),
        'knee_m', knee, lambda other: _leaking(view, angle, other))


def _followed(view: StopView, what: str, length: np.ndarray, knee: float) -> Form:
    """The ``length`` (n,) [m], in words ``what``, shows in the spot, saturating at ``knee`` [m]."""
    columns = view.zeros(2)
    columns[0, :, view.beams] = columns[1, :, view.beams + 1] = np.tanh(length / knee)
    form = Form(f'spot: follows the {what}, saturating at {knee:.2g} m', columns, ('x', 'y'), np.full(2, 3e-6))
    return tunable(form, 'knee_m', knee, lambda other: _followed(view, what, length, other))


def _detector(view: StopView) -> Iterator[Form]:
    """The detector's axes are not square to each other, or its gain differs between the sides of its middle."""
    spot, x = view.spot_model, view.beams
    if not np.any(spot):
        return
    across = view.zeros(2)
    across[0, :, x], across[1, :, x + 1] = spot[:, 1], spot[:, 0]
    for turned, columns in (('', across.sum(axis=0, keepdims=True)), (', y alone is turned', across[:1]),
                            (', x alone is turned', across[1:])):
        yield Form(f'spot: the axes of the detector are not square{turned}', columns, ('shear',), np.full(1, 0.02), '1')
    for along, across in product(range(2), repeat=2):
        for side, half in (('above', spot[:, along] > 0.0), ('below', spot[:, along] < 0.0)):
            columns = view.zeros(1)
            columns[0, :, x + across] = np.where(half, spot[:, across], 0.0)
            if np.any(columns):
                yield Form(f'spot_{"xy"[across]}: another gain {side} {"xy"[along]} = 0', columns, ('gain',),
                           np.full(1, 0.02), '1')


def _standoff(view: StopView) -> Iterator[Form]:
    """A standoff other than the description says: the spot of a given tilt grows with the length of the path."""
    columns = view.zeros(1)
    columns[0, :, view.beams:] = view.spot_model / np.maximum(view.distance[:, :1], 1e-3)
    if not np.any(columns):
        return
    yield Form('the description: the standoff of all setups is off', columns, ('standoff',), np.full(1, 1e-2))
    for number in np.unique(view.setup):
        yield Form(f'the description: the standoff of {view.setup_names[number]} is off',
                   columns * (view.setup == number)[:, None], ('standoff',), np.full(1, 1e-2))


def _light(view: StopView) -> Iterator[Form]:
    """Lengths and spots follow the light that is received, as where the mirror's edge cuts the beam."""
    for name, signal in (('intensity', view.intensity), ('signal quality', view.quality)):
        level = np.nanmax(signal) if np.isfinite(signal).any() else 0.0
        if level <= 0.0 or not np.isfinite(signal).all():
            continue
        missing = 1.0 - signal / level
        if missing.std() < LEAST_MISSING:
            continue
        share = missing / missing.max()
        columns = np.einsum('n,kc->knc', share, np.eye(view.beams + 2))
        columns[:view.beams] = columns[:view.beams].sum(axis=0) / np.sqrt(view.beams)
        own = np.concatenate([columns[:1], columns[view.beams:]])
        yield Form(f'lengths and spots follow the {name}', own, ('length', 'spot_x', 'spot_y'), np.full(3, 3e-6))


def _ringing(view: StopView) -> Iterator[Form]:
    """The mirror or the beam swings about its direction after each arrival and dies away: struck alike by each, or by
    each axis in the direction in which it moved."""
    if view.bin_time.shape[1] < 2:
        return
    moved, before = last_arrivals(view)
    since = view.bin_time + before[:, None]
    for what, derivative in (('mirror', view.by_mirror), ('beam', view.by_laser)):
        alike = derivative * moved.any(axis=1)[:, None]
        by_axis = by_last_moves(view, moved, derivative)
        for how, along in (('each move', alike), ('the moves of each axis', by_axis)):
            for hertz in RINGS:
                yield _ring(since, f'{what}: rings after {how}', along, hertz, RING_TAU)


def _ring(since: np.ndarray, label: str, along: np.ndarray, hertz: float, tau: float) -> Form:
    columns, inside = fading_columns(along, swing_means(since, tau, hertz))
    return Form(f'{label} at {hertz:.3g} Hz, τ = {tau:.2g} s', columns, tuple(str(i) for i in range(len(columns))),
                np.full(len(columns), 2e-6), 'rad', inside=inside, shape={'frequency_Hz': hertz, 'tau_s': tau},
                retune=lambda shape: _ring(since, label, along, shape['frequency_Hz'], shape['tau_s']))
