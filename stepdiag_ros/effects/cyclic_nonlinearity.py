"""The reading swings with the fringe phase, a few nanometres to tens of nanometres.

Stray reflections and mixed polarisations add to the beam that is counted; the reading then errs by
``A cos φ + B sin φ`` with ``φ = 2π·(optical length)/(λ/2)``, and at twice the phase where quadrature
signals are not round.  The phase of each stop is in the reading itself, to nanometres; the phase at a
run's reset is not, because every arrival errs.  All stops that the runs of a setup have in common tell how
far apart their resets were, better than any arrival repeats: where that is a fraction of a fringe, one phase
holds for the setup; where arrivals err by fringes, each run has its own.  Beams side by side have phases of
their own: no set-up makes their paths alike to a fringe.
"""

from collections.abc import Sequence

import numpy as np

from stepdiag_ros.effects.base import Effect, Form, Moment, Parameter, StopView
from stepdiag_ros.effects.made import Split
from stepdiag_ros.effects.patterns import Drawn

WAVELENGTHS = (632.8e-9, 632.991e-9, 1530e-9, 1550e-9)
"""Vacuum wavelengths [m] of common sources: He-Ne (rounded, exact), diode lasers of the IDS3010 kind."""
CONTROLS = (5.1e-7, 5.7e-7, 7.03e-7, 8.11e-7, 9.47e-7, 1.083e-6, 1.237e-6, 1.417e-6, 1.703e-6, 1.97e-6)
"""Wavelengths [m] beside those, their halves and doubles: a swing that shows at these too is no fringe's."""
PARTS = ('cos', 'sin', 'cos 2', 'sin 2')
MIN_STOPS = 6
"""A run with fewer stops has none to spare for a phase of its own."""


class CyclicNonlinearity(Effect):
    name = 'cyclic_nonlinearity'
    short = 'Laser reading swings with the fringe'
    not_adopted = 'its phase at a stop turns with every 0.3 µm, which no simulator can know; not adopted'
    title = 'The laser reading swings by nanometres with every fringe.'
    parameters = (Parameter('amp', 'm', 0.0, 1e-7, meaning='swing, once a fringe'),
                  Parameter('amp2', 'm', -2e-8, 2e-8, meaning='swing, twice a fringe'),
                  Parameter('phase', 'rad', -np.pi, np.pi, meaning='phase at zero length'),
                  Parameter('wavelength', 'm', 5e-7, 2.56e-6, meaning='vacuum wavelength'))
    sources = ('Quenelle 1983; Bobroff 1993, Meas. Sci. Technol. 4, 907', 'Heydemann 1981, Appl. Opt. 20, 3382')
    remedy = ('Align the interferometer and keep stray light out (tilt windows); correct the quadrature '
              'signals (Heydemann).')
    signature = 'Swings with λ/2 of travel in displacement; the same at every stop of equal phase.'
    neighbours = ('vibration swings with time, not with length; from stops of one step alone the swing looks '
                  'like repeatability, samples in motion or finer steps tell.')

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Drawn:
        return {'amp': float(np.exp(rng.uniform(np.log(3e-9), np.log(8e-8)))), 'amp2': 0.0,
                'phase': float(rng.uniform(-np.pi, np.pi)),
                'wavelength': float(rng.choice([632.991e-9, 1530e-9]))}

    def after_light(self, moment: Moment) -> None:
        path = moment.length * moment.divided[:, None]
        phase = 4.0 * np.pi * path / self.wavelength + self.phase
        moment.length = moment.length + self.amp * np.sin(phase) + self.amp2 * np.sin(2.0 * phase)

    def appearance(self, view: StopView) -> list[Form]:
        forms, reading = [], self._reading(view)
        for wavelength in WAVELENGTHS:
            for kind, rise in (('optical', view.divided_index[:, None]),
                               ('geometric', np.ones((len(reading), 1)))):
                forms += self._of_length(view, f'λ = {wavelength * 1e9:.3f} nm, {kind} length',
                                         reading * rise, rise, wavelength)
        return forms

    def negative_controls(self, view: StopView) -> list[Form]:
        reading, forms = self._reading(view), []
        for wavelength in CONTROLS:
            forms += self._of_length(view, f'displacement: swings as no laser does, λ = {wavelength * 1e9:.0f} nm',
                                     reading, np.ones((len(reading), 1)), wavelength)[1:]
        return forms

    @staticmethod
    def _reading(view: StopView) -> np.ndarray:
        """Length (n, beams) [m] by the readings, counted for all runs of a setup from one unknown point: what the
        stops of all runs say of each reset is taken off."""
        measured = view.reading[:, :view.beams]
        reset = view.model[:, :view.beams] - view.distance
        return np.where(np.isfinite(measured), measured, view.model[:, :view.beams]) - reset

    def _of_length(self, view: StopView, label: str, length: np.ndarray, rise: np.ndarray,
                   wavelength: float) -> list[Form]:
        # The phase is that of the reading itself, noise and all: it is to be known to nanometres, which no
        # fitted length is.  The Jacobian correction for the noise that a column then holds is part of the form.
        slope = 4.0 * np.pi / wavelength * rise

        def form(kind: str, columns: np.ndarray, slopes: np.ndarray, names: tuple[str, ...]) -> Form:
            return Form(f'{label}, {kind}', columns, names, np.full(len(names), 3e-9),
                        shape={'wavelength_m': wavelength}, by_reading=slopes,
                        source=f'laser of {wavelength * 1e9:.3f} nm')

        once, by_once = self._swing(view, 4.0 * np.pi * length / wavelength, slope)
        twice, by_twice = self._swing(view, 8.0 * np.pi * length / wavelength, 2.0 * slope)
        both, by_both = np.concatenate([once, twice]), np.concatenate([by_once, by_twice])
        forms, alike = [], np.zeros(len(length), int)
        for kind, group, own, columns, slopes in (
                ('one phase', alike, ('',), both, by_both),
                ('phase by setup', view.setup, view.setup_names, once, by_once),
                ('phase by setup, twice a fringe too', view.setup, view.setup_names, both, by_both),
                ('phase by run', view.run, view.run_ids, once, by_once)):
            split, names = self._by_group(columns, group, own, view.beams)
            if names:
                forms.append(form(kind, split, self._by_group(slopes, group, own, view.beams)[0], names))
        return forms

    @staticmethod
    def _swing(view: StopView, phase: np.ndarray, slope: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Cosine and sine of ``phase`` (n, beams) as columns, and their derivatives by the reading,
        ``slope`` (n, 1) [rad/m] times as fast as the phase."""
        columns, derivatives = view.zeros(2), view.zeros(2)
        columns[0, :, :view.beams], columns[1, :, :view.beams] = np.cos(phase), np.sin(phase)
        derivatives[0], derivatives[1] = -slope * columns[1], slope * columns[0]
        return columns, derivatives

    @staticmethod
    def _by_group(swings: np.ndarray, group: np.ndarray, labels: Sequence[str],
                  beams: int) -> tuple[Split, tuple[str, ...]]:
        """Columns (k, n, c) split by ``group`` (n,), one of the ``labels`` each, and by beam, and their names."""
        numbers, counts = np.unique(group, return_counts=True)
        numbers, names = numbers[counts >= MIN_STOPS], []
        for number in numbers:
            for beam in range(beams):
                own = f'{labels[number]} beam {beam}' if beams > 1 else labels[number]
                names += [f'{own} {part}'.strip() for part in PARTS[:len(swings)]]
        return Split(swings, group, numbers, np.eye(beams, swings.shape[2], dtype=bool)), tuple(names)
