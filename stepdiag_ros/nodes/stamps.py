"""Times in nanoseconds since the epoch and as ROS messages."""

import socket
from functools import cache
from pathlib import Path

from builtin_interfaces.msg import Time

SECOND = 1_000_000_000


@cache
def clock_name() -> str:
    """The name of this computer's clock: who has the same name has the same clock, containers too."""
    try:
        return Path('/proc/sys/kernel/random/boot_id').read_text(encoding='ascii').strip()
    except OSError:
        return socket.gethostname()


def stamp_of(time_ns: int) -> Time:
    """Nanoseconds since the epoch as a ROS time."""
    return Time(sec=int(time_ns // SECOND), nanosec=int(time_ns % SECOND))


def ns_of(stamp: Time) -> int:
    """A ROS time as nanoseconds since the epoch."""
    return stamp.sec * SECOND + stamp.nanosec
