"""Which bag a recorder is writing, so that one that is started again after its death finds it.

A hidden file in the folder of the bags names the bag, the process that writes it and that process's parent.  Where the
writer is dead and the same parent (``ros2 launch``, systemd, a shell's loop) starts another, that one goes on in the
bag; the file of a parent that has ended too, or of before the computer's start, means nothing.
"""

import json
import os
from contextlib import suppress
from pathlib import Path
from typing import Any

from stepdiag_ros.guard.jsontext import to_json


class Mark:
    """The mark of ``machine``'s recorder in ``folder``; ``asked``: the bag that its command names, if any.

    A parent that starts another recorder with another bag does not start the dead one again.
    """

    def __init__(self, folder: Path, machine: str, asked: str = ''):
        self._file = folder / f'.{machine}.recording'
        self._asked = asked

    def torn(self) -> Path | None:
        """The bag that a predecessor was writing when it died; ``None``: there is none."""
        try:
            said: Any = json.loads(self._file.read_text(encoding='utf-8'))
            bag, writer, parent = Path(said['bag']), int(said['writer']), said['parent']
        except (OSError, ValueError, KeyError, TypeError):
            return None
        same = parent == _parent() and said.get('asked') == self._asked
        return bag if same and not _lives(writer, said.get('began')) and bag.is_dir() else None

    def put(self, bag: Path) -> None:
        """This process is writing ``bag``."""
        said = {'bag': str(bag), 'asked': self._asked, 'writer': os.getpid(), 'began': _began(os.getpid()),
                'parent': _parent()}
        with suppress(OSError):     # a folder that cannot be written to: whoever dies there starts a new bag
            self._file.write_text(to_json(said), encoding='utf-8')

    def remove(self) -> None:
        """The bag is closed."""
        with suppress(OSError):
            self._file.unlink(missing_ok=True)


def _parent() -> list[int | str | None]:
    """The process that started this one; no other is called so, also after the computer was started anew."""
    return [os.getppid(), _began(os.getppid()), _boot()]


def _began(process: int) -> int | None:
    """When a process began, in ticks since the computer's start; ``None``: it has ended."""
    try:
        fields = Path(f'/proc/{process}/stat').read_text(encoding='ascii', errors='replace').rpartition(')')[2].split()
    except OSError:
        return None
    return None if fields[0] == 'Z' else int(fields[19])


def _boot() -> str:
    """The present run of the computer."""
    try:
        return Path('/proc/sys/kernel/random/boot_id').read_text(encoding='ascii').strip()
    except OSError:
        return ''


def _lives(process: int, began: int | None) -> bool:
    return began is not None and _began(process) == began
