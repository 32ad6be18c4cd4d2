"""A test during which the computer was not there is no test: if it failed, it is run again, and that is said.

A virtual computer, or one of its processors, may stand still for seconds or minutes, be given away in slices, or wait
for its disk.  Then the clock has gone on and nobody has measured: leases have run out, logs have holes.  What the
program makes of that has its own tests, which stop processes on purpose.
"""

import os
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest
from _pytest.runner import runtestprotocol

#: A process that is ready to run waited so long for a processor, and used none: a busy computer's scheduler leaves
#: nobody out for as long, and the shortest lease, that of a moving machine, runs out.
STOOD_S, LOOK_S = 1.0, 0.25
#: Given to others, or waiting for the disk, for at least so long and for such a share of the test.
LOST_S, LOST_SHARE = 2.0, 0.2
#: A test is run so often at most; what made it fail may last.
RUNS = 3
SAID = 'run again'


class Processor:
    """Sees by a thread's lateness when a processor stood still."""

    def __init__(self, number: int) -> None:
        self._number, self._lock = number, threading.Lock()
        self._at_s, self._used_s, self.stood_s = time.monotonic(), time.process_time(), 0.0
        threading.Thread(target=self._watch, name=f'processor {number}', daemon=True).start()

    def _watch(self) -> None:
        with suppress(OSError):  # a processor that this process may not use
            os.sched_setaffinity(0, {self._number})
        while True:
            time.sleep(LOOK_S)
            self.look()

    def look(self) -> float:
        """For how long it has stood still so far [s]."""
        with self._lock:
            now_s, used_s = time.monotonic(), time.process_time()
            late_s = now_s - self._at_s - (used_s - self._used_s) - LOOK_S
            self._at_s, self._used_s = now_s, used_s
            if late_s > STOOD_S:
                self.stood_s += late_s
            return self.stood_s


def stolen_s() -> float:
    """For how long a processor has been given to others so far, in the mean of all [s]; 0.0 where nobody says."""
    with suppress(OSError, IndexError, ValueError):
        fields = Path('/proc/stat').read_text().split('\n', 1)[0].split()
        return float(fields[8]) / os.sysconf('SC_CLK_TCK') / (os.cpu_count() or 1)
    return 0.0


def disk_s() -> float:
    """For how long somebody has waited for the disk so far [s]; 0.0 where nobody says."""
    with suppress(OSError, IndexError, ValueError):
        return float(Path('/proc/pressure/io').read_text().split('\n', 1)[0].split('total=')[1]) * 1e-6
    return 0.0


class Standstills:
    """The plugin."""

    def __init__(self) -> None:
        self._processors = [Processor(number) for number in sorted(os.sched_getaffinity(0))]
        self.begin()

    def _now(self) -> tuple[float, float, float, float]:
        return time.monotonic(), sum(each.look() for each in self._processors), stolen_s(), disk_s()

    def begin(self) -> None:
        self._began = self._now()

    def why(self) -> str:
        """What the computer was not there for since :meth:`begin`; empty: it was there."""
        took_s, stood_s, stolen, disk = (now - then for now, then in zip(self._now(), self._began, strict=True))
        if stood_s:
            return f'the computer stood still for {stood_s:.0f} s'
        for lost_s, what in ((stolen, 'had given its processors away'), (disk, 'waited for its disk')):
            if lost_s > max(LOST_S, LOST_SHARE * took_s):
                return f'the computer {what} for {lost_s:.0f} of {took_s:.0f} s'
        return ''

    def pytest_runtest_protocol(self, item: pytest.Item, nextitem: pytest.Item | None) -> bool:
        item.ihook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
        whys: list[str] = []
        while True:
            self.begin()
            reports = runtestprotocol(item, nextitem=nextitem, log=False)
            why = self.why() if any(report.failed for report in reports) else ''
            if not why or len(whys) == RUNS - 1:
                break
            whys.append(why)
            # Whatever was up while it stood still is taken down, for the tests that follow as well.
            with suppress(Exception):
                item.session._setupstate.teardown_exact(None)
            item._initrequest()
        if whys:
            reports[0].user_properties.append((SAID, '; '.join(whys)))
        for report in reports:
            item.ihook.pytest_runtest_logreport(report=report)
        item.ihook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
        return True

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        for report, why in _run_again(terminalreporter):
            terminalreporter.write_line(f'RUN AGAIN {report.nodeid}: {why}', yellow=True)


def _run_again(terminalreporter: pytest.TerminalReporter) -> Iterator[tuple[pytest.TestReport, str]]:
    for reports in terminalreporter.stats.values():
        for report in reports:
            for name, value in getattr(report, 'user_properties', ()):
                if name == SAID:
                    yield report, value
