"""The thread that owns an instrument: blocks of samples, and commands between them."""

import threading
import time
import traceback
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from pathlib import Path
from typing import Any

from stepdiag_ros.devices.base import DeviceError
from stepdiag_ros.devices.timing import go_first
from stepdiag_ros.errors import StepdiagError

RETRY_S = 1.0
#: A block that begins later than this many of its sample periods after the last one's end
#: left something out.
GAP_PERIODS = 1.5


class Acquisition:
    """Reads blocks from a connected ``instrument`` and hands them to ``deliver``.

    ``read()`` returns a block with ``stamp_ns`` and ``period_s``; ``size(block)`` its samples.
    ``report(text)`` is called when the instrument is lost or back; ``lost()`` is called in the
    acquisition's thread when the connection broke.  The thread is supervised: whatever is raised in
    it, expected or not, stands in ``error``, closes the connection, and connecting is tried again
    once a second until :meth:`stop`; ``error`` is empty again with the first block that arrives.
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
        self.real_time = False
        """Whether the system lets the thread go before other work."""
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
        """The supervised loop: no exception ends it, each one breaks the connection."""
        connected = True
        self.real_time = go_first()
        while not self._stop.is_set():
            try:
                if not connected:
                    if self._stop.wait(RETRY_S):
                        return
                    self._instrument.connect()
                    connected = True
                    self.reconnects += 1
                self._turn()
            except Exception as error:
                connected = False
                self._break(in_one_line(error))

    def _turn(self) -> None:
        """Commands that wait, then one block."""
        while self._commands:
            self._obey(*self._commands.popleft())
        block = self._read()
        self._account(block)
        if self.error:
            self.error = ''
            self._report('connected again')
        self._deliver(block)

    def _obey(self, command: Callable[[], Any], future: Future) -> None:
        try:
            future.set_result(command())
        except StepdiagError as error:
            future.set_exception(error)
            if isinstance(error, DeviceError):
                raise
        except Exception as error:
            future.set_exception(DeviceError(in_one_line(error)))
            raise
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
        """The connection cannot be used any more: close it, and report the first of several such."""
        first, self.error = not self.error, why
        self._expected_ns = None
        for step in (lambda: self._report(f'{why}; trying to connect again') if first else None,
                     self._lost, self._instrument.close):
            with suppress(Exception):   # whatever is broken beside it, connecting is tried again
                step()
        self._refuse(why)


def in_one_line(error: Exception) -> str:
    """What an exception says; one that nobody foresaw also says where it was raised."""
    if isinstance(error, StepdiagError):
        return str(error)
    frames = traceback.extract_tb(error.__traceback__)
    at = f' ({Path(frames[-1].filename).name}:{frames[-1].lineno})' if frames else ''
    said = ' '.join(str(error).split())[:200]
    return f'an answer could not be used: {type(error).__name__}{": " if said else ""}{said}{at}'
