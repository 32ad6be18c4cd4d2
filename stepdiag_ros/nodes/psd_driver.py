"""The position-sensitive detector's node: ``psd/spot``, and ``psd/beam_angle`` where the angles of a beam are measured.

Service ``psd/select_setup`` tells it which setup the next blocks belong to.  In setups that regulate their beam the
node holds it on the retroreflector.
"""

import array
import sys
from typing import Any

import numpy as np
from geometry_msgs.msg import Vector3, Vector3Stamped
from std_msgs.msg import Header

from stepdiag_msgs.msg import SampleTiming, SpotMean, SpotPosition
from stepdiag_ros.bag.schemas import BEAM_ANGLE, SPOT, SPOT_TIMING
from stepdiag_ros.bag.shown import SPOT_MEAN
from stepdiag_ros.devices import t7
from stepdiag_ros.devices.base import SpotBlock, SpotSensor
from stepdiag_ros.devices.psd_signal import SpotOptics
from stepdiag_ros.devices.steering import Steering
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.model.regulation import GAIN, aims_of
from stepdiag_ros.nodes.base import WARN, Health, overridable, reliable, run_node
from stepdiag_ros.nodes.beam_loop import BeamLoop
from stepdiag_ros.nodes.decimated import Decimator, mean
from stepdiag_ros.nodes.driver import DriverNode
from stepdiag_ros.nodes.stamps import stamp_of


