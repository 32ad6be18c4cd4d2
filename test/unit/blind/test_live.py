"""What a live world needs beside its cell."""

import subprocess
import sys
import time
from pathlib import Path

PARENT = """
import sys
from stepdiag_ros.blind.live import busy_loop
print(busy_loop().pid, flush=True)
sys.stdin.read()
"""


def test_no_core_stays_busy_when_who_asked_for_it_was_killed():
    parent = subprocess.Popen([sys.executable, '-c', PARENT], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    loop = Path('/proc') / parent.stdout.readline().strip()
    assert loop.exists()
    parent.kill()
    parent.wait()
    parent.stdin.close()
    parent.stdout.close()
    until = time.monotonic() + 60.0
    while running(loop) and time.monotonic() < until:
        time.sleep(0.05)
    assert not running(loop)


def running(process: Path) -> bool:
    """Whether it is there and not only waiting to be asked how it ended."""
    try:
        return (process / 'stat').read_text().rpartition(')')[2].split()[0] != 'Z'
    except (FileNotFoundError, ProcessLookupError):
        return False
