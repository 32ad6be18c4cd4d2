"""Builds and installs LinuxCNC's two components of this package, by LinuxCNC's own ``halcompile``."""

import os
import shutil
import subprocess
import tempfile
from importlib import resources
from pathlib import Path

from stepdiag_ros.errors import StepdiagError

COMPONENTS = ('stepdiagkins', 'stepdiagwatch')
SOURCES = ('volume_field.h', 'stepdiagkins.c', 'stepdiagwatch.c')
MODULES = Path('/usr/lib/linuxcnc/modules')
"""Where Debian's LinuxCNC has its realtime modules."""


def installed(component: str, modules: Path = MODULES) -> bool:
    """Whether LinuxCNC can load a component."""
    return (modules / f'{component}.so').is_file()


def install(into: Path | None = None) -> list[Path]:
    """Build the components and put them where LinuxCNC loads them from; returns the files.

    ``into``: only build, and put them there.
    """
    if shutil.which('halcompile') is None:
        raise StepdiagError('halcompile is not installed; on Debian: sudo apt-get install linuxcnc-uspace-dev')
    if into is None and not os.access(MODULES, os.W_OK):
        raise StepdiagError(f'{MODULES}: may not be written; run this command with sudo')
    with tempfile.TemporaryDirectory(prefix='stepdiag-build-') as folder:
        for name in SOURCES:
            text = resources.files('stepdiag_ros.linuxcnc').joinpath(name).read_text(encoding='utf-8')
            (Path(folder) / name).write_text(text, encoding='utf-8')
        made = []
        for component in COMPONENTS:
            build = subprocess.run(['halcompile', '--compile', f'{component}.c'], cwd=folder, text=True,
                                   stdout=subprocess.PIPE, stderr=subprocess.STDOUT, check=False)
            file = Path(folder) / f'{component}.so'
            if build.returncode or not file.exists():
                raise StepdiagError(f'{component}.c: halcompile fails: {build.stdout.strip()[-300:]}')
            target = (into or MODULES) / file.name
            try:
                # A module that a running LinuxCNC has mapped is replaced, never overwritten.
                part = target.with_name(f'.{file.name}.new')
                shutil.copyfile(file, part)
                part.chmod(0o644)
                part.replace(target)
            except OSError as error:
                raise StepdiagError(f'{target}: cannot be written: {error.strerror or error}') from None
            made.append(target)
    return made
