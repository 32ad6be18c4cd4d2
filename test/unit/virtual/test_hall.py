"""The hall file: what it names, and the cell files that follow from it."""

from pathlib import Path

import pytest

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.virtual.acting import ALLOWED, create_effects
from stepdiag_ros.virtual.cell import load_cell
from stepdiag_ros.virtual.hall import load_hall, write_cells
from stepdiag_ros.virtual.linuxcnc_server import config_folder

CELLS = Path(__file__).resolve().parents[3] / 'cells'


def hall(folder: Path, text: str) -> Path:
    path = folder / 'hall.yaml'
    path.write_text(text.replace('CELLS', str(CELLS)), encoding='utf-8')
    return path


def test_the_shipped_hall_has_four_machines_of_their_own():
    found = load_hall(CELLS / 'hall.yaml')
    assert [machine.name for machine in found.machines] == ['mill_1', 'mill_2', 'mill_3', 'lathe']
    assert found.lease_s == 5.0


def test_each_machine_is_its_cell_under_another_name_and_seed(tmp_path):
    found = load_hall(CELLS / 'hall.yaml')
    source, files = write_cells(found, tmp_path)
    original, first, second = load_cell(CELLS / 'demo.yaml'), load_cell(files['mill_1']), load_cell(files['mill_2'])
    assert first.description.machine.name == 'mill_1' and first.seed == 101
    assert first.description.setups == original.description.setups and first.motion == original.motion
    assert str(first.geometry) != str(second.geometry)        # drawn by the seed: machines differ
    shared = load_cell(source)
    assert shared.instruments.multiplexer == tuple(files)
    assert str(shared.geometry) == str(first.geometry) and shared.seed == first.seed
    assert str(load_cell(shared.instruments.machine_files[0]).geometry) == str(second.geometry)


def test_what_a_cell_names_relative_to_its_file_is_found_in_the_hall(tmp_path, monkeypatch):
    """An effect of one's own beside the cell file, the folder of a LinuxCNC; and a cell without instruments."""
    (tmp_path / 'own.py').write_text(
        'from stepdiag_ros.effects.base import Effect\n\n\nclass Own(Effect):\n    name = \'own\'\n')
    own = (CELLS / 'demo.yaml').read_text(encoding='utf-8').replace('cnc: {', 'cnc: {config: linuxcnc, ')
    own = own.replace('effects: {}', 'effects: {own: {file: own.py}}')
    (tmp_path / 'own.yaml').write_text(own, encoding='utf-8')
    own = own.replace('effects: {own: {file: own.py}}', 'effects:')
    (tmp_path / 'bare.yaml').write_text(own[:own.index('instruments:')] + 'instruments:\n', encoding='utf-8')
    found = load_hall(hall(tmp_path, 'machines:\n  - {cell: bare.yaml, name: a}\n  - {cell: own.yaml, name: b}\n'))
    source, files = write_cells(found, tmp_path / 'run')
    monkeypatch.setenv(ALLOWED, str(tmp_path / 'own.py'))
    assert [effect.name for effect in create_effects(load_cell(files['b']))] == ['own']
    assert config_folder(load_cell(files['b'])) == tmp_path / 'linuxcnc'
    assert load_cell(source).instruments.multiplexer == ('a', 'b')


@pytest.mark.parametrize(('text', 'complaint'), [
    ('machines: []', "1: the key 'machines' is missing or empty"),
    ('machines:\n  - {name: a}', "2: machines.0: the key 'cell' is missing"),
    ('machines:\n  - {cell: CELLS/demo.yaml, nam: a}', '2: machines.0.nam: is not a known key; known here are cell'),
    ('machines:\n  - {cell: CELLS/nowhere.yaml}', '2: machines.0.cell: cannot be used: .*nowhere.yaml: cannot be read'),
    ('machines:\n  - {cell: CELLS/demo.yaml}\n  - {cell: CELLS/demo.yaml}',
     "3: machines.1: is called 'demo' as another"),
    ('name: demo\nmachines:\n  - {cell: CELLS/demo.yaml}', "3: machines.0: is called 'demo' as another"),
    ('machines:\n  - {cell: CELLS/multiplex.yaml}', '2: machines.0.cell: has a multiplexer itself'),
    ('machines:\n  - {cell: CELLS/demo.yaml, name: a/b}', "2: machines.0.name: is called 'a/b'"),
    ('machines:\n  - {cell: CELLS/demo.yaml, priority: 300}', "2: machines.0.priority: is '300'"),
    ('lease: 0.1\nmachines:\n  - {cell: CELLS/demo.yaml}', "1: lease: is '0.1'"),
    ('machines: &a\n  - {cell: CELLS/demo.yaml}', '1: has an anchor'),
])
def test_a_bad_hall_file_is_one_line_with_place_and_remedy(tmp_path, text, complaint):
    with pytest.raises(StepdiagError, match=f'hall.yaml:{complaint}'):
        load_hall(hall(tmp_path, text))
