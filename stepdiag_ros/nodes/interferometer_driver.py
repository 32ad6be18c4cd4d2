"""The interferometer's node: ``interferometer/displacement`` and ``environment/…``.

Services ``interferometer/select_setup`` and ``interferometer/reset`` are called by the
sequencer at the start of each run.

One instrument may serve several machines through an optical switch: the parameter
``serves`` names their namespaces and channels.  Whose the readings are, the multiplexer says
(service ``interferometer/route``), who owns the switch; until it does they are nobody's.
"""

import array
import math
import sys
import time

import numpy as np
from sensor_msgs.msg import FluidPressure, RelativeHumidity, Temperature
from std_msgs.msg import Header

from stepdiag_msgs.msg import Displacement, DisplacementMean, SampleTiming
from stepdiag_msgs.srv import ResetDisplacement, RouteSource
from stepdiag_ros.bag.schemas import DISPLACEMENT_TIMING
from stepdiag_ros.bag.shown import DISPLACEMENT_MEAN
from stepdiag_ros.devices.base import DisplacementBlock, Interferometer
from stepdiag_ros.devices.hostclock import HOST
from stepdiag_ros.devices.ids3010 import PORT
from stepdiag_ros.devices.optical_switch import channels
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.nodes.base import ERROR, OK, WARN, Health, overridable, reliable, run_node
from stepdiag_ros.nodes.decimated import Decimator, mean
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
            return node.marked.publisher(kind, topic, prefix)
        self.displacement = publisher(Displacement, 'interferometer/displacement')
        self.timing = publisher(SampleTiming, DISPLACEMENT_TIMING)
        self.mean = node.create_lifecycle_publisher(DisplacementMean, prefix + DISPLACEMENT_MEAN, reliable(),
                                                    qos_overriding_options=overridable())
        self.decimator = Decimator()
        self.environment = {name: publisher(kind, f'environment/{name}')
                            for name, (kind, _, _) in ENVIRONMENT.items()}
        self.scale = publisher(Temperature, 'environment/scale_temperature')


class InterferometerDriver(DriverNode):
    """Driver of an attocube IDS3010 or of whatever speaks its protocol."""

    sensor = 'interferometer'

    def __init__(self):
        super().__init__('interferometer_driver', PORT)
        self.count('beams', 1, 'axes of the instrument that look at the mirror', 1, 3, fixed=True)
        self.number('environment_period', 1.0, 'between two readings of the air', 0.5, 60.0, 's')
        served = self.text('serves', [''], 'machines that share this instrument, namespace=channel of the '
                                           'switch, e.g. left=1; empty: its own machine only', fixed=True)
        self._machines = {prefix: _Machine(self, prefix) for prefix in channels(served)}
        #: Whose the readings are; ``None``: nobody's.
        self._prefix: str | None = None if served and any(served) else next(iter(self._machines))
        for prefix in self._machines:
            self.serve(prefix)
            self.create_service(
                ResetDisplacement, f'{prefix}interferometer/reset',
                lambda request, response, prefix=prefix: self._on_reset(prefix, response))
        self.create_service(RouteSource, 'interferometer/route', self._on_route)
        self._next_environment = 0.0
        self._zero_known = False
        self._quality = 0
        self._index = 1.0

    def build(self) -> Interferometer:
        return self.driver()({name: self.value(name) for name in ('host', 'port', 'beams', 'timeout')})

    def activate(self) -> None:
        # Until the first reset nobody knows from where the distance counts: no signal.
        self._zero_known, self._next_environment = False, 0.0
        super().activate()

    def read(self) -> DisplacementBlock:
        if time.monotonic() >= self._next_environment:
            self._next_environment = time.monotonic() + self.value('environment_period')
            self._publish_environment(self.instrument.environment(), HOST.now_ns())
        return super().read()

    def size(self, block: DisplacementBlock) -> int:
        return len(block.displacement_m)

    def lost(self) -> None:
        # Where zero was is not known after the connection broke: no signal until a reset.
        self._zero_known = False

    def select(self, setup: str, prefix: str) -> None:
        self._refuse_others(prefix)
        super().select(setup, prefix)

    def _refuse_others(self, prefix: str) -> None:
        if prefix != self._prefix:
            raise StepdiagError(f'{prefix.strip("/")} does not have the light; ask the multiplexer for it (use_source)')

    def _on_reset(self, prefix: str, response):
        def reset() -> None:
            self._refuse_others(prefix)
            self.instrument.reset()
            self._zero_known = True
        return self.between_blocks(reset, response)

    def _on_route(self, request: RouteSource.Request, response: RouteSource.Response) -> RouteSource.Response:
        prefix = f'/{request.machine.strip("/")}/'
        if request.machine and prefix not in self._machines:
            response.success, response.message = False, f'{request.machine!r} is not served here'
            return response
        if not request.machine:
            self._prefix = None   # at once: the block in hand may already hold another machine's light
            response.success = True
            return response

        def route() -> None:
            if self._prefix != prefix:
                self._zero_known, self._next_environment = False, 0.0
            self._prefix = prefix
        return self.between_blocks(route, response)

    def publish(self, block: DisplacementBlock) -> None:
        machine = self._machines.get(self._prefix)
        if machine is None:
            return
        quality = block.quality if self._zero_known else np.zeros_like(block.quality)
        self._quality, self._index = int(quality.max()), block.refractive_index
        message = Displacement(
            header=Header(stamp=stamp_of(block.stamp_ns), frame_id=self.setup),
            sample_period=block.period_s, beams=block.displacement_m.shape[1],
            displacement=array.array('d', np.ascontiguousarray(block.displacement_m).tobytes()),
            refractive_index=block.refractive_index,
            quality=array.array('B', quality.astype(np.uint8).tobytes()))
        # First when, then what: whoever waits for the samples has their times.
        machine.timing.publish(self.timing_of(block))
        machine.displacement.publish(message)
        self._publish_mean(machine, block, quality)

    def _publish_mean(self, machine: _Machine, block: DisplacementBlock, quality: np.ndarray) -> None:
        enough = machine.decimator.add(block.stamp_ns, block.period_s,
                                       np.column_stack([block.displacement_m[:, 0], quality]))
        if enough is None:
            return
        time_ns, samples = enough
        seen = samples[samples[:, 1] > 0, 0]
        machine.mean.publish(DisplacementMean(
            header=Header(stamp=stamp_of(time_ns), frame_id=self.setup), displacement=mean(seen),
            scatter=float(seen.std()) if seen.size else math.nan, quality=int(samples[:, 1].min()),
            samples=len(samples)))

    def _publish_environment(self, readings: dict[str, float], now_ns: int) -> None:
        machine = self._machines.get(self._prefix)
        if machine is None:
            return
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
                'serving': (self._prefix or '').strip('/')}

    def judge(self, values: dict[str, object]) -> Health:
        if self._prefix is None:
            return Health(OK, 'measuring for nobody until the multiplexer says for whom', values)
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
