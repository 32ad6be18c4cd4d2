"""The process environment that the graph runs in."""

import os
import random
import socket
from pathlib import Path

#: The graph stays on this machine and on UDP.  A killed process leaves its shared-memory
#: ports locked and the next one is deaf; and with the discovery range LOCALHOST rmw_fastrtps
#: sets shared memory up whatever else is asked for (decision 0003).
LOOPBACK_PROFILE = Path(__file__).with_name('fastdds_loopback.xml')
#: What widens or replaces the network that ROS nodes talk over.
NETWORK = ('ROS_AUTOMATIC_DISCOVERY_RANGE', 'ROS_STATIC_PEERS', 'ROS_LOCALHOST_ONLY', 'FASTRTPS_DEFAULT_PROFILES_FILE',
           'FASTDDS_DEFAULT_PROFILES_FILE', 'FASTDDS_BUILTIN_TRANSPORTS', 'SKIP_DEFAULT_XML_FILE',
           'ROS_DISCOVERY_SERVER', 'ROS_SUPER_CLIENT', 'CYCLONEDDS_URI')
FAST_DDS = ('rmw_fastrtps_cpp', 'rmw_fastrtps_dynamic_cpp')
CYCLONE_DDS = ('rmw_cyclonedds_cpp',)
DOMAINS = range(1, 100)
#: The key ``network`` of a cell, and the variable that hands it on to nodes and commands.
SCOPE = 'STEPDIAG_NETWORK'
LOOPBACK, OPEN = 'loopback', 'open'


#: What the user had set before it was replaced.
_given: dict[str, str] = {}


def prepare(network: str | None = None) -> str:
    """Set the scope of the network, ``loopback`` or ``open``, for this process and those it starts.

    Without ``network`` it is what ``STEPDIAG_NETWORK`` says, loopback otherwise.  To be called before
    rclpy is imported.  Returns what is to be reported of it: on loopback what of the environment is
    not followed (mostly nothing), with an open network a warning.
    """
    middleware = os.environ.setdefault('RMW_IMPLEMENTATION', 'rmw_fastrtps_cpp')
    scope = os.environ[SCOPE] = network or os.environ.get(SCOPE) or LOOPBACK
    if middleware in FAST_DDS:
        # Fast DDS reads a file DEFAULT_FASTRTPS_PROFILES.xml of the folder that it is started in, too, if it may.
        ours = {'ROS_AUTOMATIC_DISCOVERY_RANGE': 'SYSTEM_DEFAULT',
                'FASTRTPS_DEFAULT_PROFILES_FILE': str(LOOPBACK_PROFILE), 'SKIP_DEFAULT_XML_FILE': '1'}
    else:
        ours = {'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST'}
    for name in NETWORK:
        value = os.environ.pop(name, '')
        if value and value != ours.get(name):
            _given[name] = value
    if scope == OPEN:
        os.environ |= _given
        return ('WARNING: the network is OPEN (the cell says so): whoever reaches this computer can move the '
                f'machine and read all. Commands reach it with {SCOPE}={OPEN}')
    os.environ |= ours
    if middleware not in (*FAST_DDS, *CYCLONE_DDS):
        return (f'WARNING: how far the network goes is not known with {middleware}; see its own configuration, or take '
                f'{FAST_DDS[0]}')
    ignored = ', '.join(f'{name}={value}' for name, value in _given.items())
    return f'the network is loopback, as the cell says; not followed: {ignored}' if ignored else ''


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
