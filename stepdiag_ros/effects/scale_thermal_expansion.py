"""An axis's scale grows with its temperature during the log.

A scale that is warmer by ``ΔT`` is longer by ``α ΔT`` of its length: the axis goes ``α ΔT x`` too far.
What it was at the start belongs to the positioning error; what changes during the log does not.  Glass
scales have 8e-6/K, steel 11e-6/K.  Without sensors the time profile of the temperature is open.
"""

from collections.abc import Mapping

import numpy as np

from stepdiag_ros.effects.adoption import Fitted
from stepdiag_ros.effects.base import Effect, Form, Moment, Parameter, StopView
from stepdiag_ros.effects.made import joined
from stepdiag_ros.effects.patterns import Drawn, drawn_size, drift_profiles, each_alone, follow, recorded, saturating
from stepdiag_ros.effects.timeforms import ROUGHNESS, drift_form, time_profiles

HELD = {'': 0.0, ', held in the middle': 0.5, ', held at the end': 1.0}
"""Where a scale may be held, as a share of its travel."""
GLASS = 8e-6
"""Expansion of a glass scale [1/K], by which a growth is reported as a temperature."""
NOTICEABLE = 0.03
"""Standard deviation of a scale's temperature over the log [K] that is more than its sensor's noise."""


class ScaleThermalExpansion(Effect):
    name = 'scale_thermal_expansion'
    short = "An axis's scale warms up"
    corrected = 'scales'
    needs_times = True
    title = "An axis's scale warms up and grows while the log is taken."
    parameters = (Parameter('alpha', '1/K', 0.0, 2e-5, 3, 'expansion coefficient of the scales of X, Y, Z'),
                  Parameter('dT', 'K', -3.0, 3.0, 3, 'rise of their temperature in the end'),
                  Parameter('tau', 's', 100.0, 5000.0, meaning='time constant'),
                  Parameter('shift', 'm', -2e-5, 2e-5, 3, 'of each axis as a whole in the end, where its scale is held '
                            'elsewhere than at zero', detail=True))
    course_of, course_keeps = ('dT', 'shift'), ('alpha',)
    sources = ('ISO 230-3', 'ISO 230-2:2014, annex on thermal correction of scales')
    remedy = ('Warm the axes up, measure the scales\' temperature and correct for it, let the scales rest '
              'between runs.')
    signature = "Grows with one axis's position and with time or its scale's temperature."
    neighbours = ('air_refraction_drift grows with the distance in all directions alike; '
                  'structural_thermal_drift does not depend on position.')

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Drawn:
        return {'alpha': [float(rng.choice([8e-6, 1.1e-5]))] * 3, 'dT': drawn_size(rng, 0.1, 3.0, 3),
                'tau': float(np.exp(rng.uniform(np.log(200.0), np.log(4000.0))))}

    def environment(self, seconds: np.ndarray) -> dict[str, np.ndarray]:
        return {f'scale_temperature/{axis}': risen
                for axis, risen in zip('xyz', self._by_now(seconds)[0].T, strict=True)}

    def _by_now(self, seconds: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Rise of the scales' temperature [K] and shift of the axes [m], (n, 3) each."""
        in_the_end = np.concatenate([self.dT, self.shift])
        return np.split(self.now(seconds, saturating(seconds, self.tau)[:, None] * in_the_end), 2, axis=1)

    def before_pose(self, moment: Moment) -> None:
        risen, shift = self._by_now(moment.seconds)
        moment.position = moment.position + self.alpha * risen * moment.commanded + shift

    def appearance(self, view: StopView) -> list[Form]:
        axes = ('X', 'Y', 'Z')
        growth = view.commanded.T[:, :, None] * view.by_shift
        pace = time_profiles(view.elapsed, view.watches)
        forms = [follow(view, profile, growth, axes, 1e-5, '1', begun=True) for profile in drift_profiles(view)]
        # A scale that is held elsewhere than at its zero also shifts the axis as a whole: somewhere along the
        # travel, so that it is taken from the middle on, by at most half of it either way.
        travel = np.maximum(np.ptp(view.commanded, axis=0), 1e-3)
        middle = view.commanded.min(axis=0) + 0.5 * travel
        both = np.concatenate([(view.commanded - middle).T[:, :, None] * view.by_shift, view.by_shift])
        named = axes + tuple(f'{axis} shift' for axis in axes)
        size = 1e-5 * np.concatenate([np.ones(3), travel / np.sqrt(12.0)])
        forms += [drift_form(view, profile, both, named, size, 'held elsewhere than at zero', '1, m', begun=True)
                  for profile in pace
                  if profile.label in ('linear', *ROUGHNESS)
                  or profile.shape.get('tau_s', 0.0) > 0.2 * np.ptp(view.time)]
        # One axis that warms: the place where its scale is held does not change while it does.
        moved = np.ptp(view.commanded, axis=0) > 0.0
        for label, share in HELD.items():
            held = view.commanded.min(axis=0) + share * travel
            one = ((view.commanded - held) * moved).T[:, :, None] * view.by_shift
            fitting = [c for c in pace if not share or c.label in ROUGHNESS]
            forms += each_alone(view, fitting, one, axes, 1e-5, '1', label, begun=True)
        return self._logged(view, growth, both, size) + forms

    @staticmethod
    def _logged(view: StopView, growth: np.ndarray, both: np.ndarray, size: np.ndarray) -> list[Form]:
        """The expansion that the logged temperatures predict, with open coefficients."""
        if view.scale_temperature is None:
            return []
        first = view.first_scale_temperature
        if first is None:
            first = view.scale_temperature[np.argmin(view.time)]
        warm = view.scale_temperature - first
        use = [a for a in range(3) if np.isfinite(warm[:, a]).all() and warm[:, a].std() > NOTICEABLE]
        if not use:
            return []
        profile = {a: recorded(view, warm[:, [a]].T, '') for a in use}

        def together(label: str, signature: np.ndarray, names: tuple[str, ...], scale: np.ndarray,
                     units: str) -> Form:
            parts = [drift_form(view, profile[k % 3], signature[[k]], (names[k],), scale[[k]])
                     for k in range(len(signature)) if k % 3 in use]
            return Form(label, joined([part.columns for part in parts]),
                        tuple(part.names[0] for part in parts),
                        np.concatenate([part.scale for part in parts]), units,
                        joined([part.inside for part in parts]))

        axes = ('X', 'Y', 'Z')
        each = together('logged temperatures', growth, axes, np.full(3, 1e-5), '1/K')
        forms = [each, together('logged temperatures, held elsewhere than at zero', both,
                                axes + tuple(f'{axis} shift' for axis in axes), size, '1/K, m/K')]
        if len(use) > 1:
            forms.append(Form('logged temperatures, one material', np.sum(each.columns, axis=0, keepdims=True),
                              ('all',), np.full(1, 1e-5), '1/K', np.sum(each.inside, axis=0, keepdims=True)))
        return forms

    def guess(self, fitted: Fitted) -> Mapping[str, object]:
        view = fitted.view
        growth, since = view.commanded.T[:, :, None] * view.by_shift, view.time - view.time.min()
        sizes, tau = fitted.exponential(growth, since)
        return {'alpha': [GLASS] * 3, 'dT': (sizes / GLASS).tolist(), 'tau': tau}
