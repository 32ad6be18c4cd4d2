"""Time profiles that a slow effect may take: no drift follows one formula.

Each profile is one or a few functions of time, of order one over the log, that an effect
multiplies with its signature.  All are zero when the log begins: the errors that remain are those of
the machine at its beginning, whatever drifted afterwards.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from stepdiag_ros.effects.base import Form, StopView
from stepdiag_ros.effects.made import Product

MOST_WAVES = 40
STOPS_A_WAVE = 8
"""Half waves of an unknown profile: at most as many, and one for each so many stops."""
WATCH_WAVES = 5
"""Half waves of its own that a watch has, where the log looks on so closely that those of the whole are too coarse."""
ROUGHNESS = {'winding': 1.0, 'smooth': 2.0}
"""An unknown profile's half waves fall with this power of their number: a walk at random, and one whose rate
walks at random."""
TAU_FRACTIONS = (0.03, 0.06, 0.12, 0.25, 0.5, 1.0)
PERIOD_FRACTIONS = (1.0, 0.7, 0.5, 0.35)
EARLY = 0.02
"""Share of the log's length before which a profile that slows down has nothing to slow down from."""
SLOWING, SLOWING_WAVES = 'slowing', 8


@dataclass(frozen=True)
class TimeProfile:
    """``values`` (k, n) over the times and their ``rates`` (k, n) [1/s]; ``label``; ``shape`` parameters;
    ``retune``: the profile with other ones, None where there are none; ``sizes`` (k,): typical size of each
    function, None where all are alike."""

    label: str
    values: np.ndarray
    rates: np.ndarray
    shape: dict[str, float]
    retune: Callable[[Mapping[str, float]], 'TimeProfile'] | None = None
    sizes: np.ndarray | None = None


def linear(time: np.ndarray) -> TimeProfile:
    """A straight line over ``time`` (n,) [s], one over the log."""
    span = max(float(np.ptp(time)), 1e-9)
    return TimeProfile('linear', (time / span)[None], np.full((1, len(time)), 1.0 / span), {})


def exponential(since: np.ndarray, tau: float) -> TimeProfile:
    """``1 − exp(−t/τ)`` over ``since`` (n,) [s]."""
    fading = np.exp(-since / tau)[None]
    return TimeProfile(f'exponential, τ = {tau:.0f} s', 1.0 - fading, fading / tau, {'tau_s': tau},
                  lambda shape: exponential(since, shape['tau_s']))


def cycle(since: np.ndarray, period: float) -> TimeProfile:
    """A sine and a cosine of ``period`` [s] over ``since`` (n,) [s], both zero at 0."""
    angular = 2.0 * np.pi / period
    phase = angular * since
    return TimeProfile(f'cycle of {period:.0f} s', np.stack([np.sin(phase), np.cos(phase) - 1.0]),
                  angular * np.stack([np.cos(phase), -np.sin(phase)]), {'period_s': period},
                  lambda shape: cycle(since, shape['period_s']))


