"""Formulas along a log's own moves: the parameters with which effects do there, in parity space, what was fitted.

The simulator is made to move as the log did (:class:`~stepdiag_ros.twin.twin.Twin`); what counts are the stops' means
and what changes inside the stops.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.optimize import least_squares

from stepdiag_ros.effects.base import Effect, Parameter
from stepdiag_ros.gap.diagnosis import COUNTS, Diagnosis
from stepdiag_ros.gap.inference.joint import Active, unexplained
from stepdiag_ros.twin.guess import Values, guess
from stepdiag_ros.twin.story import basis_of, unknown_starts
from stepdiag_ros.twin.twin import Twin

LOSS = 0.05
"""Share of what was fitted beyond which its loss is reported."""
SHOWS = 5.0
"""Standard deviations that a formula must leave for its details or a course to be looked for."""
SIZE_UNITS = ('m', 'rad', 'K')
"""Units of parameters in which what an effect does is linear."""
BEYOND = 1e3
"""Times by which an effect that leaves no reading at all misses more than none does."""
TRIED = 5
"""Values of a time tried, evenly in logarithm between its bounds, where a fit may begin …"""
BEST = 2
"""… and of these, those that miss the least are refined."""
TRIALS = 60
"""Most steps of one fit."""


@dataclass(frozen=True)
class Wanted:
    """What effects must do as a ``twin`` shows it: ``own`` (N,) in parity space as the forms did, ``rest`` besides as
    they left it; ``basis`` (N, r): what says nothing of them."""

    twin: Twin
    own: np.ndarray
    rest: np.ndarray
    basis: np.ndarray

    @classmethod
    def of(cls, diagnosis: Diagnosis, active: Sequence[Active], twin: Twin,
           moved: np.ndarray | None = None) -> 'Wanted':
        space = diagnosis.joint.parity
        own = sum(space.project(a.form) @ (a.coefficients / a.form.scale) for a in active)
        # What others do to it, and a machine that has moved far, are no sums.
        own = own if moved is None else own + twin.projected(moved[None])[:, 0]
        return cls(twin, own, unexplained(space, diagnosis.joint.active),
                   basis_of(unknown_starts(diagnosis.joint.observation.view), space))

    def told(self, white: np.ndarray) -> np.ndarray:
        """White changes (N,) without what says nothing."""
        return white - self.basis @ (self.basis.T @ white)

    @cached_property
    def target(self) -> np.ndarray:
        return self.told(self.rest + self.own)

    @cached_property
    def noise(self) -> float:
        """Square that is left in any case; what counts is how much more than the forms leave."""
        noise = self.told(self.rest)
        return float(noise @ noise)

    @property
    def power(self) -> float:
        """Square that the forms explain."""
        return max(float(self.target @ self.target) - self.noise, 1e-300)

    def missed(self, *fitted: Effect) -> np.ndarray:
        """What effects leave of it (N,)."""
        with np.errstate(all='ignore'):    # what is tried may be far beyond what light and air are
            made = self.twin.projected(self.twin.adds(*fitted)[None])[:, 0]
        return self.target - self.told(made) if np.isfinite(made).all() else BEYOND * self.target


def together(diagnosis: Diagnosis, twin: Twin) -> dict[str, tuple[Values, Effect]]:
    """Formulas of all effects that have one and were fitted to the stops, found at once, and the effects with them;
    none where a formula is not what happened.

    Each for itself beside the others' forms, two that act on each other settle where neither can leave: a mirror that
    is bent too much behind a detector that is turned too far.
    """
    parts = {found.name: [a for a in diagnosis.joint.active if a.effect.name == found.name]
             for found in diagnosis.effects if found.name != COUNTS}
    parts = {name: active for name, active in parts.items() if active and not active[0].effect.not_adopted}
    if len(parts) < 2:
        return {}
    kinds = {name: type(active[0].effect) for name, active in parts.items()}
    wanted = Wanted.of(diagnosis, [a for active in parts.values() for a in active], twin)

    def split(values: Values) -> dict[str, Values]:
        return {name: {p.name: values[f'{name}.{p.name}'] for p in kind.parameters} for name, kind in kinds.items()}

    alone = {name: formula_of(Wanted.of(diagnosis, active, twin), diagnosis, active)[0]
             for name, active in parts.items()}
    found, left = _refined(
        tuple(replace(p, name=f'{name}.{p.name}') for name, kind in kinds.items() for p in kind.parameters),
        {f'{name}.{key}': value for name, values in alone.items() for key, value in values.items()},
        lambda values: wanted.missed(*(kinds[name](**own) for name, own in split(values).items())))
    if left - wanted.noise > LOSS * wanted.power:
        return {}
    return {name: (formula, kinds[name](**formula)) for name, formula in split(found).items()}


def formula_of(wanted: Wanted, diagnosis: Diagnosis, active: Sequence[Active],
               near: Values | None = None) -> tuple[Values, float]:
    """Parameters with which an effect does the most, and the square that it misses."""
    effect = type(active[0].effect)

    def missed(values: Values) -> np.ndarray:
        return wanted.missed(effect(**values))

    starts = [near] if near else sorted(
        _starts(first_values(diagnosis, active), effect.parameters, wanted.target, missed),
        key=lambda start: np.sum(missed(start)**2))[:BEST]
    formula, left = min((_refined(effect.parameters, start, missed) for start in starts), key=lambda pair: pair[1])
    if left - wanted.noise > SHOWS**2 and any(p.detail for p in effect.parameters):
        detailed, left_then = _refined(effect.parameters, formula, missed, details=True)
        formula, left = (detailed, left_then) if left_then < left - SHOWS**2 else (formula, left)
    return formula, left


def _starts(first: Values, parameters: tuple[Parameter, ...], target: np.ndarray,
            missed: Callable[[Values], np.ndarray]) -> Iterator[Values]:
    """Where fits begin: the guess, and beside it each time of the effect between its bounds, with the sizes that do the
    most there."""
    yield first
    for p in parameters:
        if _is_time(p) and p.size == 1:
            yield from (_scaled(parameters, {**first, p.name: float(value)}, target, missed)
                        for value in np.geomspace(p.low, p.high, TRIED))


def first_values(diagnosis: Diagnosis, active: Sequence[Active]) -> Values:
    """The guess, and the middle of their bounds for parameters of which it says nothing."""
    middle = {p.name: [0.5 * (p.low + p.high)] * p.size if p.size > 1 else 0.5 * (p.low + p.high)
              for p in active[0].effect.parameters}
    return {**middle, **guess(diagnosis, active)}


def _scaled(parameters: tuple[Parameter, ...], start: Values, target: np.ndarray,
            missed: Callable[[Values], np.ndarray]) -> Values:
    """``start`` with its sizes, the parameters in units of what the effect moves, scaled to do the most that they can:
    the sizes that go with one time constant are not those that go with another."""
    sizes = [p.name for p in parameters if p.unit in SIZE_UNITS and not isinstance(start[p.name], str)]
    made = target - missed(start)
    power = float(made @ made)
    factor = float(made @ target) / power if power > 0.0 else 0.0
    if not sizes or factor <= 0.0:
        return start
    return {**start, **{name: (factor * np.asarray(start[name], float)).tolist() for name in sizes}}


def _refined(parameters: tuple[Parameter, ...], start: Values, missed: Callable[[Values], np.ndarray],
             details: bool = False) -> tuple[Values, float]:
    """Parameters near ``start`` that miss the least, and the square that is missed; names and numbers of choices stay
    as they are, and without ``details`` those that the start has not."""
    free = [p for p in parameters if p.high > p.low and not isinstance(start[p.name], str)
            and (details or not p.detail or np.any(start[p.name]))]
    sizes = [p.size for p in free]
    scale = np.concatenate([np.full(p.size, p.high - p.low) for p in free])
    low = np.concatenate([np.full(p.size, 0.2 * p.low if _is_time(p) else 0.0 if p.low == 0.0 else -np.inf)
                          for p in free])
    high = np.concatenate([np.full(p.size, 5.0 * p.high if _is_time(p) else np.inf) for p in free])

    def values(x: np.ndarray) -> Values:
        parts = np.split(x * scale, np.cumsum(sizes)[:-1])
        return {**start, **{p.name: part.tolist() if p.size > 1 else float(part[0])
                            for p, part in zip(free, parts, strict=True)}}

    x0 = np.concatenate([np.broadcast_to(np.asarray(start[p.name], float), (p.size,)) for p in free]) / scale
    x0 = np.clip(x0, low / scale + 1e-9, high / scale - 1e-9)
    # What the log does not tell apart, warmth and pressure of air, stays where it began: 1 is the plausible range.
    result = least_squares(lambda x: np.concatenate([missed(values(x)), x - x0]), x0,
                           bounds=(low / scale, high / scale), x_scale='jac', diff_step=1e-4, max_nfev=TRIALS)
    return values(result.x), 2.0 * float(result.cost)


def _is_time(parameter: Parameter) -> bool:
    """Whether it is a time constant or a period: positive, and known in order of magnitude."""
    return parameter.unit == 's' and parameter.low > 0.0
