"""The index of air changes during a run and the reading is not corrected for it.

A laser counts wavelengths; in air of index ``n`` the length ``L`` counts as ``n L``.  What the
instrument divides out is an index it believes; the rest, ``(n/n₀ − 1)`` of the whole way of the light
that air fills, dead path included, is read as displacement.  1 K is about −0.95e-6, 100 Pa +0.27e-6.
The spot does not notice.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from stepdiag_ros.effects.adoption import Fitted
from stepdiag_ros.effects.base import Effect, Form, Moment, Parameter, StopView
from stepdiag_ros.effects.patterns import Drawn, drawn_size, drift_profiles, follow, on_lengths, recorded, saturating
from stepdiag_ros.effects.timeforms import ROUGHNESS
from stepdiag_ros.model.air import refractive_index

TEMPERATURE, PRESSURE, HUMIDITY = 20.0, 101325.0, 0.5
"""Air from which the parameters' changes are counted [°C, Pa, 1]: what a kelvin does hardly depends on it."""
DEAD_PATHS = (0.0, 0.5, 2.0)
"""Dead paths tried beside the described one, as shares of it: sources that take their own out of the reading,
or stand elsewhere than the description says."""
NOTICEABLE = 2.0e-8
"""Standard deviation of an index over the log that is more than a sensor's noise."""


class AirRefractionDrift(Effect):
    name = 'air_refraction_drift'
    short = 'Air along the laser beam changes'
    corrected = 'air'
    needs_times = True
    title = 'The air changes while the laser measures, and the reading is not corrected for it.'
    parameters = (Parameter('dT', 'K', -5.0, 5.0, meaning='rise of the air temperature in the end'),
                  Parameter('dP', 'Pa', -1000.0, 1000.0, meaning='rise of the air pressure in the end'),
                  Parameter('tau', 's', 100.0, 5000.0, meaning='time constant'))
    course_of = ('dT',)
    sources = ('Bönsch & Potulski 1998, Metrologia 35, 133', 'ISO 230-1:2012, laser interferometers',
               'Dahlem et al. 2018, environment')
    remedy = ('Let the instrument compensate with sensors of temperature, pressure and humidity beside the '
              'beam, keep draughts away, and put the base unit close to the machine (dead path).')
    signature = 'Grows with the whole distance to the mirror and with time; displacement only.'
    neighbours = ('scale_thermal_expansion follows one axis\'s position, not the distance, and has no dead '
                  'path; structural_thermal_drift does not grow with the distance.')

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Drawn:
        return {'dT': drawn_size(rng, 0.3, 5.0), 'dP': drawn_size(rng, 30.0, 1000.0),
                'tau': float(np.exp(rng.uniform(np.log(200.0), np.log(4000.0))))}

    def environment(self, seconds: np.ndarray) -> dict[str, np.ndarray]:
        pace = saturating(seconds, self.tau)
        return {'air_temperature': self.now(seconds, pace[:, None] * self.dT)[:, 0], 'air_pressure': pace * self.dP}

    def before_light(self, moment: Moment) -> None:
        change = self.environment(moment.seconds)
        moment.index = moment.index * (
            refractive_index(TEMPERATURE + change['air_temperature'],
                             PRESSURE + change['air_pressure'], HUMIDITY)
            / refractive_index(TEMPERATURE, PRESSURE, HUMIDITY))

    def appearance(self, view: StopView) -> list[Form]:
        way, forms = on_lengths(view, view.distance)[None], []
        pace = drift_profiles(view)
        for share in (1.0, *DEAD_PATHS):
            # The air of the dead path changes as that of the way does: one profile, and one dead path a log.
            label = '' if share == 1.0 else f'dead path {share:g} times as described'
            path = on_lengths(view, view.distance + (share - 1.0) * float(np.nanmin(view.distance)))[None]
            forms += [replace(follow(view, profile, path, ('index',), 1e-6, '1', label, begun=True),
                              source=f'dead path {share}')
                      for profile in pace if share == 1.0 or profile.label in ('linear', *ROUGHNESS)]
        logged = self._logged(view)
        if logged is not None:
            profile = recorded(view, logged[None], 'logged air, not divided out')
            forms.insert(0, follow(view, profile, way, ('share',), 1.0, '1'))
        return forms

    @staticmethod
    def _logged(view: StopView) -> np.ndarray | None:
        """Logged index over the divided one, less its first (n,); None where that says nothing."""
        if view.air_index is None:
            return None
        ratio = view.air_index / view.divided_index
        first = ratio[np.argmin(view.time)] if view.first_air_index is None \
            else view.first_air_index / view.divided_index[np.argmin(view.time)]
        ratio = ratio - first
        if not np.isfinite(ratio).all() or ratio.std() < NOTICEABLE:
            return None
        return ratio

    def guess(self, fitted: Fitted) -> Mapping[str, object]:
        view = fitted.view
        signature = view.zeros(1)
        signature[0, :, :view.beams] = view.distance
        sizes, tau = fitted.exponential(signature, view.time - view.time.min())
        kelvin = refractive_index(21.0, 101325.0, 0.5) / refractive_index(20.0, 101325.0, 0.5) - 1.0
        return {'dT': float(sizes[0] / kelvin), 'dP': 0.0, 'tau': tau}
