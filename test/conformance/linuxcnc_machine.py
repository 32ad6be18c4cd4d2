"""What the tests against a real LinuxCNC share: configurations, HAL's own tools, the components."""

import os
import shutil
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from drawn_machine import ORIGIN, TRAVEL

from stepdiag_ros.devices.linuxcnc_rsh import LinuxCncRsh
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.linuxcnc import configuration, install
from stepdiag_ros.linuxcnc.running import GROUP, USER, LinuxCnc, free_port, missing
from stepdiag_ros.nodes.patience import Patience

#: LinuxCNC's own sampler keeps what some pins are in each servo cycle; its second channel only counts the cycles.
SAMPLED_HAL, DEPTH = 'sampled.hal', 30_000


def sampled(ini: str, pins: Sequence[str]) -> dict[str, str]:
    """Files that have a configuration keep ``pins`` (floats), for :meth:`Running.sampling`."""
    lines = [f'loadrt sampler depth={DEPTH},10 cfg={"f" * len(pins)},b', 'setp sampler.0.enable 0']
    lines += [f'net sampled-{i} {pin} => sampler.0.pin.{i}' for i, pin in enumerate(pins)]
    lines += ['addf sampler.0 servo-thread', 'addf sampler.1 servo-thread']
    return {'machine.ini': configuration.with_halfile(ini, SAMPLED_HAL), SAMPLED_HAL: '\n'.join(lines) + '\n'}


def need_linuxcnc() -> None:
    """Skip, and say why, where LinuxCNC is not installed."""
    if missing():
        pytest.skip(missing())


def need_components() -> None:
    """Build and install the components, or skip and say why not."""
    need_linuxcnc()
    try:
        install.install()
    except StepdiagError as error:
        if not all(map(install.installed, install.COMPONENTS)):
            pytest.skip(str(error))


def configured(folder: Path, speed: float = 0.5, watched: bool = True) -> int:
    """A simulated machine's configuration, with the watchdog; its heartbeat port (0 without)."""
    files = configuration.simulated('test', TRAVEL, ORIGIN, speed, 2.0)
    port = 0
    if watched:
        port = free_port()
        files |= configuration.watched(files['machine.ini'], port)
    configuration.write(folder, files)
    return port


class Running:
    """A LinuxCNC with its client and HAL's tools; a context manager."""

    def __init__(self, folder: Path, watch_port: int = 0):
        self.machine = LinuxCnc(folder)
        self.client = LinuxCncRsh('127.0.0.1', self.machine.port, ORIGIN, timeout_s=30.0,
                                  watch_port=watch_port)

    def __enter__(self) -> 'Running':
        try:
            self.machine.start()
            self.client.connect()
            self.client.make_ready()
        except BaseException:
            self.machine.stop()
            raise
        return self

    def __exit__(self, *exception) -> None:
        try:
            self.client.close()
        finally:
            self.machine.stop()

    def hal(self, *words: str) -> str:
        """What ``halcmd`` answers."""
        return self._tool('halcmd', *words)

    def _tool(self, program: str, *words: str) -> str:
        whom = {'user': USER, 'group': GROUP, 'extra_groups': []} if os.getuid() == 0 else {}
        done = subprocess.run([shutil.which(program), *words], capture_output=True, text=True, check=True,
                              env=os.environ | {'HOME': str(self.machine.folder)}, cwd=self.machine.folder, **whom)
        return done.stdout.strip()

    def joints(self) -> np.ndarray:
        """Joint positions (3,) [m] from the volume's corner, to the nanometre."""
        words = self.client._get('joint_pos').split()[:3]
        return np.array([float(word) for word in words]) * 1e-3 - ORIGIN

    def cycles(self, count: int) -> None:
        """Wait until that many servo cycles have passed, however long the computer takes for them."""
        patience, wanted = Patience(120.0), self._cycle() + count
        while self._cycle() < wanted:
            assert not patience.over(), f'{count} servo cycles do not pass'

    def _cycle(self) -> int:
        """Nobody empties the second channel: its overruns count the cycles."""
        return int(self.hal('getp', 'sampler.1.overruns'))

    @contextmanager
    def sampling(self) -> Iterator[list[np.ndarray]]:
        """At the end the list holds what the pins of :func:`sampled` were, one row a servo cycle."""
        rows: list[np.ndarray] = []
        self.hal('setp', 'sampler.0.enable', '1')
        yield rows
        self.hal('setp', 'sampler.0.enable', '0')
        assert self.hal('getp', 'sampler.0.overruns') == '0', 'the ramp took longer than the sampler keeps'
        text = self._tool('halsampler', '-t', '-n', self.hal('getp', 'sampler.0.curr-depth'))
        # A halsampler that begins later than the first sample calls that an overrun; the numbers are what counts.
        table = np.array([line.split() for line in text.splitlines() if line != 'overrun'], float)
        assert np.all(np.diff(table[:, 0]) == 1.0), 'a servo cycle is missing'
        rows.extend(table[:, 1:])
