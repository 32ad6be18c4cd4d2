"""What both sensor drivers share: one instrument, its thread, the setup in the stamps."""

import array
from abc import abstractmethod
from collections.abc import Callable
from typing import Any

import numpy as np
from std_msgs.msg import Header

from stepdiag_msgs.msg import SampleTiming
from stepdiag_msgs.srv import SelectSetup
from stepdiag_ros.devices.registry import DEFAULT, Driver, driver
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.nodes.acquisition import Acquisition
from stepdiag_ros.nodes.base import ERROR, OK, WARN, Health, StepdiagNode
from stepdiag_ros.nodes.clocks import answer_clock
from stepdiag_ros.nodes.marked import Marked
from stepdiag_ros.nodes.stamps import clock_name, stamp_of

LONGEST_BLOCK_S = 1.0


class DriverNode(StepdiagNode):
    """A sensor's node.  Configure connects, activate samples and publishes."""

    #: Name of the node's topics and services, and of the device in messages.
    sensor = ''

    def __init__(self, name: str, port: int):
        super().__init__(name)
        self.text('host', '', 'host name or address of the instrument', fixed=True)
        self.text('driver', DEFAULT[self.sensor], 'name of the driver of the instrument', fixed=True)
        self.count('port', port, 'TCP port of the instrument', 1, 65535, fixed=True)
        self.number('timeout', 5.0, 'silence after which the instrument counts as stalled',
                    0.1, 120.0, 's')
        self.number('sample_rate', 1000.0, 'samples a second', 1.0, 1.0e6, 'Hz')
        self.count('block_samples', 50, 'samples in one message, of at most one second', 1, 100_000)
        self.text('setup', '', 'the setup that is mounted at the start, e.g. ppp')
        self.marked = Marked(self)
        self.instrument: Any = None
        self.acquisition: Acquisition | None = None
        self.setup = self.value('setup')

    def driver(self) -> Driver:
        """The driver that the parameter names."""
        return driver(self.sensor, self.value('driver'), f'{self.get_name()}: parameter driver')

    @abstractmethod
    def build(self) -> Any:
        """The client of the instrument, from the parameters, not connected."""

    @abstractmethod
    def publish(self, block: Any) -> None:
        """Publish one block."""

    def timing_of(self, block: Any) -> SampleTiming:
        """When the samples of a block were taken, as it is published."""
        return SampleTiming(
            header=Header(stamp=stamp_of(block.stamp_ns), frame_id=self.setup),
            taken=array.array('i', block.accuracy.taken_ns.astype(np.int32).tobytes()),
            uncertainty=array.array('I', np.minimum(block.accuracy.uncertainty_ns, 2**32 - 1).astype(
                np.uint32).tobytes()),
            missed=block.accuracy.missed, clock=clock_name())

    @abstractmethod
    def size(self, block: Any) -> int:
        """Samples in a block."""

    def read(self) -> Any:
        """One block from the instrument."""
        if step_s := self.marked.follow_clock():
            self.instrument.shift_time(step_s)
            self.acquisition.retime()
        return self.instrument.read_block(self.samples(), 1.0 / self.value('sample_rate'))

    def samples(self) -> int:
        """Samples of the next block, at most those of :data:`LONGEST_BLOCK_S`: the one in hand is waited for."""
        return min(self.value('block_samples'), max(1, int(LONGEST_BLOCK_S * self.value('sample_rate'))))

    def lost(self) -> None:
        """The connection broke (in the acquisition's thread)."""

    def serve(self, prefix: str = '') -> None:
        """Offer the service that changes the setup (of the machine below ``prefix``), and tell the clock's time."""
        answer_clock(self, self.sensor, prefix)

        def answer(request, response):
            return self.between_blocks(lambda: self.select(request.setup, prefix), response)
        self.create_service(SelectSetup, f'{prefix}{self.sensor}/select_setup', answer)

    def select(self, setup: str, prefix: str) -> None:
        """Another setup from the next block on (in the acquisition's thread); empty: none is needed."""
        if not setup:
            return
        if hasattr(self.instrument, 'select_setup'):
            self.instrument.select_setup(setup)
        self.setup = setup

    def between_blocks(self, command: Callable[[], None], response: Any) -> Any:
        """Have the acquisition's thread do ``command`` and fill ``response`` with how it went.

        Waits, with the executor, for the block in hand: the events executor knows no
        coroutines as service callbacks (decision 0031).
        """
        if self.acquisition is None or not self.acquisition.running:
            response.success = False
            response.message = f'{self.get_name()} is not active'
            return response
        error = self.acquisition.call(command).exception()
        response.success = error is None
        response.message = '' if error is None else str(error)
        return response

    def configure(self) -> None:
        self.stated('host')
        self.instrument = self.build()
        try:
            self.instrument.connect()
        except StepdiagError:
            self.cleanup()
            raise

    def activate(self) -> None:
        self.acquisition = Acquisition(self.instrument, self.read, self.size, self.publish,
                                       self.get_logger().warning, self.lost)
        self.acquisition.start()

    def deactivate(self) -> None:
        if self.acquisition is not None:
            self.acquisition.stop()

    def cleanup(self) -> None:
        self.deactivate()
        self.acquisition = None
        if self.instrument is not None:
            self.instrument.close()
            self.instrument = None

    def health(self) -> Health:
        device = f'{self.value("host")}:{self.value("port")}'
        values: dict[str, Any] = {'device': device, 'setup': self.setup}
        work = self.acquisition
        if work is None or self.state != 'active':
            return Health(OK, self.state, values)
        values |= {'rate_Hz': work.rate, 'samples': work.samples, 'blocks': work.blocks,
                   'gaps': work.gaps, 'gap_s': work.gap_s, 'reconnects': work.reconnects, 'real_time': work.real_time}
        values |= self.more_values()
        if not work.running:
            return Health(ERROR, 'the acquisition has stopped', values)
        if work.error:
            return Health(ERROR, work.error, values)
        return self.judge(values)

    def more_values(self) -> dict[str, Any]:
        """Numbers of the sensor in question for the diagnostics."""
        return {}

    def judge(self, values: dict[str, Any]) -> Health:
        """The health of a sensor that delivers."""
        wanted = self.value('sample_rate')
        if values['blocks'] > 2 and values['rate_Hz'] < 0.9 * wanted:
            why = '' if values['real_time'] else '; not in real time (rtprio in /etc/security/limits.conf)'
            return Health(WARN, f'{values["rate_Hz"]:.0f} of {wanted:.0f} samples a second{why}', values)
        return Health(OK, 'measuring', values)
