"""What the tests against a real LinuxCNC share: configurations, HAL's own tools, the components."""

import os
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from drawn_machine import ORIGIN, TRAVEL

from stepdiag_ros.devices.linuxcnc_rsh import LinuxCncRsh
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.linuxcnc import configuration, install
from stepdiag_ros.linuxcnc.running import GROUP, USER, LinuxCnc, free_port, missing


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
        self.client = LinuxCncRsh('127.0.0.1', self.machine.port, ORIGIN, watch_port=watch_port)

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
        whom = {'user': USER, 'group': GROUP, 'extra_groups': []} if os.getuid() == 0 else {}
        done = subprocess.run([shutil.which('halcmd'), *words], capture_output=True, text=True, check=True,
                              env=os.environ | {'HOME': str(self.machine.folder)}, cwd=self.machine.folder, **whom)
        return done.stdout.strip()

    def joints(self) -> np.ndarray:
        """Joint positions (3,) [m] from the volume's corner, to the nanometre."""
        words = self.client._get('joint_pos').split()[:3]
        return np.array([float(word) for word in words]) * 1e-3 - ORIGIN
