"""Times in nanoseconds since the epoch and as ROS messages."""

from builtin_interfaces.msg import Time

SECOND = 1_000_000_000


def stamp_of(time_ns: int) -> Time:
    """Nanoseconds since the epoch as a ROS time."""
    return Time(sec=int(time_ns // SECOND), nanosec=int(time_ns % SECOND))


def ns_of(stamp: Time) -> int:
    """A ROS time as nanoseconds since the epoch."""
    return stamp.sec * SECOND + stamp.nanosec
