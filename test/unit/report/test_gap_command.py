"""``stepdiag gap``, ``report`` and ``compensate`` as commands: many bags, bad ones among them, adoption."""

import json
import re

import pytest
import yaml

from stepdiag_ros.bag.export import write_log
from stepdiag_ros.bag.reader import read_log
from stepdiag_ros.cli.gap import _names
from stepdiag_ros.cli.main import main
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.estimate.reduce import reduce_log
from stepdiag_ros.twin.against import without_known
from stepdiag_ros.virtual.cell import load_cell
from stepdiag_ros.virtual.offline import START_NS, simulate_log

from ..conftest import DEMO, small_cell

pytestmark = pytest.mark.usefixtures('diagnosed_once')

BACKLASH = {'backlash': {'B': [4e-6, 3e-6, 5e-6]}}


@pytest.fixture(scope='module')
def folder(tmp_path_factory):
    """A bag with backlash, and the cell file that it came from, without and with the effect."""
    place = tmp_path_factory.mktemp('gap')
    write_log(simulate_log(small_cell(BACKLASH)), place / 'played')
    text = yaml.safe_load(DEMO.read_text(encoding='utf-8'))
    text['motion'] |= {'dwell': 0.1, 'mount': 20.0}
    text['sampling'] |= {'interferometer': 200.0, 'psd': 200.0, 'in_motion': False}
    (place / 'nominal.yaml').write_text(yaml.safe_dump(text, sort_keys=False), encoding='utf-8')
    (place / 'knowing.yaml').write_text(yaml.safe_dump(text | {'effects': BACKLASH}, sort_keys=False), encoding='utf-8')
    text['machine']['volume'] = [0.3, 0.16, 0.12]
    text['setups'].pop('lin_x')
    (place / 'other.yaml').write_text(yaml.safe_dump(text, sort_keys=False), encoding='utf-8')
    return place


@pytest.fixture(scope='module')
def ran(folder):
    """One run over two bags, of which one is not there."""
    import contextlib
    import io
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = main(['gap', str(folder / 'missing'), str(folder / 'played'), '--out', str(folder / 'gap'), '--json'])
    return code, out.getvalue(), err.getvalue()


def test_bad_bag_costs_a_line_and_the_others_are_done(ran, folder):
    code, out, err = ran
    assert code == 2
    assert err.strip().splitlines() == [line for line in err.strip().splitlines() if line.startswith('stepdiag: ')]
    assert 'missing' in err
    documents = json.loads(out)
    assert list(documents) == ['played']
    assert documents['played'] == json.loads((folder / 'gap/played/gap.json').read_text(encoding='utf-8'))
    assert documents['played']['effects'][0]['name'] == 'backlash'
    assert (folder / 'gap/played/index.html').read_text(encoding='utf-8').startswith('<!DOCTYPE html>')


def test_adopted_cell_is_written_and_loads(folder, capsys):
    new = folder / 'adopted.yaml'
    assert main(['gap', str(folder / 'played'), '--cell', str(folder / 'nominal.yaml'), '--adopt', str(new),
                 '--out', str(folder / 'adopt')]) == 0
    out, err = capsys.readouterr()
    assert f'cell written to {new}' in out and err == ''
    page = (folder / 'adopt/played/index.html').read_text(encoding='utf-8')
    assert 'was run along the moves of this log' in page
    ids = re.findall(r' id="([^"]+)"', page)
    assert len(ids) == len(set(ids))
    cell = load_cell(new)
    assert cell.effects['backlash']['B'] == pytest.approx([4e-6, 3e-6, 5e-6], abs=8e-7)
    assert cell.seed == load_cell(folder / 'nominal.yaml').seed


def test_known_effects_are_taken_off(folder):
    log = read_log(folder / 'played')
    less, notes = without_known(log, folder / 'knowing.yaml')
    bare = reduce_log(simulate_log(small_cell({})))
    with_it = abs(reduce_log(log).displacement - bare.displacement).max()
    without = abs(reduce_log(less).displacement - bare.displacement).max()
    assert with_it > 3e-6 and without < 1e-8
    assert 'backlash' in notes[1]


@pytest.fixture(scope='module')
def once_more(folder):
    """Two hours later one of the diagonals again, in a bag of its own."""
    write_log(simulate_log(small_cell(BACKLASH), START_NS + 7_200_000_000_000, ('ppp',)), folder / 'once_more')


@pytest.mark.usefixtures('once_more')
def test_a_log_of_one_setup_out_of_seven_has_a_page(folder, capsys):
    assert main(['gap', str(folder / 'once_more'), '--out', str(folder / 'part')]) == 0
    assert 'setup npp is described but has no run' in capsys.readouterr().out
    assert 'diagonal to +X to +Y to +Z' in (folder / 'part/once_more/index.html').read_text(encoding='utf-8')


@pytest.mark.usefixtures('once_more')
def test_a_further_run_joins_its_log(folder, capsys):
    out = folder / 'further'
    assert main(['gap', str(folder / 'played'), '--further', str(folder / 'once_more'), '--out', str(out),
                 '--cell', str(folder / 'nominal.yaml')]) == 0
    document = json.loads((out / 'played/gap.json').read_text(encoding='utf-8'))
    assert document['effects'][0]['name'] == 'backlash'
    assert 'ppp.2' in {share.get('setup') for share in document['where']}
    capsys.readouterr()
    assert main(['gap', str(folder / 'once_more'), '--further', str(folder / 'played'), '--out', str(out)]) == 2
    err = capsys.readouterr().err
    assert 'earlier log first' in err and len(err.strip().splitlines()) == 1


def test_another_machines_cell_is_refused(folder):
    with pytest.raises(StepdiagError, match='lin_x|volume'):
        without_known(read_log(folder / 'played'), folder / 'other.yaml')


@pytest.mark.parametrize(('extra', 'said'), [
    (['--jobs', '0'], '--jobs'), (['--adopt', 'x.yaml', '--', 'again'], '--adopt'),
    (['--further', 'x', '--', 'again'], '--further'),
    (['--effect', 'nowhere.py'], 'nowhere.py'), (['--cell', 'nowhere.yaml'], 'nowhere.yaml')])
def test_bad_arguments_are_told_in_a_line(folder, capsys, extra, said):
    bags = [str(folder / 'played'), *extra[3:]]
    assert main(['gap', *bags, '--out', str(folder / 'never'), *extra[:2]]) == 2
    err = capsys.readouterr().err
    assert said in err and len(err.strip().splitlines()) == 1
    assert not (folder / 'never').exists()


def test_names_are_told_apart():
    assert _names(['a/x', 'b/x', 'c/x.mcap', 'y']) == ['x', 'x_2', 'x_3', 'y']


def test_report_and_compensate(folder, capsys):
    assert main(['report', str(folder / 'played'), '--out', str(folder / 'report')]) == 0
    assert (folder / 'report/errors.png').stat().st_size > 10_000
    assert 'EXX' in json.loads((folder / 'report/evaluation.json').read_text(encoding='utf-8'))['errors']
    capsys.readouterr()
    assert main(['compensate', str(folder / 'played'), '--format', 'linuxcnc', '--out', str(folder / 'tables'),
                 '--origin', '0,0,0']) == 0
    out = capsys.readouterr().out
    assert str(folder / 'tables/x.comp') in out
    # Backlash is in this log: it goes into the trims, and whoever would load these tables is told.
    assert 'reversal' in out and 'the log shows backlash' in out
