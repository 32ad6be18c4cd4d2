"""QoS profiles as rosbag2 stores them (metadata version 9: names, not numbers)."""

from typing import Any

import yaml

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.guard import strict_yaml

_FOREVER = {'sec': 9223372036, 'nsec': 854775807}


def qos_profile(depth: int = 1000, reliability: str = 'reliable', durability: str = 'volatile',
                history: str = 'keep_last') -> dict:
    """One profile as a mapping; deadline, lifespan and lease without end."""
    return {'history': history, 'depth': depth, 'reliability': reliability, 'durability': durability,
            'deadline': dict(_FOREVER), 'lifespan': dict(_FOREVER), 'liveliness': 'automatic',
            'liveliness_lease_duration': dict(_FOREVER), 'avoid_ros_namespace_conventions': False}


def qos_yaml(*profiles: dict) -> str:
    """The text for channel metadata and ``metadata.yaml``: a YAML list of profiles."""
    return yaml.dump(list(profiles), Dumper=PlainDumper, sort_keys=False,
                     default_flow_style=False, width=1 << 20).strip()


def parse_qos(text: str, topic: str) -> list[dict]:
    """The list behind ``text``; :class:`StepdiagError` if it is none."""
    try:
        profiles: object = strict_yaml.load(text, topic) if text.strip() else []
    except StepdiagError as error:
        profiles = error
    if not isinstance(profiles, list) or not all(isinstance(p, dict) for p in profiles):
        raise StepdiagError(f'topic {topic}: its QoS is no YAML list of profiles: {text.strip()[:80]!r}')
    return profiles


_Dumper: Any = getattr(yaml, 'CSafeDumper', yaml.SafeDumper)


class PlainDumper(_Dumper):
    """YAML without anchors (yaml-cpp reads them, people do not), by libyaml where it is there."""

    def ignore_aliases(self, data):
        return True


#: Sources that come in blocks; the description, which late joiners must get too.
RELIABLE = qos_yaml(qos_profile())
LATCHED = qos_yaml(qos_profile(depth=1, durability='transient_local'))
