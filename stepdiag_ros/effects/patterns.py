"""Columns that several effects share: a signature that follows a time profile, one for each setup."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from stepdiag_ros.effects.base import Form, StopView
from stepdiag_ros.effects.made import Product
from stepdiag_ros.effects.timeforms import SLOWING, TimeProfile, drift_form, exponential, time_profiles, unknown

BETWEEN_SETUPS = 0.1
"""Standard deviation from setup to setup of what is nearly the same in all, as a share of it."""


def follow(view: StopView, profile: TimeProfile, signature: np.ndarray, names: tuple[str, ...], scale: float,
           units: str = 'm', label: str = '', begun: bool = False) -> Form:
    """:func:`~stepdiag_ros.effects.timeforms.drift_form` with one typical size for all coefficients."""
    return drift_form(view, profile, signature, names, np.full(len(names), scale), label, units, begun)


def each_alone(view: StopView, pace: Iterable[TimeProfile], signature: np.ndarray, names: tuple[str, ...],
               scale: float, units: str = 'm', label: str = '', begun: bool = False) -> list[Form]:
    """Forms for each row of ``signature`` (m, n, c) by itself: often one axis warms and the others hardly.

    Rows that this log cannot show, an axis that never moved, have none; nor have cycles and what slows down, which
    an unknown profile follows as well and which all rows together have.
    """
    return [follow(view, profile, row[None], (name,), scale, units, f'{name} alone{label}', begun)
            for profile in pace if 'period_s' not in profile.shape and profile.label != SLOWING
            for row, name in zip(signature, names, strict=True) if np.any(row)]


def by_setup(view: StopView, columns: np.ndarray,
             names: tuple[str, ...]) -> tuple[np.ndarray, tuple[str, ...]]:
    """``columns`` (k, n, c) with coefficients of their own in each setup that was measured."""
    parts, own = [], []
    for number in np.unique(view.setup):
        parts.append(columns * (view.setup == number)[:, None])
        own += [f'{view.setup_names[number]} {name}' for name in names]
    return np.concatenate(parts), tuple(own)


def nearly_alike(view: StopView, columns: np.ndarray, names: tuple[str, ...], size: float,
                 units: str = 'm') -> list[Form]:
    """``columns`` (k, n, c) with the same coefficients in all setups, and with coefficients that differ a
    little from setup to setup: what is turned or taken off for a setup does not come back to the same."""
    forms = [Form('constant', columns, names, np.full(len(names), size), units)]
    if len(np.unique(view.setup)) > 1:
        own, own_names = by_setup(view, columns, names)
        forms.append(Form('nearly the same in each setup', np.concatenate([columns, own]),
                          (*names, *own_names),
                          size * np.concatenate([np.ones(len(names)), np.full(len(own), BETWEEN_SETUPS)]),
                          units, process=True))
    return forms


def on_lengths(view: StopView, values: np.ndarray) -> np.ndarray:
    """A column (n, c) that holds ``values`` (n,) or (n, beams) on every beam, nothing on the spot."""
    column = np.zeros(view.reading.shape)
    column[:, :view.beams] = values if values.ndim == 2 else values[:, None]
    return column


def saturating(seconds: np.ndarray, tau: float) -> np.ndarray:
    """``1 − exp(−t/τ)`` (n,), zero before the start."""
    return -np.expm1(-np.maximum(seconds, 0.0) / tau)


def recorded(view: StopView, values: np.ndarray, label: str) -> TimeProfile:
    """A profile that was itself measured, ``values`` (k, n): its rates from a smooth line through each run."""
    rates = np.zeros_like(values)
    for run in np.unique(view.run):
        rows = view.run == run
        time = view.time[rows] - view.time[rows].mean()
        span = float(np.ptp(time))
        if span <= 0.0:
            continue
        degree = min(3, max(1, int(rows.sum()) // 8))
        powers = (time / span)[:, None] ** np.arange(degree + 1)
        steps = np.arange(1, degree + 1)
        slopes = steps * powers[:, :degree] / span
        rates[:, rows] = (slopes @ np.linalg.lstsq(powers, values[:, rows].T, rcond=None)[0][1:]).T
    return TimeProfile(label, values, rates, {})


RELAXING_FRACTIONS = (0.003, 0.01, 0.03, 0.1, 0.3, 1.0)
"""Time constants of what relaxes, as shares of the longest time."""
SHORTEST = 0.1
"""In a short log the least time constant is this share of the longest time."""


def settlings(time: np.ndarray, fastest: float) -> list[TimeProfile]:
    """What settles after a beginning at time 0 in one way: linear, exponential with a time constant not below
    ``fastest`` [s]; ``time`` (n,) [s]."""
    span, least = _limits(time, fastest)
    return [TimeProfile('linear', (time / span)[None], np.full((1, len(time)), 1.0 / span), {})] + [
        _not_below(least, time, tau) for tau in _time_constants(span, least)]


def relaxations(time: np.ndarray, fastest: float = 0.0) -> list[TimeProfile]:
    """:func:`settlings`, logarithmic with a start not before ``fastest`` [s], as a power, two exponentials in one
    ratio."""
    span, least = _limits(time, fastest)
    return settlings(time, fastest) + [
        *(_logarithm(time, start, span, least)
          for start in dict.fromkeys(max(share * span, least) for share in (0.01, 0.1))),
        power_law(time, 0.5), _two(time, 0.1 * span, span)]


def relaxing(time: np.ndarray, fastest: float) -> TimeProfile:
    """What relaxes after a beginning at time 0 in no known way, ``time`` (n,) [s]: on many time constants at once, none
    below ``fastest`` [s], each by an amount of its own.

    Glue and clamped metal relax on a whole spectrum of time constants; logarithm and power law are two of those.
    """
    each = [exponential(time, tau) for tau in _time_constants(*_limits(time, fastest))]
    return TimeProfile('many time constants', np.concatenate([c.values for c in each]),
                  np.concatenate([c.rates for c in each]), {}, sizes=np.ones(len(each)))


def _limits(time: np.ndarray, fastest: float) -> tuple[float, float]:
    """The longest time and the least time constant [s]."""
    span = max(float(time.max()), 1e-9)
    return span, min(fastest, SHORTEST * span)


def _time_constants(span: float, least: float) -> list[float]:
    return list(dict.fromkeys(max(fraction * span, least) for fraction in RELAXING_FRACTIONS))


def _not_below(fastest: float, time: np.ndarray, tau: float) -> TimeProfile:
    """An exponential whose time constant never gets below ``fastest`` [s]."""
    return replace(exponential(time, max(tau, fastest)),
                   retune=lambda shape: _not_below(fastest, time, shape['tau_s']))


def _logarithm(time: np.ndarray, start: float, span: float, earliest: float) -> TimeProfile:
    start = max(start, earliest)
    size = np.log1p(span / start)
    return TimeProfile(f'logarithmic from {start:.0f} s', np.log1p(time / start)[None] / size,
                  1.0 / (start + time)[None] / size, {'start_s': start},
                  lambda shape: _logarithm(time, shape['start_s'], span, earliest))


def power_law(time: np.ndarray, exponent: float) -> TimeProfile:
    """A power law after a beginning at time 0; the first second, in which its rate may have no bound, is left out."""
    span, _ = _limits(time, 0.0)
    since = np.maximum(time, 1.0) / span
    return TimeProfile(f'power {exponent:.2f}', since[None] ** exponent,
                  exponent / span * since[None] ** (exponent - 1.0), {'exponent': exponent},
                  lambda shape: power_law(time, shape['exponent']))


def _two(time: np.ndarray, fast: float, slow: float, ratio: float = 1.0) -> TimeProfile:
    """Two exponentials in one ratio, slow to fast: what gives way once more does so by another amount, not in another
    way."""
    both, weights = [exponential(time, tau) for tau in (fast, slow)], np.array([1.0, ratio]) / (1.0 + ratio)
    return TimeProfile(f'exponentials, τ = {fast:.0f} s and {slow:.0f} s, 1 : {ratio:.2g}',
                  sum(w * c.values for w, c in zip(weights, both, strict=True)),
                  sum(w * c.rates for w, c in zip(weights, both, strict=True)),
                  {'fast_s': fast, 'slow_s': slow, 'ratio': ratio},
                  lambda shape: _two(time, shape['fast_s'], shape['slow_s'], shape['ratio']))


ANEW_S = 20.0
"""Least time constant [s] of what begins anew with a run or a setup: what is over sooner is a jump."""
ANEW_WAVES = 6
"""Half waves of an unknown profile that begins anew."""
BETWEEN_PARTS = 0.3
"""Standard deviation from one to the next of the amount of what begins anew nearly alike, as a share of it."""
MOST_JUMPS = 500
"""Places at which something may jump that are tried in a log; a longer log is tried at every second, third …"""
MOST_OWN = 40
"""Parts of a log up to which each may have an amount of its own; with more the whole log's unknown profile tells."""


