"""One LinuxCNC at a time on a computer: who comes second waits, and says so."""

import fcntl
import tempfile
import threading
import time

import pytest

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.linuxcnc import running


def test_who_comes_second_waits_and_says_for_what(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, 'tempdir', str(tmp_path))
    running.wait_until_free()
    said, first = [], running._lock()
    fcntl.flock(first, fcntl.LOCK_EX)
    end = threading.Timer(0.5, first.close)
    end.start()
    began = time.monotonic()
    running.wait_until_free(said.append)
    assert time.monotonic() - began > 0.4 and len(said) == 1 and 'another LinuxCNC' in said[0]
    end.join()
    monkeypatch.setattr(running, 'WAIT_FOR_LOCK_S', 0.0)
    with running._lock() as other:
        fcntl.flock(other, fcntl.LOCK_EX)
        with pytest.raises(StepdiagError, match='only one can'):
            running.wait_until_free()
