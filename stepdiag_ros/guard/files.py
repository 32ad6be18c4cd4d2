"""Files that are named from outside: regular files only, and their size is known before they are read."""

import os
import stat
from pathlib import Path
from typing import BinaryIO

from stepdiag_ros.errors import StepdiagError


def open_regular(path: str | Path) -> BinaryIO:
    """The file at ``path``, open for reading; :class:`StepdiagError` if it is none, or a pipe or a device."""
    try:
        # Without O_NONBLOCK opening a pipe would wait for a writer.
        number = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except (OSError, ValueError) as error:
        raise StepdiagError(f'{path}: cannot be read: {getattr(error, "strerror", None) or error}') from None
    if not stat.S_ISREG(os.fstat(number).st_mode):
        os.close(number)
        raise StepdiagError(f'{path}: is no regular file; give the path of a file')
    os.set_blocking(number, True)
    return os.fdopen(number, 'rb')


def real(path: str | Path) -> Path:
    """The absolute path, links followed; links in a circle stay, so that whoever opens it says what is wrong."""
    return Path(os.path.realpath(path))     # Path.resolve raises RuntimeError


def read_text(path: str | Path, most: int, what: str = 'file', encoding: str = 'utf-8') -> str:
    """The text of a file of at most ``most`` bytes; :class:`StepdiagError` names it and what is wrong."""
    with open_regular(path) as file:
        size = os.fstat(file.fileno()).st_size
        if size > most:
            raise StepdiagError(f'{path}: has {size} bytes, a {what} has at most {most}')
        try:
            data = file.read(most + 1)
        except OSError as error:
            raise StepdiagError(f'{path}: cannot be read: {error.strerror}') from None
    if len(data) > most:
        raise StepdiagError(f'{path}: has more than the {most} bytes of a {what}')
    try:
        return data.decode(encoding)
    except UnicodeDecodeError:
        raise StepdiagError(f'{path}: is not a text file; give the path of a {what}') from None
