"""Seal, answer, open: a tiny set from end to end, and every lock on the way."""

import hashlib
import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from stepdiag_ros.bag.reader import read_log
from stepdiag_ros.blind.answer import answer
from stepdiag_ros.blind.judge import judge_floors
from stepdiag_ros.blind.live import draw_text
from stepdiag_ros.blind.opened import into_page, load, open_set
from stepdiag_ros.blind.seal import LOGS, MANIFEST, SEALED, orders, seal
from stepdiag_ros.blind.settle import settle
from stepdiag_ros.blind.vocabulary import NAMES
from stepdiag_ros.blind.world import Order, make
from stepdiag_ros.cli.main import main
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.virtual.cell import parse_cell

COUNTS = {'null': 1, 'single': 1, 'outside': 1}


@pytest.fixture(scope='module')
def answered(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp('blind') / 'set'
    seal(folder, orders('develop', 31, COUNTS, 'field', small=True), progress=False)
    answer(folder, progress=False)
    return folder


@pytest.fixture
def copy(answered: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(answered, tmp_path / 'set'))


def test_hash_of_the_truth_is_published(answered: Path) -> None:
    manifest = json.loads((answered / MANIFEST).read_text())
    assert manifest['logs'] == 3
    assert manifest['truth_sha256'] == hashlib.sha256((answered / SEALED).read_bytes()).hexdigest()


def test_logs_hold_no_trace_of_the_truth(answered: Path) -> None:
    truth = json.loads((answered / SEALED).read_text())
    words = [name.encode() for name in NAMES]
    for path in sorted((answered / LOGS).iterdir()):
        log = read_log(path)
        assert log.description.machine.name == 'cell1'
        assert log.namespace == '/cell1'
        body = b''.join(file.read_bytes() for file in path.iterdir())
        assert not any(word in body for word in words)
        assert str(truth['seed']).encode() not in (path / 'metadata.yaml').read_bytes().split()
    # Where a log stands in the order says nothing either.
    assert len({entry['category'] for entry in truth['logs'].values()}) == 3


def test_scores(answered: Path) -> None:
    result = open_set(answered)
    figures = result['figures']
    assert figures['false_alarms']['count'] == 1
    assert figures['seconds']['value'] > 0.0
    assert json.loads((answered / 'score.json').read_text())['logs'] == 3
    assert '| false alarms on null logs | 0 of 300 |' in (answered / 'score.md').read_text()
    assert (answered / 'score.png').stat().st_size > 10_000


def test_results_go_into_a_page(answered: Path, tmp_path: Path) -> None:
    page = tmp_path / 'page.md'
    page.write_text('# Page\n\n<!-- results -->\nold\n')
    into_page(open_set(answered), answered, page)
    text = page.read_text()
    assert text.startswith('# Page')
    assert 'old' not in text
    assert '3 logs (1 null, 1 single, 0 pair, 1 outside), purpose `develop`, seed 31' in text
    assert (tmp_path / 'images' / 'blind.png').exists()
    page.write_text('# No mark')
    with pytest.raises(StepdiagError, match='has no line'):
        into_page(open_set(answered), answered, page)


def test_changed_truth_is_found_out(copy: Path) -> None:
    text = (copy / SEALED).read_text()
    (copy / SEALED).write_text(text.replace('"null"', '"single"', 1))
    with pytest.raises(StepdiagError, match='truth was changed after sealing'):
        load(copy)


def test_changed_answer_is_found_out(copy: Path) -> None:
    gap = copy / 'answers' / 'log_02' / 'gap.json'
    gap.write_text(gap.read_text().replace('"verdict"', '"verdikt"'))
    with pytest.raises(StepdiagError, match=r'log_02/gap\.json.*changed after answering'):
        load(copy)


def test_second_answer_is_refused(copy: Path) -> None:
    with pytest.raises(StepdiagError, match='answered already'):
        answer(copy, progress=False)


def test_cut_answering_is_resumed_without_the_truth_and_keeps_what_is_there(copy: Path) -> None:
    shutil.move(copy / 'sealed', copy.parent / 'sealed')
    (copy / 'answers.json').unlink()
    kept = (copy / 'answers' / 'log_01' / 'extra.json').read_bytes()
    (copy / 'answers' / 'log_03' / 'gap.json').unlink()
    answer(copy, processes=1, progress=False)
    assert (copy / 'answers' / 'log_01' / 'extra.json').read_bytes() == kept
    with pytest.raises(StepdiagError, match=r'truth\.json: is not there'):
        load(copy)
    shutil.move(copy.parent / 'sealed', copy / 'sealed')
    cases, _ = load(copy)
    assert len(cases) == 3


def test_unfinished_set_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(['blind', 'answer', str(tmp_path)]) == 2
    assert 'manifest.json' in capsys.readouterr().err


def test_sealing_twice_is_refused(copy: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(['blind', 'seal', '--seed', '1', '--null', '1', '--out', str(copy)]) == 2
    assert 'sealed already' in capsys.readouterr().err


def test_purposes_never_share_a_log() -> None:
    develop, sealed = (orders(purpose, 1, {'single': 19}) for purpose in ('develop', 'sealed'))
    assert [o.kinds for o in develop] != [o.kinds for o in sealed]
    assert {o.kinds[0] for o in develop} == set(NAMES)
    with pytest.raises(StepdiagError, match='--purpose'):
        orders('both', 1, COUNTS)


@pytest.mark.long
def test_open_asks_the_sealed_worlds(copy: Path, monkeypatch: pytest.MonkeyPatch,
                                     capsys: pytest.CaptureFixture[str]) -> None:
    """What noise alone leaves of each log with effects of the vocabulary; how far what competes with one effect is."""
    monkeypatch.setattr('stepdiag_ros.blind.judge.COUNTS_FROM', 0.0)
    assert main(['blind', 'open', str(copy), '--floor', '--apart', '--settle', '--processes', '1', '--quiet']) == 0
    assert 'gap closed on held-out data' in capsys.readouterr().out
    logs = json.loads((copy / SEALED).read_text())['logs']
    judged = json.loads((copy / 'worlds.json').read_text())
    one = {category: {name for name, entry in logs.items() if entry['category'] == category}
           for category in ('single', 'outside')}
    assert set(judged) == one['single'] | one['outside']
    assert all(entry['least_apart'] >= 0.0 and entry['rival'] in NAMES for entry in judged.values())
    assert all((judged[name].get('noise_chi2', 0.0) > 0.0) == (name in one['single']) for name in judged)
    assert (copy / 'settled.json').exists()
    # What is judged already is kept.
    (copy / 'worlds.json').write_text(json.dumps({name: {'noise_chi2': 7.0} for name in one['single']}))
    judge_floors(copy, processes=1, progress=False)
    assert all(entry == {'noise_chi2': 7.0} for entry in json.loads((copy / 'worlds.json').read_text()).values())


def test_a_cut_run_of_further_runs_is_not_scored(copy: Path) -> None:
    (copy / 'settled.json').write_text(json.dumps({'of': 2, 'logs': []}))
    assert 'settled' not in open_set(copy)['figures']
    (copy / 'settled.json').write_text(json.dumps({'of': 0, 'logs': []}))
    assert 'settled' in open_set(copy)['figures']


def test_further_runs_of_the_same_answers_are_not_done_again(copy: Path) -> None:
    settle(copy, processes=1)
    first = json.loads((copy / 'settled.json').read_text())
    assert len(first['logs']) == first['of']
    kept = {**first, 'logs': [{**row, 'settled': 'kept'} for row in first['logs']]}
    (copy / 'settled.json').write_text(json.dumps(kept))
    assert settle(copy, processes=1) == kept['logs']


def test_untidy_noise_is_drawn_besides_all_else() -> None:
    """The same machine with and without; the share is kept."""
    tidy, untidy = (make(Order('develop', 9, 4, 'null', (), 'varied', True, share)) for share in (0.0, 1.0))
    assert tidy.truth['noise_law'] is None and untidy.truth['noise_law'] is not None
    assert tidy.truth['errors'] == untidy.truth['errors'] and tidy.truth['noise'] == untidy.truth['noise']
    np.testing.assert_array_equal(tidy.log.steps.time_ns, untidy.log.steps.time_ns)


@pytest.mark.long
def test_what_readings_in_steps_round_off_is_no_visibility() -> None:
    """The same effect, of the same size and as well seen, under tidy noise and untidy."""
    tidy, untidy = (make(Order('develop', 9, 4, 'single', ('scale_thermal_expansion',), 'varied', True, share))
                    for share in (0.0, 1.0))
    assert any(law['quantum'] for law in untidy.truth['noise_law'].values() if 'quantum' in law)
    assert tidy.truth['effects'] == untidy.truth['effects'] and tidy.truth['shares'] == untidy.truth['shares']


def test_live_logs_come_last_and_every_second_is_loaded() -> None:
    todo = orders('develop', 9, {'null': 2, 'live': 4}, untidy=0.5)
    assert [order.live for order in todo] == [False] * 2 + [True] * 4
    assert [order.loaded for order in todo[2:]] == [False, True, False, True]
    assert [order.number for order in todo] == [1, 2, 3, 4, 5, 6]
    texts = {draw_text(order) for order in todo[2:]}
    assert len(texts) == 4
    for text in texts:
        assert parse_cell(text).effects == {}
