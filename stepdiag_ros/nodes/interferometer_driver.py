"""The interferometer's node: ``interferometer/displacement`` and ``environment/…``.

Services ``interferometer/select_setup`` and ``interferometer/reset`` are called by the
sequencer at the start of each run.

One instrument may serve several machines through an optical switch: the parameter
``serves`` names their namespaces and channels.  The blocks go to the machine whose setup
was selected last; it keeps the laser until it selects no setup any more (an empty name)
or has been idle for ``hold``.
"""

import array
import math
import sys
import time

import numpy as np
from sensor_msgs.msg import FluidPressure, RelativeHumidity, Temperature
from std_msgs.msg import Header

from stepdiag_msgs.msg import Displacement, SampleTiming, Step
from stepdiag_msgs.srv import ResetDisplacement
from stepdiag_ros.bag.schemas import DISPLACEMENT_TIMING, STEP
from stepdiag_ros.devices.base import DisplacementBlock, Interferometer
from stepdiag_ros.devices.hostclock import HOST
from stepdiag_ros.devices.ids3010 import PORT
from stepdiag_ros.devices.optical_switch import PORT as SWITCH_PORT
from stepdiag_ros.devices.optical_switch import OpticalSwitch
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.nodes.base import ERROR, OK, WARN, Health, reliable, run_node
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
        self.text('switch_host', '', 'host name or address of the optical switch; empty: there is none', fixed=True)
        self.count('switch_port', SWITCH_PORT, 'TCP port of the optical switch', 1, 65535, fixed=True)
        self.number('hold', 60.0, 'rest after which a machine loses the laser to another that asks',
                    1.0, 36_000.0, 's')
        served = self.text('serves', [''], 'machines that share this instrument, namespace=channel of the '
                                           'switch, e.g. left=1; empty: its own machine only', fixed=True)
        self._channels = _channels(served)
        self._machines = {prefix: _Machine(self, prefix) for prefix in self._channels}
        self._prefix = next(iter(self._channels))
        self._holder: str | None = None
        self._used_s = 0.0
        self._switch: OpticalSwitch | None = None
        for prefix in self._channels:
            self.serve_select(f'{prefix}interferometer/select_setup', prefix)
            self.create_service(
                ResetDisplacement, f'{prefix}interferometer/reset',
                lambda request, response, prefix=prefix: self._on_reset(prefix, response))
            if len(self._channels) > 1:
                self.create_subscription(Step, f'{prefix}{STEP}',
                                         lambda _step, prefix=prefix: self._use(prefix), reliable(100))
        self._next_environment = 0.0
        self._zero_known = False
        self._quality = 0
        self._index = 1.0

    def build(self) -> Interferometer:
        return self.driver()({name: self.value(name) for name in ('host', 'port', 'beams', 'timeout')})

    def configure(self) -> None:
        if self.value('switch_host'):
            self._switch = OpticalSwitch(self.value('switch_host'), self.value('switch_port'),
                                         self._channels, self.value('timeout'))
            self._switch.connect()
            self._switch.select(self._prefix)
        super().configure()

    def cleanup(self) -> None:
        super().cleanup()
        if self._switch is not None:
            self._switch.close()
            self._switch = None

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
        idle_s = time.monotonic() - self._used_s
        if self._holder not in (None, prefix) and idle_s < self.value('hold'):
            raise StepdiagError(f'the laser serves {self._holder.strip("/")}, which used it '
                                f'{idle_s:.0f} s ago')
        if not setup:
            self._holder = None
            return
        if self._switch is not None and prefix != self._prefix:
            self._switch.select(prefix)
            self._zero_known = False
        self._holder, self._prefix = prefix, prefix
        self._use(prefix)
        super().select(setup, prefix)

    def _use(self, prefix: str) -> None:
        if prefix == self._holder:
            self._used_s = time.monotonic()

    def _on_reset(self, prefix: str, response):
        def reset() -> None:
            if prefix != self._prefix:
                raise StepdiagError(f'the laser serves {self._prefix.strip("/")}')
            self.instrument.reset()
            self._zero_known = True
            self._use(prefix)
        return self.between_blocks(reset, response)

    def publish(self, block: DisplacementBlock) -> None:
        quality = block.quality if self._zero_known else np.zeros_like(block.quality)
        self._quality, self._index = int(quality.max()), block.refractive_index
        message = Displacement(
            header=Header(stamp=stamp_of(block.stamp_ns), frame_id=self.setup),
            sample_period=block.period_s, beams=block.displacement_m.shape[1],
            displacement=array.array('d', np.ascontiguousarray(block.displacement_m).tobytes()),
            refractive_index=block.refractive_index,
            quality=array.array('B', quality.astype(np.uint8).tobytes()))
        # First when, then what: whoever waits for the samples has their times.
        self._machines[self._prefix].timing.publish(self.timing_of(block))
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


def _channels(served: list[str]) -> dict[str, int]:
    """``['left=1', 'right=2']`` -> topic prefixes and channels; nothing named: no prefix."""
    channels = {}
    for entry in filter(None, served):
        name, _, channel = entry.partition('=')
        if not name.strip('/') or not channel.isdigit():
            raise StepdiagError(f'interferometer_driver: parameter serves holds {entry!r}; '
                                'write namespace=channel, e.g. left=1')
        channels[f'/{name.strip("/")}/'] = int(channel)
    return channels or {'': 1}


def main() -> int:
    return run_node(InterferometerDriver)


if __name__ == '__main__':
    sys.exit(main())