def drift_profiles(view: StopView) -> list[TimeProfile]:
    """Time profiles of a drift, whatever drifts: those that begin with the log
    (:func:`~stepdiag_ros.effects.timeforms.time_profiles`), and those that begin anew with each run or setup, alike in
    all of them or by an amount of its own in each."""
    return [*time_profiles(view.elapsed, view.watches), *anew(view.run_time, view.run, 'run'),
            *anew(view.mount_time, view.setup, 'setup')]


def at_once(view: StopView, signature: np.ndarray, names: tuple[str, ...], scale: float, units: str) -> list[Form]:
    """Forms of what changes at once: from one of the stops on, which of them is not known."""
    return [Form(f'from {view.run_ids[view.run[stop]]} stop {view.index[stop]} on',
                 Product((view.time >= view.time[stop]).astype(float)[None], signature), names,
                 np.full(len(names), scale), units, family='at once')
            for stop in at_most(np.argsort(view.time, kind='stable')[1:])]


def at_most(places: Sequence[int]) -> Sequence[int]:
    """Every one of some places, or every second, third … where they are too many to be tried."""
    return places[::max(1, -(-len(places) // MOST_JUMPS))]


def anew(since: np.ndarray, part: np.ndarray, what: str) -> list[TimeProfile]:
    """Profiles that begin anew in each ``part`` (n,) of the log, ``since`` (n,) [s] counted from there."""
    parts = np.unique(part)
    if len(parts) < 2:
        return []
    plain = settlings(since, ANEW_S)
    smooth = unknown(since, most=ANEW_WAVES)[-1]
    profiles = [_relabelled(profile, f'anew in each {what}, ') for profile in (*plain, smooth)]
    if len(parts) <= MOST_OWN:
        mask = part == parts[:, None]
        some = plain[::3]
        own, rates = (np.concatenate([one * mask for one in each])
                      for each in ([p.values for p in some], [p.rates for p in some]))
        profiles += [
            TimeProfile(f'by its own amount in each {what}', own, rates, {}, sizes=np.ones(len(own))),
            TimeProfile(f'nearly alike in each {what}', np.concatenate([smooth.values, own]),
                        np.concatenate([smooth.rates, rates]), {},
                        sizes=np.concatenate([smooth.sizes, np.full(len(own), BETWEEN_PARTS)]))]
    return profiles


def _relabelled(profile: TimeProfile, before: str) -> TimeProfile:
    retune = None if profile.retune is None else lambda shape: _relabelled(profile.retune(shape), before)
    return replace(profile, label=before + profile.label, retune=retune)


def drawn_size(rng: np.random.Generator, low: float, high: float, size: int | None = None
               ) -> float | list[float]:
    """Sizes spread evenly over the orders of magnitude from ``low`` to ``high``, of either sign."""
    value = np.exp(rng.uniform(np.log(low), np.log(high), size)) * rng.choice([-1.0, 1.0], size)
    return float(value) if size is None else value.tolist()


Drawn = Mapping[str, object]
"""Parameters of an effect by name, as :meth:`Effect.draw` gives and a cell file holds them."""