def unknown(time: np.ndarray, watches: Sequence[np.ndarray] = (), most: int = MOST_WAVES) -> list[TimeProfile]:
    """Time profiles of no known formula over ``time`` (n,) [s] since the log began: a straight line and half waves
    whose typical sizes fall with their number.

    ``cos(kπt/T)/k`` are the Karhunen-Loève functions of a walk at random (its mean left out), so their
    coefficients are a Gaussian process: how fine a profile is taken to be costs no more evidence than it
    needs.  At most ``most`` of them are taken.  All begin at zero.  In each of ``watches``, stops (k,) that follow each
    other, there are finer ones: between its ends a walk is a bridge independent of all else (Lévy's construction), in
    the same units ``√(ℓ/T) sin(jπs/ℓ)/j``.
    """
    span = max(float(time.max()), 1e-9)
    share = time / span
    number = np.arange(1, int(np.clip(len(time) // STOPS_A_WAVE, 5, most)) + 1)
    values, slopes = _half_waves(share, number)
    rates = slopes / span
    bridges = [_bridge(time, watch) for watch in watches]
    values = np.concatenate([values, *(bridge for bridge, _, _ in bridges)])
    rates = np.concatenate([rates, *(rate for _, rate, _ in bridges)])
    closer = np.arange(1.0, WATCH_WAVES + 1)
    return [TimeProfile(label, values, rates, {}, sizes=np.concatenate(
        [[1.0], number**-power, *((length / span)**(power - 0.5) * closer**-power for _, _, length in bridges)]))
        for label, power in ROUGHNESS.items()]


def _half_waves(share: np.ndarray, number: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A straight line and ``number`` (k,) half waves over ``share`` (n,), 0 … 1, all zero at 0: (1 + k, n), and their
    slopes."""
    phase = np.pi * number[:, None] * share
    return (np.concatenate([share[None], np.cos(phase) - 1.0]),
            np.concatenate([np.ones((1, len(share))), -np.pi * number[:, None] * np.sin(phase)]))


def slowing(time: np.ndarray) -> TimeProfile:
    """A profile of no known formula that slows down as it goes on, over ``time`` (n,) [s] since the log began.

    What relaxes, warms up or ages does so on many time constants at once, each as likely as any ten times as
    long: it is smooth in the logarithm of time, ``u = ln(1 + t/t₀)``, and the straight line in u is the plainest case.
    """
    early = EARLY * max(float(time.max()), 1e-9)
    late, rate = np.log1p(time / early), 1.0 / (early + time)
    span = max(float(late.max()), 1e-9)
    number = np.arange(1, SLOWING_WAVES + 1)
    values, slopes = _half_waves(late / span, number)
    return TimeProfile(SLOWING, values, slopes * rate / span, {},
                  sizes=np.concatenate([[1.0], number**-ROUGHNESS['smooth']]))


def _bridge(time: np.ndarray, watch: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Half waves (k, n) between the ends of a watch, zero elsewhere, their rates, and its length [s]."""
    begin, length = time[watch[0]], time[watch[-1]] - time[watch[0]]
    angular = np.pi / length * np.arange(1, WATCH_WAVES + 1)[:, None]
    phase, during = angular * (time - begin), np.isin(np.arange(len(time)), watch)
    return np.sin(phase) * during, angular * np.cos(phase) * during, length


def time_profiles(time: np.ndarray, watches: Sequence[np.ndarray] = ()) -> list[TimeProfile]:
    """Time profiles over ``time`` (n,) [s] since the log began: linear, exponentials of several time constants,
    cycles, unknown ones and one that slows down; ``watches`` as :func:`unknown` takes them."""
    span = max(float(np.ptp(time)), 1e-9)
    result = [linear(time)]
    result += [exponential(time, fraction * span) for fraction in TAU_FRACTIONS]
    result += [cycle(time, fraction * span) for fraction in PERIOD_FRACTIONS]
    return [*result, *unknown(time, watches), slowing(time)]


def with_constant(profile: TimeProfile) -> TimeProfile:
    """The profile and, before it, a constant of typical size one: what is there always, and how it changes."""
    one = np.ones((1, profile.values.shape[1]))
    retune = None if profile.retune is None else lambda shape: with_constant(profile.retune(shape))
    return TimeProfile(profile.label, np.concatenate([one, profile.values]), np.concatenate([0.0 * one, profile.rates]),
                  profile.shape, retune, None if profile.sizes is None else np.concatenate([[1.0], profile.sizes]))


def drift_form(view: StopView, profile: TimeProfile, signature: np.ndarray, names: tuple[str, ...],
               scale: np.ndarray, label: str = '', units: str = 'm', begun: bool = False) -> Form:
    """A signature (m, n, c) that follows a profile: columns at the stops and the slope inside the dwells.

    ``names`` (m,) and ``scale`` (m,) belong to the signature; each is repeated for every function
    of the profile.  ``begun``: it may have acted before the log began, which no reading shows and the errors of the
    machine do: as much as in the log may have been there all the while.
    """
    if stranger := next((name for name in names if not isinstance(name, str)), None):
        raise TypeError(f'names holds a {type(stranger).__name__}; give a text for each row of the signature')
    count = len(profile.values)
    return Form(f'{label}{", " if label else ""}{profile.label}', Product(profile.values, signature),
                tuple(f'{name}{i or ""}' for i in range(count) for name in names),
                (np.tile(scale, count) if profile.sizes is None else np.outer(profile.sizes, scale).ravel()),
                units, Product(profile.rates, signature, view.off_middle), profile.shape,
                None if profile.retune is None else lambda shape: drift_form(
                    view, profile.retune(shape), signature, names, scale, label, units, begun),
                process=profile.sizes is not None,
                beside=Form(f'{label}{", " if label else ""}before the log', signature, names, scale, units)
                if begun else None)
