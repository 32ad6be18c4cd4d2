"""Who runs beside whom: tests on running machines take turns, and what computes gives way to them.

Two graphs at once ask more of two slow processors than they have, and then nothing is in time.  So all tests that run
a graph, instruments and a machine in real time go to one worker, one after another.  Of the LinuxCNCs a computer runs
one at a time, whoever else tests on it.
"""

import fcntl
import os
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

import pytest

#: Where the tests are that run in real time.
LIVE = ('test/conformance/test_colcon', 'test/conformance/test_linuxcnc', 'test/conformance/test_ros2_launch',
        'test/conformance/test_web', 'test/fault/', 'test/node/')
#: Niceness of a worker that computes beside them.
GIVES_WAY = 10

_turn: IO[str] | None = None


def is_live(nodeid: str) -> bool:
    return nodeid.startswith(LIVE)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    from xdist.scheduler import LoadFileScheduling

    class LiveInTurn(LoadFileScheduling):
        """A file to a worker, and all live ones to one."""

        def _split_scope(self, nodeid: str) -> str:
            return 'live' if is_live(nodeid) else super()._split_scope(nodeid)

    return LiveInTurn(config, log)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    # They take longest, and who has computed once gives way to the end.
    items.sort(key=lambda item: not is_live(item.nodeid))


def pytest_runtest_setup(item: pytest.Item) -> None:
    if 'PYTEST_XDIST_WORKER' in os.environ and not is_live(item.nodeid):
        os.nice(max(0, GIVES_WAY - os.nice(0)))


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item, nextitem: pytest.Item | None) -> Iterator[None]:
    """Modules with tests on a LinuxCNC take turns: a computer runs one at a time, and what waits for it while it starts
    gives up one day.  The wait is before the test's own time begins."""
    global _turn
    if _turn is None and item.get_closest_marker('linuxcnc') is not None:
        _turn = open(Path('/tmp') / f'stepdiag-linuxcnc-tests-{os.getuid()}', 'w')
        fcntl.flock(_turn, fcntl.LOCK_EX)
    try:
        return (yield)
    finally:
        # The module's fixtures, a LinuxCNC among them, live until its last test.
        if _turn is not None and (nextitem is None or nextitem.path != item.path):
            _turn.close()
            _turn = None