class PsdDriver(DriverNode):
    """Driver of a detector behind an analogue input box that speaks Modbus TCP."""

    sensor = 'psd'

    def __init__(self):
        super().__init__('psd_driver', t7.CONTROL_PORT)
        self.count('stream_port', t7.STREAM_PORT, 'TCP port of the input box for streamed samples',
                   1, 65535, fixed=True)
        self.text('mode', 'stream', 'stream: the box clocks the samples; poll: one request a sample', fixed=True)
        self.text('channels', [0, 1, 2, 3], 'analogue inputs of the photocurrents I1, I2, I3, I4')
        self.number('length', 0.010, 'edge length of the detector', 1.0e-4, 0.2, 'm', fixed=True)
        self.number('rotation', 0.0, "from the detector's x to the setup's u", -3.2, 3.2, 'rad', fixed=True)
        self.text('gain', [1.0, 1.0], "factors of the detector's x and y [1]", fixed=True)
        self.text('zero', [0.0, 0.0], "zero in the detector's axes, taken off first [m]", fixed=True)
        self.number('dark', 0.05, 'sum signal below which there is no spot', 0.0, 10.0, 'V')
        self.text('regulated', [''], 'setups whose beam is held, each setup=azimuth,elevation,distance: its aim and '
                                     'the farthest stop [rad, rad, m]', fixed=True)
        self.number('steering_range', 0.5, 'angles of the steered beam go from minus this to this', 1.0e-3, 1.5, 'rad',
                    fixed=True)
        self.text('steering_inputs', [-1], 'analogue inputs of the sensors of azimuth and elevation; -1: none',
                  fixed=True)
        self.number('regulator_gain', GAIN, 'share of an error that a period takes away', 0.01, 1.0, '1', fixed=True)
        self._publisher = self.marked.publisher(SpotPosition, SPOT)
        self._timing = self.marked.publisher(SampleTiming, SPOT_TIMING)
        self._mean = self.create_lifecycle_publisher(SpotMean, SPOT_MEAN, reliable(),
                                                     qos_overriding_options=overridable())
        self._angle: Any = None
        self._decimator = Decimator()
        self._loop = BeamLoop({}, Steering(), self.value('length'), GAIN)
        self.serve()
        self._intensity = 0.0
        self._dark = 0

    def build(self) -> SpotSensor:
        gain, zero = (self._pair(name) for name in ('gain', 'zero'))
        channels = tuple(self.value('channels'))
        if len(set(channels)) != 4 or not all(0 <= c <= 13 for c in channels):
            raise StepdiagError(f'psd_driver: parameter channels is {list(channels)}; '
                                'name four different analogue inputs from 0 to 13')
        steering = self._steering(channels)
        self._loop = BeamLoop(aims_of(self.value('regulated')), steering, self.value('length'),
                              self.value('regulator_gain'))
        optics = SpotOptics(self.value('length'), self.value('rotation'), gain, zero,
                            self.value('dark'))
        return self.driver()({**{name: self.value(name) for name in ('host', 'port', 'stream_port', 'mode', 'timeout')},
                              'optics': optics, 'channels': channels, 'steering': steering})

    def _steering(self, channels: tuple[int, ...]) -> Steering:
        inputs = tuple(i for i in self.value('steering_inputs') if i >= 0)
        if inputs and (len(inputs) != 2 or len({*inputs, *channels}) != 6 or max(inputs) > 13):
            raise StepdiagError(f'psd_driver: parameter steering_inputs is {list(inputs)}; name two analogue '
                                'inputs from 0 to 13, others than the photocurrents\', or -1')
        if inputs and self._angle is None:
            self._angle = self.marked.publisher(Vector3Stamped, BEAM_ANGLE)
        return Steering(self.value('steering_range'), inputs)

    def configure(self) -> None:
        super().configure()
        self._loop.select(self.setup, self.instrument)

    def select(self, setup: str, prefix: str) -> None:
        super().select(setup, prefix)
        self._loop.select(self.setup, self.instrument)

    def samples(self) -> int:
        return self._loop.samples(super().samples(), self.value('sample_rate'))

    def _pair(self, name: str) -> tuple[float, float]:
        values = tuple(self.value(name))
        if len(values) != 2 or not np.isfinite(values).all():
            raise StepdiagError(f'psd_driver: parameter {name} is {list(values)}; '
                                'give two finite numbers')
        return values

    def size(self, block: SpotBlock) -> int:
        return len(block.x_m)

    def publish(self, block: SpotBlock) -> None:
        self._loop.act(block, self.instrument)     # first: what follows can wait
        self._intensity = float(np.mean(block.intensity_V))
        self._dark = int(np.sum(~np.isfinite(block.x_m)))
        self._timing.publish(self.timing_of(block))
        if block.angle_rad is not None and self._loop.closed:
            azimuth, elevation = (float(a) for a in block.angle_rad.mean(axis=0))
            middle_ns = block.stamp_ns + round(0.5e9 * (self.size(block) - 1) * block.period_s)
            self._angle.publish(Vector3Stamped(header=Header(stamp=stamp_of(middle_ns), frame_id=self.setup),
                                               vector=Vector3(x=azimuth, y=elevation)))
        self._publisher.publish(SpotPosition(
            header=Header(stamp=stamp_of(block.stamp_ns), frame_id=self.setup),
            sample_period=block.period_s, x=_doubles(block.x_m), y=_doubles(block.y_m),
            intensity=_doubles(block.intensity_V)))
        self._publish_mean(block)

    def _publish_mean(self, block: SpotBlock) -> None:
        enough = self._decimator.add(block.stamp_ns, block.period_s,
                                     np.column_stack([block.x_m, block.y_m, block.intensity_V]))
        if enough is not None:
            time_ns, samples = enough
            x, y, intensity = map(mean, samples.T)
            self._mean.publish(SpotMean(header=Header(stamp=stamp_of(time_ns), frame_id=self.setup), x=x, y=y,
                                        intensity=intensity, samples=len(samples)))

    def more_values(self) -> dict[str, object]:
        return {'intensity_V': self._intensity, 'dark_samples': self._dark}

    def judge(self, values: dict[str, object]) -> Health:
        if self._loop.searching:
            return Health(WARN, 'the beam has lost the retroreflector and is searching for it', values)
        if values['blocks'] and self._dark:
            return Health(WARN, 'no light on the detector: the beam misses it', values)
        return super().judge(values)


def _doubles(values: np.ndarray) -> array.array:
    return array.array('d', np.ascontiguousarray(values, np.float64).tobytes())


def main() -> int:
    return run_node(PsdDriver)


if __name__ == '__main__':
    sys.exit(main())
