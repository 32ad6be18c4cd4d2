"""What DDS has in this process."""

from pathlib import Path


def participants() -> int:
    """How many participants there are: each has a thread for its timers."""
    names = []
    for name in Path('/proc/self/task').glob('*/comm'):
        try:
            names.append(name.read_text())
        except OSError:
            continue    # it has just ended
    return sum(name.startswith('dds.ev') for name in names)
