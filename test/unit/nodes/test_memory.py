"""What a thread has freed goes back to the system."""

import threading
from pathlib import Path

import numpy as np

from stepdiag_ros.nodes.memory import give_back


def anonymous_mib() -> float:
    line = next(line for line in Path('/proc/self/status').read_text().splitlines() if line.startswith('RssAnon:'))
    return int(line.split()[1]) / 1024


def test_freed_memory_of_a_thread_goes_back():
    few = []

    def compute() -> None:
        # Below the size from which the allocator maps memory apart; a few in between survive, as in a computation.
        many = [np.ones(2000) for _ in range(8000)]
        few.extend(many[::200])
    give_back()     # what other tests of this process have freed would serve this one
    before = anonymous_mib()
    thread = threading.Thread(target=compute)
    thread.start()
    thread.join()
    held = anonymous_mib() - before
    give_back()
    assert held > 60.0, 'the allocator keeps nothing: this test, and what it tests, are not needed any more'
    assert anonymous_mib() - before < 0.3 * held
