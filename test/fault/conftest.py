"""The library that sets the system clock of a process."""

import shutil
import subprocess
from pathlib import Path

import pytest

COMPILER = shutil.which('cc') or shutil.which('gcc') or shutil.which('g++')


@pytest.fixture(scope='session')
def clock_shim(tmp_path_factory) -> Path:
    """``clock_shim.c`` compiled, to be preloaded."""
    if COMPILER is None:
        pytest.skip('no C compiler for clock_shim.c (apt-get install gcc)')
    library = tmp_path_factory.mktemp('shim') / 'clock_shim.so'
    subprocess.run([COMPILER, '-x', 'c', '-shared', '-fPIC', '-O1', '-o', str(library),
                    str(Path(__file__).with_name('clock_shim.c')), '-ldl', '-lpthread'], check=True)
    return library
