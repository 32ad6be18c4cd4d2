"""Small files that ask for much, through the commands as a user runs them: in processes of their own, under limits."""

import os
import random
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))
import harness
import inputs

import bags
from test.some import some

ATTACKS = bags.attacks()


@pytest.fixture(scope='module', autouse=True)
def warm():
    harness.warm_up()


def refused_or_well(argv: list[str], size: int) -> harness.Outcome:
    outcome = harness.run(argv)
    assert harness.judge(outcome, size) == ''
    return outcome


@pytest.mark.parametrize('name', list(ATTACKS))
def test_an_attack_costs_one_line(tmp_path, name):
    file = tmp_path / 'given.mcap'
    file.write_bytes(ATTACKS[name]())
    for command in ('info', 'evaluate', 'recover'):
        outcome = refused_or_well(harness.arguments(command, file, tmp_path), file.stat().st_size)
        assert command != 'evaluate' or outcome.status == 2
        assert outcome.cpu_s < 20.0


@pytest.mark.parametrize('kind', ['pipe as bag', 'pipe in bag', 'pipe as metadata', 'device', 'sparse', 'endless link'])
def test_what_is_no_regular_file_is_refused_at_once(tmp_path, kind):
    bag = tmp_path / 'bag'
    bag.mkdir()
    given = bag
    if kind == 'pipe as bag':
        os.mkfifo(given := tmp_path / 'given.mcap')
    elif kind == 'pipe in bag':
        os.mkfifo(bag / 'a.mcap')
    elif kind == 'pipe as metadata':
        os.mkfifo(bag / 'metadata.yaml')
    elif kind == 'device':
        given = Path('/dev/zero')
    elif kind == 'endless link':
        (given := tmp_path / 'given.mcap').symlink_to('given.mcap')
    else:
        given = tmp_path / 'given.mcap'
        with open(given, 'wb') as file:
            file.write(bags.MAGIC + b'\x05' + (1 << 39).to_bytes(8, 'little'))
            file.truncate(1 << 40)
    for command in ('info', 'evaluate', 'recover'):
        outcome = refused_or_well(harness.arguments(command, given, tmp_path), 1 << 20)
        assert outcome.status == 2 or kind == 'sparse' and command == 'info'


@pytest.mark.parametrize('command', [c for c in harness.COMMANDS if c not in ('info', 'evaluate', 'recover')])
def test_links_in_a_circle_are_refused_by_every_command(tmp_path, command):
    (given := tmp_path / 'given.mcap').symlink_to('given.mcap')
    assert refused_or_well(harness.arguments(command, given, tmp_path), 1 << 20).status == 2


def test_an_effect_file_that_is_a_circle_of_links_is_refused(tmp_path):
    (given := tmp_path / 'own.py').symlink_to('own.py')
    cell = tmp_path / 'cell.yaml'
    cell.write_text(bags.CELL + 'effects: {own: {file: own.py}}\n', encoding='utf-8')
    outcome = refused_or_well([*harness.arguments('simulate', cell, tmp_path), '--effect', str(given)], 1 << 20)
    assert outcome.status == 2


@pytest.mark.parametrize('metadata', [
    'relative_file_paths: [../../../etc/passwd]', 'relative_file_paths: [/etc/passwd]', 'relative_file_paths: [a.mcap, a.mcap]',
    'relative_file_paths: [' + ','.join(f'f{k}.mcap' for k in range(5000)) + ']', 'a: &a [1]\n  b: *a', 'storage_identifier: [1]',
    'topics_with_message_count: {a: 1}', 'topics_with_message_count: [{topic_metadata: {name: /m/x}, message_count: 1e400}]',
    'custom_data: [1, 2]', 'compression_mode: {a: 1}', 'storage_identifier: "\\e[31m"'])
def test_metadata_of_a_stranger(tmp_path, metadata):
    bag = tmp_path / 'bag'
    bag.mkdir()
    (bag / 'metadata.yaml').write_text(f'rosbag2_bagfile_information:\n  {metadata}\n', encoding='utf-8')
    (bag / 'a.mcap').write_bytes(bags.described(bags.PLAIN))
    for command in ('info', 'evaluate', 'recover'):
        refused_or_well(harness.arguments(command, bag, tmp_path), 1 << 20)


def test_a_cell_file_runs_no_python_file(tmp_path):
    (tmp_path / 'evil.py').write_text(f'open({str(tmp_path / "done")!r}, "w")\n', encoding='utf-8')
    cell = tmp_path / 'cell.yaml'
    cell.write_text(bags.CELL + 'effects: {evil: {file: evil.py}}\n', encoding='utf-8')
    outcome = refused_or_well(harness.arguments('simulate', cell, tmp_path), 1 << 20)
    assert outcome.status == 2 and '--effect' in outcome.err and not (tmp_path / 'done').exists()


@pytest.fixture(scope='module')
def sound(tmp_path_factory):
    return dict(bags.small_bags(tmp_path_factory.mktemp('sound')))


@pytest.mark.parametrize('seed', some(*range(3), later=range(12)))
def test_a_few_turns_of_the_fuzzer(tmp_path, sound, seed):
    """The same inputs in every run; `make fuzz TIME=…` draws others for as long as one likes."""
    rng = random.Random(seed)
    for what, data in (('bag', bags.mutated(rng.choice(list(sound.values())), rng)),
                       ('log', inputs.odd_log(rng, sound['diagonals']))):
        file = tmp_path / f'{what}.mcap'
        file.write_bytes(data)
        for command in ('info', rng.choice(harness.COMMANDS)):
            refused_or_well(harness.arguments(command, file, tmp_path / what), len(data))


@pytest.mark.parametrize('file', sorted((Path(__file__).parent / 'found').iterdir()), ids=lambda file: file.name)
def test_what_the_fuzzer_found(tmp_path, file):
    """Named after what is wrong in it and after the command that stumbled over it."""
    command = file.suffixes[-2].lstrip('.')
    refused_or_well(harness.arguments(command, file, tmp_path), file.stat().st_size)


def test_a_plan_of_millions_of_stops_is_refused_before_it_is_made(tmp_path):
    cell = tmp_path / 'cell.yaml'
    demo = (Path(__file__).resolve().parents[2] / 'cells' / 'demo.yaml').read_text(encoding='utf-8')
    cell.write_text(demo.replace('repeats: 2', 'repeats: 1000').replace('steps: 4', 'steps: 200'), encoding='utf-8')
    outcome = refused_or_well(harness.arguments('simulate', cell, tmp_path), 1 << 20)
    assert outcome.status == 2 and 'samples, more than' in outcome.err and outcome.cpu_s < 10.0
