"""The thread that owns an instrument: blocks of samples, and commands between them."""

import threading
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any

from stepdiag_ros.devices.base import DeviceError
from stepdiag_ros.errors import StepdiagError

RETRY_S = 1.0
#: A block that begins later than this many of its sample periods after the last one's end
#: left something out.
GAP_PERIODS = 1.5


class Acquisition:
    """Reads blocks from a connected ``instrument`` and hands them to ``deliver``.

    ``read()`` returns a block with ``stamp_ns`` and ``period_s``; ``size(block)`` its samples.
    ``report(text)`` is told when the instrument is lost or back; ``lost()`` is called in the
    acquisition's thread when the connection broke.  After a :class:`DeviceError` connecting
    is tried again once a second until :meth:`stop`.
    """

    def __init__(self, instrument: Any, read: Callable[[], Any], size: Callable[[Any], int],
                 deliver: Callable[[Any], None], report: Callable[[str], None],
                 lost: Callable[[], None] = lambda: None):
        self._instrument, self._read, self._size = instrument, read, size
        self._deliver, self._report, self._lost = deliver, report, lost
        self._commands: deque[tuple[Callable[[], Any], Future]] = deque()
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None
        self._expected_ns: int | None = None
        self._rates: deque[tuple[float, int]] = deque(maxlen=400)
        self.samples = 0
        self.blocks = 0
        self.gaps = 0
        self.gap_s = 0.0
        self.reconnects = 0
        self.error = ''

    @property
    def running(self) -> bool:
        return self._thread is not None and self._thread.is_alive()

    @property
    def rate(self) -> float:
        """Samples a second over the last two seconds."""
        now = time.monotonic()
        recent = [(t, n) for t, n in list(self._rates) if now - t <= 2.0]
        if len(recent) < 2:
            return 0.0
        return sum(n for _, n in recent[1:]) / (recent[-1][0] - recent[0][0])

    def start(self) -> None:
        self._stop.clear()
        self._expected_ns = None
        self._thread = threading.Thread(target=self._run, name='acquisition', daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """End after the block in hand; commands that still wait are refused."""
        self._stop.set()
        if self._thread is not None:
            self._thread.join()
            self._thread = None
        self._refuse('is not active')

    def retime(self) -> None:
        """The clock behind the stamps was set: the next block leaves nothing out (to be called by ``read``)."""
        self._expected_ns = None

    def call(self, command: Callable[[], Any]) -> Future:
        """Have ``command()`` called by the thread between two blocks."""
        future: Future = Future()
        self._commands.append((command, future))
        if not self.running:
            self._refuse('is not active')
        return future

    def _refuse(self, why: str) -> None:
        while self._commands:
            _, future = self._commands.popleft()
            future.set_exception(DeviceError(why))

    def _run(self) -> None:
        while not self._stop.is_set():
            try:
                while self._commands:
                    self._obey(*self._commands.popleft())
                block = self._read()
            except DeviceError as error:
                self._break(str(error))
                continue
            self._account(block)
            self._deliver(block)

    def _obey(self, command: Callable[[], Any], future: Future) -> None:
        try:
            future.set_result(command())
        except DeviceError as error:
            future.set_exception(error)
            raise
        except StepdiagError as error:
            future.set_exception(error)
        # A command takes time in which nothing is sampled; that is no loss.
        self._expected_ns = None

    def _account(self, block: Any) -> None:
        count = self._size(block)
        self.samples += count
        self.blocks += 1
        self._rates.append((time.monotonic(), count))
        if self._expected_ns is not None:
            late_s = (block.stamp_ns - self._expected_ns) * 1e-9
            if late_s > GAP_PERIODS * block.period_s:
                self.gaps += 1
                self.gap_s += late_s
        self._expected_ns = block.stamp_ns + round(count * block.period_s * 1e9)

    def _break(self, why: str) -> None:
        """The connection is gone: say so, and try to get it back until told to stop."""
        self.error = why
        self._expected_ns = None
        self._report(f'{why}; trying to connect again')
        self._lost()
        self._instrument.close()
        self._refuse(why)
        while not self._stop.wait(RETRY_S):
            try:
                self._instrument.connect()
            except DeviceError as error:
                self.error = str(error)
                self._refuse(self.error)
                continue
            self.error = ''
            self.reconnects += 1
            self._report('connected again')
            return
