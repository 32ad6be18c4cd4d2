"""The axis is still creeping in when the dwell begins.

The control says in position while the slide still lags behind: by ``amp`` at the dwell's start, dying
away as ``exp(−t/τ)``, on the side it came from.  The mean of the dwell keeps a part of it; inside
the dwell the readings creep, which nothing else does in step with the moves.
"""

from collections.abc import Mapping

import numpy as np

from stepdiag_ros.effects.adoption import Fitted
from stepdiag_ros.effects.base import Effect, Form, Moment, Parameter, StopView
from stepdiag_ros.effects.fading import bin_means, fading_columns, last_arrivals, swing_means
from stepdiag_ros.effects.made import joined
from stepdiag_ros.effects.patterns import Drawn
from stepdiag_ros.model.log import NONE

TAUS = (0.025, 0.048, 0.09, 0.17, 0.33, 0.62, 1.2)
"""Time constants [s] that are tried; the best is tuned."""
FEW = (0.048, 0.17, 0.62)
"""Those that are tried together, and for single axes."""
TOGETHER = {'all axes alike': ('all',), 'each axis': ('X', 'Y', 'Z')}
GROUPS = {**TOGETHER, **{f'{axis} alone': (axis,) for axis in 'XYZ'}}
"""Axes that creep in, and the sizes that they have; one axis is often tuned worse than the others."""
TYPICAL_M = 3e-7
"""Size of what is left at the dwell's begin; inside the dwells a hundredth of that is seen."""
SLOWER = 4.0
"""Times as long as the servo's own that a cell may let its axes creep on with."""
SWINGS = (1.5, 3.0, 5.0, 8.0)
"""Frequencies [Hz] tried of a servo that swings in …"""
SWING_TAU, CREEP_TAU = 0.1, 0.3
"""… which dies away with the first time constant [s], beside a creep with the second; both are tuned."""


class ServoSettling(Effect):
    name = 'servo_settling'
    short = 'Axis still creeps at the stop'
    needs_dwells = True
    title = 'An axis still creeps towards its position when the measurement at a stop begins.'
    parameters = (Parameter('amp', 'm', 0.0, 2e-5, 3, 'lag of X, Y, Z when the dwell begins; one number: of all'),
                  Parameter('tau', 's', 0.03, 1.0, meaning='time constant'),
                  Parameter('slow', 'm', -2e-5, 2e-5, 3, f'besides, what dies away {SLOWER:g} times as slowly',
                            detail=True))
    sources = ('Altintas et al. 2011, CIRP Annals 60, 779 (feed drives)', 'ISO 230-2, dwell at the target')
    remedy = 'Wait longer before the dwell, narrow the in-position window, tune the servo.'
    signature = 'Exponential creep inside each dwell, along the axis that moved, towards where it went.'
    neighbours = ('backlash is as large but still; vibration swings to both sides; '
                  'structural_thermal_drift is slow against a dwell.')

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Drawn:
        return {'amp': float(np.exp(rng.uniform(np.log(3e-7), np.log(2e-5)))),
                'tau': float(np.exp(rng.uniform(np.log(0.04), np.log(0.8))))}

    def before_pose(self, moment: Moment) -> None:
        # Before arrival the lag rises to its full size, so that nothing jumps when the dwell begins.
        since = np.where(moment.since_arrival >= 0.0, -moment.since_arrival / self.tau,
                         np.minimum(moment.since_arrival, 0.0) / min(self.tau, 0.05))[:, None]
        left = self.amp * np.exp(since) + self.slow * np.exp(since / SLOWER)
        # After a move of several axes, to a setup's start, there is time before the reset.
        moving = moment.moved[:, None] == np.arange(3)
        moment.position = moment.position - left * moving * moment.approach

    def appearance(self, view: StopView) -> list[Form]:
        forms = []
        for start, (along, before) in self._directions(view).items():
            since = view.bin_time + before[:, None]
            each = {(tau, axes): self._form(along, since, start, tau, axes) for axes in GROUPS
                    for tau in (TAUS if axes in TOGETHER else FEW)}
            forms += each.values()
            # Servo and structure have time constants of their own.
            forms += [self._sum([each[tau, axes] for tau in FEW]) for axes in TOGETHER]
            forms += [self._swinging(along, since, start, SWING_TAU, swing, CREEP_TAU) for swing in SWINGS]
        return forms

    @staticmethod
    def _sum(forms: list[Form]) -> Form:
        """Several time constants at once, each with its own size."""
        return Form(' and '.join(form.label for form in forms), joined([f.columns for f in forms]),
                    tuple(f'{name}, τ = {f.shape["tau_s"]:g} s' for f in forms for name in f.names),
                    np.concatenate([f.scale for f in forms]),
                    inside=joined([f.inside for f in forms]))

    @staticmethod
    def _directions(view: StopView) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        """Where the lag points, (3, n, c) of readings per metre, and how long [s] (n,) before the dwell the axis
        arrived; by what happens at a run's first stop."""
        moved, before = last_arrivals(view)
        found = {'': (-(moved * view.approach).T[:, :, None] * view.by_shift, before)}
        # The move to a run's start may be a short while ago too; where several axes moved there was time.
        step = np.sign(np.diff(view.commanded, axis=0, prepend=view.commanded[:1]))
        single = (np.abs(step).sum(axis=1) == 1.0) & (view.axis == NONE)
        if single.any():
            sign = np.where(single[:, None], step, moved * view.approach)
            found[', at the first stops too'] = -sign.T[:, :, None] * view.by_shift, before
        return found

    def _form(self, along: np.ndarray, since: np.ndarray, start: str, tau: float, axes: str) -> Form:
        """One time constant of ``axes``, one of GROUPS."""
        names = GROUPS[axes]
        chosen = along.sum(axis=0, keepdims=True) if names == ('all',) else along[['XYZ'.index(axis) for axis in names]]
        columns, inside = fading_columns(chosen, bin_means(since, tau)[None])
        return Form(f'τ = {tau:.3g} s{start}, {axes}', columns, names,
                    np.full(len(names), TYPICAL_M), inside=inside, shape={'tau_s': tau},
                    retune=lambda shape: self._form(along, since, start, shape['tau_s'], axes))

    def _swinging(self, along: np.ndarray, since: np.ndarray, start: str, tau: float, swing: float,
                  creep: float) -> Form:
        """A loop of low damping swings to its goal, and something slower creeps after it; each axis for itself."""
        shapes = np.stack([*swing_means(since, tau, swing), bin_means(since, creep)])
        columns, inside = fading_columns(along, shapes)
        names = tuple(f'{axis} {part}' for axis in 'XYZ' for part in ('cos', 'sin', 'creep'))
        return Form(f'swings at {swing:.3g} Hz, τ = {tau:.3g} s, creeps with {creep:.3g} s{start}, each axis',
                    columns, names, np.full(9, TYPICAL_M), inside=inside,
                    shape={'tau_s': tau, 'swing_Hz': swing, 'creep_s': creep},
                    retune=lambda shape: self._swinging(along, since, start, shape['tau_s'],
                                                        shape['swing_Hz'], shape['creep_s']))

    def guess(self, fitted: Fitted) -> Mapping[str, object]:
        values, shape = fitted.values, fitted.forms[0].shape
        sizes = [values.get(a, values.get('all', 0.0)) for a in 'XYZ']
        return {'amp': sizes, 'tau': shape['tau_s']} if 'tau_s' in shape else {}
