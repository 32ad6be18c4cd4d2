"""The folder that tables lie in: written with the way back and the prediction, and read again to verify."""

import hashlib
from pathlib import Path

from stepdiag_ros.compensate.compensation import BEFORE, Compensation
from stepdiag_ros.compensate.control import Place
from stepdiag_ros.compensate.controls import CONTROLS
from stepdiag_ros.compensate.document import NAME as PREDICTION
from stepdiag_ros.compensate.document import Predicted, document
from stepdiag_ros.compensate.taken import Taken
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.guard import limits
from stepdiag_ros.guard.files import read_text
from stepdiag_ros.guard.jsontext import to_json
from stepdiag_ros.model.description import Machine

PICTURE, README = 'prediction.png', 'README.txt'


def write_tables(found: Compensation, log: str, out: Path) -> None:
    """Write what was ``found`` from the ``log`` into the folder ``out``."""
    from stepdiag_ros.report.compensation_figure import draw_compensation
    from stepdiag_ros.report.compensation_words import readme

    files = {**found.files, **found.before_files, README: readme(found, log),
             PREDICTION: to_json(document(found, log)) + '\n'}
    try:
        for file, text in files.items():
            (out / file).parent.mkdir(parents=True, exist_ok=True)
            (out / file).write_text(text, encoding='utf-8', errors='surrogateescape')
        draw_compensation(found, out / PICTURE)
    except OSError as error:
        raise StepdiagError(f'{out}: cannot be written: {error.strerror or error}') from None


def in_force(prediction: Path, predicted: Predicted, machine: Machine) -> tuple[Taken, Taken]:
    """What a control that computes the whole model took off before and takes off now, by the files beside a prediction.

    Both empty for a control of tables by single axes: under such a machine is one of 21 errors again.
    """
    control = CONTROLS.get(predicted.control)
    if control is None:
        raise StepdiagError(f'{prediction}: is of {predicted.control!r}, a format that is not known')
    if not control.whole_model:
        return {}, {}
    folder, place = prediction.parent, Place(machine, predicted.origin)
    before = {path.name: _text(path) for path in sorted((folder / BEFORE).glob('*')) if path.is_file()}
    now = {}
    for name, expected in predicted.files.items():
        now[name] = _text(folder / name)
        if hashlib.sha256(now[name].encode()).hexdigest() != expected:
            raise StepdiagError(f'{folder / name}: is not the file that {prediction.name} was made with; give the '
                                'folder as `stepdiag compensate` wrote it')
    return control.read(before, place), control.read(now, place)


def _text(path: Path) -> str:
    return read_text(path, limits.TEXT_BYTES, 'table beside the prediction')
