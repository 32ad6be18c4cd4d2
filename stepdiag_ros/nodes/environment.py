"""The process environment that the graph runs in."""

import os
import random
import socket
from pathlib import Path

#: The graph stays on this machine and on UDP.  A killed process leaves its shared-memory
#: ports locked and the next one is deaf; and with the discovery range LOCALHOST rmw_fastrtps
#: sets shared memory up whatever else is asked for (decision 0003).
LOOPBACK_PROFILE = Path(__file__).with_name('fastdds_loopback.xml')
#: Whoever sets one of these has a network of his own in mind.
NETWORK = ('ROS_AUTOMATIC_DISCOVERY_RANGE', 'ROS_STATIC_PEERS', 'FASTRTPS_DEFAULT_PROFILES_FILE',
           'FASTDDS_DEFAULT_PROFILES_FILE', 'ROS_DISCOVERY_SERVER')
DOMAINS = range(1, 100)


def prepare() -> None:
    """Set what the user has not; call it before rclpy is imported."""
    os.environ.setdefault('RMW_IMPLEMENTATION', 'rmw_fastrtps_cpp')
    if not any(name in os.environ for name in NETWORK):
        os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'SYSTEM_DEFAULT'
        os.environ['FASTRTPS_DEFAULT_PROFILES_FILE'] = str(LOOPBACK_PROFILE)


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
