"""What a control's configuration held before it was changed, and the way back."""

import hashlib
import json
import shutil
from collections.abc import Mapping
from pathlib import Path

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.guard.jsontext import to_json
from stepdiag_ros.linuxcnc.configuration import FOLDER

BACKUPS = Path(FOLDER) / 'backup'
MANIFEST = 'manifest.json'


def _all(folder: Path) -> list[Path]:
    return sorted(path for path in (folder / BACKUPS).glob('[0-9]*') if (path / MANIFEST).is_file())


def keep(folder: Path, written: Mapping[str, str | None]) -> Path:
    """Copy the files of a configuration folder that ``written`` replaces aside; the copy's folder.

    Noted is which were not there, and what is written, so that :func:`undo` knows what was changed since.
    """
    done = _all(folder)
    target = folder / BACKUPS / f'{int(done[-1].name) + 1 if done else 1:03d}'
    there, absent = [], []
    try:
        shutil.rmtree(target, ignore_errors=True)
        for name in written:
            if (folder / name).is_file():
                (target / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(folder / name, target / name)
                there.append(name)
            else:
                absent.append(name)
        target.mkdir(parents=True, exist_ok=True)
        # The note comes last: a copy without it is not whole and does not count.
        (target / MANIFEST).write_text(to_json({'there': there, 'absent': absent, 'written': {
            name: None if text is None else _sum(text.encode('utf-8', 'surrogateescape'))
            for name, text in written.items()}}) + '\n', encoding='utf-8')
    except OSError as error:
        raise StepdiagError(f'{target}: cannot be written: {error.strerror or error}') from None
    return target


def undo(folder: Path) -> tuple[list[str], list[str]]:
    """Put back what the last change replaced and take away what it brought; the copy is then gone.

    Returns the names of these files, and under which names those are kept that somebody has edited since.
    """
    done = _all(folder)
    if not done:
        raise StepdiagError(f'{folder}: holds no backup of an earlier state; nothing to undo')
    last = done[-1]
    try:
        noted = json.loads((last / MANIFEST).read_text(encoding='utf-8'))
        aside = [_aside(folder, name) for name, written in noted.get('written', {}).items()
                 if _edited(folder / name, written)]
        for name in noted['there']:
            part = (folder / name).with_name(Path(name).name + '.new')
            part.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(last / name, part)
            part.replace(folder / name)
        for name in noted['absent']:
            (folder / name).unlink(missing_ok=True)
        shutil.rmtree(last)
    except (OSError, ValueError, KeyError) as error:
        raise StepdiagError(f'{last}: cannot be put back: {error}') from None
    return [*noted['there'], *noted['absent']], aside


def _sum(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def _edited(path: Path, written: str | None) -> bool:
    """Whether a file is there that is not what was written."""
    return path.is_file() and _sum(path.read_bytes()) != written


def _aside(folder: Path, name: str) -> str:
    """Copy a file beside itself under a name that LinuxCNC takes for none of its own, and that is free."""
    number = next(n for n in range(1, 1000) if not (folder / f'{name}.edited{n}').exists())
    shutil.copy2(folder / name, folder / f'{name}.edited{number}')
    return f'{name}.edited{number}'
