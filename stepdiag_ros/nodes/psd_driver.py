"""The position-sensitive detector's node: ``psd/spot``.

Service ``psd/select_setup`` tells it which setup the next blocks belong to.
"""

import array
import sys

import numpy as np
from std_msgs.msg import Header

from stepdiag_msgs.msg import SampleTiming, SpotMean, SpotPosition
from stepdiag_ros.bag.schemas import SPOT, SPOT_TIMING
from stepdiag_ros.bag.shown import SPOT_MEAN
from stepdiag_ros.devices import t7
from stepdiag_ros.devices.base import SpotBlock, SpotSensor
from stepdiag_ros.devices.psd_signal import SpotOptics
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.nodes.base import WARN, Health, overridable, reliable, run_node
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
        self._publisher = self.marked.publisher(SpotPosition, SPOT)
        self._timing = self.marked.publisher(SampleTiming, SPOT_TIMING)
        self._mean = self.create_lifecycle_publisher(SpotMean, SPOT_MEAN, reliable(),
                                                     qos_overriding_options=overridable())
        self._decimator = Decimator()
        self.serve()
        self._intensity = 0.0
        self._dark = 0

    def build(self) -> SpotSensor:
        gain, zero = (self._pair(name) for name in ('gain', 'zero'))
        channels = tuple(self.value('channels'))
        if len(set(channels)) != 4 or not all(0 <= c <= 13 for c in channels):
            raise StepdiagError(f'psd_driver: parameter channels is {list(channels)}; '
                                'name four different analogue inputs from 0 to 13')
        optics = SpotOptics(self.value('length'), self.value('rotation'), gain, zero,
                            self.value('dark'))
        return self.driver()({**{name: self.value(name) for name in ('host', 'port', 'stream_port', 'mode', 'timeout')},
                              'optics': optics, 'channels': channels})

    def _pair(self, name: str) -> tuple[float, float]:
        values = tuple(self.value(name))
        if len(values) != 2 or not np.isfinite(values).all():
            raise StepdiagError(f'psd_driver: parameter {name} is {list(values)}; '
                                'give two finite numbers')
        return values

    def size(self, block: SpotBlock) -> int:
        return len(block.x_m)

    def publish(self, block: SpotBlock) -> None:
        self._intensity = float(np.mean(block.intensity_V))
        self._dark = int(np.sum(~np.isfinite(block.x_m)))
        self._timing.publish(self.timing_of(block))
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
        if values['blocks'] and self._dark:
            return Health(WARN, 'no light on the detector: the beam misses it', values)
        return super().judge(values)


def _doubles(values: np.ndarray) -> array.array:
    return array.array('d', np.ascontiguousarray(values, np.float64).tobytes())


def main() -> int:
    return run_node(PsdDriver)


if __name__ == '__main__':
    sys.exit(main())
