"""Reports of finished bags: made when somebody asks for one, in a process of its own, kept while the page is served.

A browser names a report by the number of its bag in the list, never by a path: only bags that a recorder has closed
are read.
"""

import asyncio
import contextlib
import hashlib
import os
import sys
import tempfile
from pathlib import Path
from typing import Any

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.nodes.observer import Observer

LONGEST_S = 600.0


class Reports:
    """The reports of the bags that an observer has seen closed; a context manager."""

    def __init__(self, observer: Observer):
        self._observer = observer
        self._folder = tempfile.TemporaryDirectory(prefix='stepdiag-web-')
        self._one = asyncio.Lock()

    def __enter__(self) -> 'Reports':
        return self

    def __exit__(self, *_exception) -> None:
        self._folder.cleanup()

    def listed(self) -> list[dict[str, Any]]:
        """Name, machine and address of each, the newest first."""
        return [{'machine': machine, 'name': Path(bag).name, 'address': f'/report/{_key(machine, bag)}'}
                for machine, bag in self._observer.bags()]

    async def page(self, key: str) -> str | None:
        """The page of a report; None: no such bag.  :class:`StepdiagError` where it cannot be made."""
        found = next(((machine, bag) for machine, bag in self._observer.bags() if _key(machine, bag) == key), None)
        if found is None:
            return None
        out = Path(self._folder.name) / key
        async with self._one:     # one after another: machines may be measuring on this computer
            if not (out / 'index.html').exists():
                await _make(*found, out)
        return (out / 'index.html').read_text(encoding='utf-8')


def _key(machine: str, bag: str) -> str:
    return hashlib.sha256(f'{machine}\0{bag}'.encode()).hexdigest()[:16]


async def _make(machine: str, bag: str, out: Path) -> None:
    if not Path(bag).exists():
        raise StepdiagError(f'{bag}: is not on this computer')
    process = await asyncio.create_subprocess_exec(
        sys.executable, '-m', 'stepdiag_ros.cli.main', 'report', bag, '--namespace', machine, '--out', str(out),
        stdin=asyncio.subprocess.DEVNULL, stdout=asyncio.subprocess.DEVNULL, stderr=asyncio.subprocess.PIPE,
        preexec_fn=lambda: os.nice(10))
    try:
        _, said = await asyncio.wait_for(process.communicate(), LONGEST_S)
    except BaseException:
        with contextlib.suppress(ProcessLookupError):
            process.kill()
        raise
    if process.returncode:
        lines = said.decode('utf-8', 'replace').strip().splitlines() or ['no reason was given']
        raise StepdiagError(lines[-1].removeprefix('stepdiag: '))
