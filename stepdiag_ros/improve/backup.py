"""What a control's configuration held before it was changed, and the way back."""

import json
import shutil
from collections.abc import Iterable
from pathlib import Path

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.linuxcnc.configuration import FOLDER

BACKUPS = Path(FOLDER) / 'backup'
MANIFEST = 'manifest.json'


def _all(folder: Path) -> list[Path]:
    return sorted(path for path in (folder / BACKUPS).glob('[0-9]*') if (path / MANIFEST).is_file())


def keep(folder: Path, names: Iterable[str]) -> Path:
    """Copy the files ``names`` of a configuration folder aside, and note which were not there; the copy's folder."""
    done = _all(folder)
    target = folder / BACKUPS / f'{int(done[-1].name) + 1 if done else 1:03d}'
    there, absent = [], []
    try:
        shutil.rmtree(target, ignore_errors=True)
        for name in names:
            if (folder / name).is_file():
                (target / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(folder / name, target / name)
                there.append(name)
            else:
                absent.append(name)
        target.mkdir(parents=True, exist_ok=True)
        # The note comes last: a copy without it is not whole and does not count.
        (target / MANIFEST).write_text(json.dumps({'there': there, 'absent': absent}, indent=1) + '\n', encoding='utf-8')
    except OSError as error:
        raise StepdiagError(f'{target}: cannot be written: {error.strerror or error}') from None
    return target


def undo(folder: Path) -> list[str]:
    """Put back what the last change replaced, take away what it brought; names of the files, and the copy is gone."""
    done = _all(folder)
    if not done:
        raise StepdiagError(f'{folder}: holds no backup of an earlier state; nothing to undo')
    last = done[-1]
    try:
        noted = json.loads((last / MANIFEST).read_text(encoding='utf-8'))
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
    return [*noted['there'], *noted['absent']]
