"""The interferometer's node: ``interferometer/displacement`` and ``environment/…``.

Services ``interferometer/select_setup`` and ``interferometer/reset`` are called by the
sequencer at the start of each run.  One instrument may serve several machines: the
parameter ``serves`` names their namespaces, and the blocks go to the machine whose
setup was selected last.
"""

import array
import math
import sys
import time

import numpy as np
from sensor_msgs.msg import FluidPressure, RelativeHumidity, Temperature
from std_msgs.msg import Header

from stepdiag_msgs.msg import Displacement
from stepdiag_msgs.srv import ResetDisplacement
from stepdiag_ros.devices.base import DisplacementBlock
from stepdiag_ros.devices.ids3010 import PORT, Ids3010
from stepdiag_ros.nodes.base import ERROR, OK, WARN, Health, overridable, reliable, run_node
from stepdiag_ros.nodes.driver import DriverNode
from stepdiag_ros.nodes.stamps import stamp_of

#: Environment topic -> type, field, variance of a reading [°C², Pa², 1].
ENVIRONMENT = {'air_temperature': (Temperature, 'temperature', 0.05 ** 2),
               'air_pressure': (FluidPressure, 'fluid_pressure', 10.0 ** 2),
               'humidity': (RelativeHumidity, 'relative_humidity', 0.02 ** 2)}
SCALE_VARIANCE = 0.05 ** 2


class _Machine:
    """The topics of one machine that the interferometer serves."""

    def __init__(self, node: 'InterferometerDriver', prefix: str):
        def publisher(kind: type, topic: str):
            return node.create_lifecycle_publisher(kind, prefix + topic, reliable(),
                                                   qos_overriding_options=overridable())
        self.displacement = publisher(Displacement, 'interferometer/displacement')
        self.environment = {name: publisher(kind, f'environment/{name}')
                            for name, (kind, _, _) in ENVIRONMENT.items()}
        self.scale = publisher(Temperature, 'environment/scale_temperature')


class InterferometerDriver(DriverNode):
    """Driver of an attocube IDS3010 or of whatever speaks its protocol."""

    sensor = 'interferometer'

    def __init__(self):
        super().__init__('interferometer_driver', PORT)
        self.count('beams', 1, 'axes of the instrument that look at the mirror', 1, 3)
        self.number('environment_period', 1.0, 'between two readings of the air', 0.5, 60.0, 's')
        served = self.text('serves', [''], 'namespaces of the machines that share this instrument; '
                                           'empty: its own only')
        prefixes = [f'/{name.strip("/")}/' for name in served if name.strip('/')] or ['']
        self._machines = {prefix: _Machine(self, prefix) for prefix in prefixes}
        self._prefix = prefixes[0]
        for prefix in prefixes:
            self.serve_select(f'{prefix}interferometer/select_setup', prefix)
            self.create_service(ResetDisplacement, f'{prefix}interferometer/reset', self._on_reset)
        self._next_environment = 0.0
        self._zero_known = False
        self._quality = 0
        self._index = 1.0

    def build(self) -> Ids3010:
        return Ids3010(self.value('host'), self.value('port'), self.value('beams'),
                       self.value('timeout'))

    def activate(self) -> None:
        # Until the first reset nobody knows from where the distance counts: no signal.
        self._zero_known, self._next_environment = False, 0.0
        super().activate()

    def read(self) -> DisplacementBlock:
        if time.monotonic() >= self._next_environment:
            self._next_environment = time.monotonic() + self.value('environment_period')
            self._publish_environment(self.instrument.environment(), time.time_ns())
        return super().read()

    def size(self, block: DisplacementBlock) -> int:
        return len(block.displacement_m)

    def lost(self) -> None:
        # Where zero was is not known after the connection broke: no signal until a reset.
        self._zero_known = False

    def select(self, setup: str, prefix: str) -> None:
        super().select(setup, prefix)
        self._prefix = prefix

    def _on_reset(self, _request, response):
        def reset() -> None:
            self.instrument.reset()
            self._zero_known = True
        return self.between_blocks(reset, response)

    def publish(self, block: DisplacementBlock) -> None:
        quality = block.quality if self._zero_known else np.zeros_like(block.quality)
        self._quality, self._index = int(quality.min()), block.refractive_index
        message = Displacement(
            header=Header(stamp=stamp_of(block.stamp_ns), frame_id=self.setup),
            sample_period=block.period_s, beams=block.displacement_m.shape[1],
            displacement=array.array('d', np.ascontiguousarray(block.displacement_m).tobytes()),
            refractive_index=block.refractive_index,
            quality=array.array('B', quality.astype(np.uint8).tobytes()))
        self._machines[self._prefix].displacement.publish(message)

    def _publish_environment(self, readings: dict[str, float], now_ns: int) -> None:
        machine = self._machines[self._prefix]
        for name, value in readings.items():
            if not math.isfinite(value):
                continue
            if name.startswith('scale_temperature/'):
                machine.scale.publish(Temperature(
                    header=Header(stamp=stamp_of(now_ns), frame_id=name[-1]),
                    temperature=value, variance=SCALE_VARIANCE))
            elif name in ENVIRONMENT:
                kind, field, variance = ENVIRONMENT[name]
                machine.environment[name].publish(kind(
                    header=Header(stamp=stamp_of(now_ns)), variance=variance, **{field: value}))

    def more_values(self) -> dict[str, object]:
        return {'quality': self._quality, 'refractive_index': f'{self._index:.9f}',
                'serving': self._prefix.strip('/')}

    def judge(self, values: dict[str, object]) -> Health:
        if not self._zero_known:
            again = bool(values['reconnects'])
            return Health(ERROR if again else OK, 'connected again, zero unknown until the next reset'
                          if again else 'measuring, zero unknown until the first reset', values)
        if values['blocks'] and self._quality == 0:
            return Health(WARN, 'no signal: the beam does not come back', values)
        return super().judge(values)


def main() -> int:
    return run_node(InterferometerDriver)


if __name__ == '__main__':
    sys.exit(main())
