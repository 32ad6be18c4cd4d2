"""How air, interferometer, beam and mirror misbehave in the sealed world."""

import numpy as np

from stepdiag_ros.blind.hidden import ANY, Hidden, Stage, direction, profile
from stepdiag_ros.effects.base import Moment
from stepdiag_ros.model.air import refractive_index
from stepdiag_ros.model.mirror_form import HeightForm

WAVELENGTHS = (1.53e-6, 632.8e-9)
COUNTS = tuple(wave / part for wave in WAVELENGTHS for part in (2.0, 4.0))
"""What a counter loses at a time [m]."""


class AirRefractionDrift(Hidden):
    """temperature, pressure and humidity each on a profile of its own; size: the temperature's"""

    name, unit, typical, largest = 'air_refraction_drift', 'degC', 1.0, 12.0

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._profiles, kinds = stage.profiles(rng, 3)
        # 1 °C and 350 Pa change the index about alike.
        self._pressure, self._humidity = rng.normal(0.0, 200.0), rng.normal(0.0, 0.03)
        self.facts = {'profiles': kinds, 'pressure_Pa_per_degC': self._pressure}

    def weather(self, seconds):
        warm, press, wet = (c(seconds) for c in self._profiles)
        return self.size * warm, self.size * self._pressure * press, self.size * self._humidity * wet

    def before_light(self, moment: Moment) -> None:
        air = self.stage.cell.air
        warm, press, wet = self.weather(moment.seconds)
        moment.index = moment.index * (
            refractive_index(air.temperature + warm, air.pressure + press,
                             np.clip(air.humidity + wet, 0.0, 1.0))
            / refractive_index(air.temperature, air.pressure, air.humidity))


class CyclicNonlinearity(Hidden):
    """the quadrature signals' ellipse: offsets, unequal gains and a phase error together"""

    name, typical, largest = 'cyclic_nonlinearity', 5e-9, 8e-8

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._wavelength = float(rng.choice(WAVELENGTHS))
        self._offset = rng.standard_normal(2) * rng.uniform(0.3, 1.0)
        self._gain, self._skew = rng.normal(0.0, 0.6), rng.normal(0.0, 0.6)
        self.facts = {'wavelength_m': self._wavelength}

    def after_light(self, moment: Moment) -> None:
        per_radian = self._wavelength / (4.0 * np.pi)
        strength = self.size / per_radian
        phase = moment.length / per_radian
        sine = (1.0 + strength * self._gain) * np.sin(phase + strength * self._skew) \
            + strength * self._offset[0]
        cosine = np.cos(phase) + strength * self._offset[1]
        error = np.angle((cosine + 1j * sine) * np.exp(-1j * phase))
        moment.length = moment.length + per_radian * error


class CountSlip(Hidden):
    """one to three slips in different runs, of different sizes, while an axis moves"""

    name, typical, largest = 'count_slip', 1e-6, 3e-5

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        count = int(rng.choice([1, 2, 3], p=[0.6, 0.25, 0.15]))
        runs = stage.runs[rng.permutation(len(stage.runs))[:count]]
        self._times = np.sort(runs[:, 0] + (runs[:, 1] - runs[:, 0]) * rng.uniform(0.1, 0.9, count))
        self._jumps = rng.uniform(0.5, 1.0, count) * rng.choice([-1.0, 1.0], count)
        self._jumps /= np.abs(self._jumps).max()
        self._beam = int(rng.integers(8))
        self._count = float(rng.choice(COUNTS)) if stage.wide else 0.0
        self.facts = {'times_s': self._times.tolist(), 'jumps': self._jumps.tolist(), 'count_m': self._count}

    def after_light(self, moment: Moment) -> None:
        jumps = self.size * self._jumps
        if self._count:
            # Whole counts, one at least.
            jumps = np.sign(jumps) * np.maximum(np.rint(np.abs(jumps) / self._count), 1.0) * self._count
        jump = np.sum(jumps * (moment.seconds[:, None] >= self._times), axis=1)
        length = moment.length.copy()
        length[:, self._beam % length.shape[1]] += jump
        moment.length = length


class BeamPointingDrift(Hidden):
    """the two angles turn on profiles of their own, all through the log"""

    name, unit, typical, largest = 'beam_pointing_drift', 'rad', 2e-6, 2e-4

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._profiles, kinds = stage.profiles(rng, 2, ANY)
        self._weight = direction(rng, 2)
        self.facts = {'profiles': kinds, 'direction': self._weight.tolist()}

    def before_light(self, moment: Moment) -> None:
        turn = np.stack([c(moment.seconds) for c in self._profiles], axis=1)
        moment.laser = moment.laser + self.size * self._weight * turn


class MirrorCurvature(Hidden):
    """curvature, astigmatism on a slant, and trefoil; size: height at the rim of what is used"""

    name, typical, largest = 'mirror_curvature', 1e-7, 4e-6

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._rim = float(np.linalg.norm(stage.travel / stage.cell.description.plan.steps))
        self._terms = np.array([rng.choice([-1.0, 1.0]), *rng.normal(0.0, 0.5, 2),
                                *rng.normal(0.0, 0.3, 2)])
        self.facts = {'rim_m': self._rim, 'power_astig_astig45_trefoil': self._terms.tolist()}

    def before_light(self, moment: Moment) -> None:
        power, astig, slant, three, side = self.size * self._terms
        rim = self._rim

        def height(x, y):
            x, y = x / rim, y / rim
            return (power * (x * x + y * y) + astig * (x * x - y * y) + 2.0 * slant * x * y
                    + three * (x * x * x - 3.0 * x * y * y) + side * (3.0 * x * x * y - y * y * y))

        def gradient(x, y):
            x, y = x / rim, y / rim
            return ((2.0 * (power + astig) * x + 2.0 * slant * y
                     + 3.0 * three * (x * x - y * y) + 6.0 * side * x * y) / rim,
                    (2.0 * (power - astig) * y + 2.0 * slant * x
                     - 6.0 * three * x * y + 3.0 * side * (x * x - y * y)) / rim)
        moment.form = HeightForm(height, gradient)


class MirrorMountCreep(Hidden):
    """a power law, a logarithm or two time constants after each mounting, other in each setup"""

    name, unit, typical, largest = 'mirror_mount_creep', 'rad', 2e-6, 3e-4

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._profile, kind = profile(rng, max(stage.span_s / len(stage.cell.setup_names), 60.0))
        while kind in ('walk', 'ramp_and_swing', 'warm_and_cool'):   # a relaxation only relaxes
            self._profile, kind = profile(rng, max(stage.span_s / len(stage.cell.setup_names), 60.0))
        main = direction(rng, 2)
        self._vector = {name: main * rng.uniform(0.6, 1.0) + 0.3 * rng.standard_normal(2)
                        for name in stage.cell.setup_names}
        self.facts = {'profile': kind}

    def before_light(self, moment: Moment) -> None:
        moment.mirror = moment.mirror + self.size * (
            self._profile(moment.mount_seconds)[:, None] * self._vector[moment.setup])
