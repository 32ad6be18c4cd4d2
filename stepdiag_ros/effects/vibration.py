"""The tool point shakes at one or a few frequencies during a dwell.

Pumps, fans and the building shake the tool against the workpiece.  A dwell's mean hardly notices; the
samples inside do, as lines in their spectrum.  That is where the diagnosis looks, not in the stops.
"""

import numpy as np

from stepdiag_ros.effects.base import Effect, Moment, Parameter
from stepdiag_ros.effects.patterns import Drawn


class Vibration(Effect):
    name = 'vibration'
    short = 'Tool point vibrates'
    by_chance = True
    title = 'The tool shakes against the workpiece while it should stand still.'
    parameters = (Parameter('amp', 'm', 0.0, 5e-6, 3, 'amplitude along X, Y, Z'),
                  Parameter('frequency', 'Hz', 1.0, 200.0, meaning='of the shaking'),
                  Parameter('amp2', 'm', 0.0, 0.0, 3, 'amplitude of a second line'),
                  Parameter('frequency2', 'Hz', 1.0, 200.0, meaning='of the second line'))
    sources = ('ISO/TR 230-8, vibrations',)
    remedy = 'Find the pump, fan or drive of this frequency; switch it off or decouple it; dwell whole periods.'
    signature = 'Lines in the spectrum of the samples inside a dwell, in phase over the channels.'
    neighbours = ('servo_settling creeps to one side and dies away; cyclic_nonlinearity swings with travel, '
                  'not with time.')

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Drawn:
        size = np.exp(rng.uniform(np.log(2e-8), np.log(2e-6)))
        drawn = {'amp': (size * rng.uniform(0.1, 1.0, 3)).tolist(),
                 'frequency': float(np.exp(rng.uniform(np.log(3.0), np.log(100.0))))}
        if rng.random() < 0.4:
            drawn |= {'amp2': (0.5 * size * rng.uniform(0.1, 1.0, 3)).tolist(),
                      'frequency2': float(np.exp(rng.uniform(np.log(3.0), np.log(100.0))))}
        return drawn

    def before_pose(self, moment: Moment) -> None:
        phase = 2.0 * np.pi * moment.rng.uniforms('phase', 0, 1, 6)[0]
        for amp, frequency, own in ((self.amp, self.frequency, phase[:3]),
                                    (self.amp2, self.frequency2, phase[3:])):
            turn = 2.0 * np.pi * frequency * moment.seconds
            moment.shift = moment.shift + amp * np.sin(turn[:, None] + own)
