"""A test during which the computer stood still is no test: if it failed, it is run once more, and that is said.

A virtual computer may stand still for seconds or minutes.  Then the clock has gone on and nobody has measured: leases
have run out, logs have holes.  What the program makes of that has its own tests, which stop processes on purpose.
"""

import threading
import time
from collections.abc import Iterator
from contextlib import suppress

import pytest
from _pytest.runner import runtestprotocol

#: This process had no processor for so long, and used none.  A busy computer's scheduler leaves nobody out for as long.
STOOD_S, LOOK_S = 5.0, 0.5
SAID = 'run again'


class Standstills:
    """The plugin; its thread sees by its own lateness when the computer stood still."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._at_s, self._used_s, self._stood_s = time.monotonic(), time.process_time(), 0.0
        threading.Thread(target=self._watch, name='standstills', daemon=True).start()

    def _watch(self) -> None:
        while True:
            time.sleep(LOOK_S)
            self.look()

    def look(self) -> float:
        """For how long it stood still since the last :meth:`begin` [s]; 0.0: not worth a word."""
        with self._lock:
            now_s, used_s = time.monotonic(), time.process_time()
            stood_s = now_s - self._at_s - (used_s - self._used_s) - LOOK_S
            self._at_s, self._used_s = now_s, used_s
            if stood_s > STOOD_S:
                self._stood_s += stood_s
            return self._stood_s

    def begin(self) -> None:
        self.look()
        self._stood_s = 0.0

    def pytest_runtest_protocol(self, item: pytest.Item, nextitem: pytest.Item | None) -> bool:
        item.ihook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
        self.begin()
        reports = runtestprotocol(item, nextitem=nextitem, log=False)
        if any(report.failed for report in reports) and (stood_s := self.look()):
            # Whatever was up while it stood still is taken down, for the tests that follow as well.
            with suppress(Exception):
                item.session._setupstate.teardown_exact(None)
            item._initrequest()
            reports = runtestprotocol(item, nextitem=nextitem, log=False)
            reports[0].user_properties.append((SAID, f'the computer stood still for {stood_s:.0f} s'))
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
