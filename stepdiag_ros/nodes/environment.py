"""The process environment that the graph runs in."""

import os
import random
import socket

#: Defaults that a user's own setting overrides.  UDP instead of shared memory: a
#: killed process leaves its shared-memory ports locked, and the next one is deaf.
DEFAULTS = {'RMW_IMPLEMENTATION': 'rmw_fastrtps_cpp',
            'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST',
            'FASTDDS_BUILTIN_TRANSPORTS': 'UDPv4'}
DOMAINS = range(1, 100)


def prepare() -> None:
    """Set what the user has not; call it before rclpy is imported."""
    for name, value in DEFAULTS.items():
        os.environ.setdefault(name, value)


def free_domain() -> int:
    """A ``ROS_DOMAIN_ID`` in which nobody on this host listens just now.

    The first participant of domain d takes UDP port 7400 + 250 d + 10.
    """
    candidates = list(DOMAINS)
    random.SystemRandom().shuffle(candidates)
    for domain in candidates:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                probe.bind(('', 7400 + 250 * domain + 10))
            except OSError:
                continue
            return domain
    return candidates[0]
