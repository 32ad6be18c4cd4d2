"""Writes requirements/constraints.txt: the versions of what the named packages pulled in.

Run it with the environment's Python after a change of the other requirement files:
`make setup-tests && .venv/bin/python tools/pin_constraints.py`.
"""

import re
from importlib import metadata
from pathlib import Path

REQUIREMENTS = Path(__file__).resolve().parent.parent / 'requirements'
HEADER = '# Exact versions of what the packages named in the other files pull in.\n'
OWN = {'pip', 'stepdiag-ros'}


def canonical(name: str) -> str:
    """A package's name as indexes compare it."""
    return re.sub(r'[-_.]+', '-', name).lower()


def named() -> set[str]:
    """Packages that the other requirement files name themselves."""
    names = set()
    for file in REQUIREMENTS.glob('*.txt'):
        if file.name in ('constraints.txt', 'locked.txt'):   # they name what was pulled in, too
            continue
        for line in file.read_text().splitlines():
            requirement = line.split('#')[0].strip()
            if requirement:
                names.add(canonical(re.split(r'[=\[;]', requirement)[0].strip()))
    return names


def main() -> None:
    known = named() | OWN
    lines = set()
    for distribution in metadata.distributions():
        # The ROS wheels carry descriptions of packages that no index has: pip did not install those.
        by_pip = (distribution.read_text('INSTALLER') or '').strip() == 'pip'
        if by_pip and canonical(distribution.name) not in known:
            lines.add(f'{distribution.name}=={distribution.version}\n')
    (REQUIREMENTS / 'constraints.txt').write_text(HEADER + ''.join(sorted(lines, key=str.lower)))


if __name__ == '__main__':
    main()
