"""Every uncertainty says how much of the distribution it covers: k, or a share, in the same line or in the heading."""

import html
import json
import re

import pytest

from stepdiag_ros.cli.main import main
from stepdiag_ros.estimate.methods import METHODS
from test.some import some

from .test_compensate_verify import bag_of, cell_of

SPREAD = re.compile(r'±|\bU\b(?! ?\(k)')
COVERAGE = re.compile(r'k ?= ?2|95 %|68 %|1σ|standard uncertaint|\bk\b')
LACKING = ('face', 'three_face', 'linear_lines', 'multilateration', 'regulated_beam', 'body_displacement')
"""Beginnings of the names of methods that want other setups than those of the demo."""
TEXTS = some(['evaluate'], *(['evaluate', '--method', name] for name in METHODS
                             if name != 'enhanced' and not name.startswith(LACKING)),
             ['uncertainty', '--at', '0.1,0.08,0.06'], ['gap'], ['map', '--out', 'map.png'],
             later=[['compare'], *(['evaluate', '--method', name] for name in METHODS if name.startswith(LACKING))])


@pytest.fixture(scope='module')
def bag(tmp_path_factory):
    return bag_of(cell_of(), tmp_path_factory.mktemp('k') / 'bag')


def lines_without(text):
    """Lines with an uncertainty of which neither they nor any line above them has said the coverage."""
    said, silent = False, []
    for line in text.splitlines():
        said |= bool(COVERAGE.search(line))
        if SPREAD.search(line) and not said:
            silent.append(line)
    return silent


@pytest.mark.parametrize('command', TEXTS, ids=' '.join)
def test_what_is_printed(bag, command, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    if main([command[0], bag, *command[1:]]) == 2:
        assert 'needs' in capsys.readouterr().err    # a method that the log has not the setups for
        return
    out = capsys.readouterr().out
    assert out and lines_without(out) == []


@pytest.mark.long
def test_pages_and_tables(bag, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(['report', bag, '--out', 'report']) == 0
    assert main(['compensate', bag, '--format', 'linuxcnc', '--out', 'tables']) == 0
    assert main(['verify', bag, bag, '--tolerance', '30um', '--out', 'verify']) in (0, 4)
    assert lines_without(capsys.readouterr().out) == []
    for page in (*tmp_path.rglob('*.html'), tmp_path / 'tables' / 'README.txt'):
        tags = re.compile(r'<(script|style).*?</\1>|<[^>]*>', re.DOTALL)
        plain = html.unescape(tags.sub('\n', page.read_text(encoding='utf-8')))
        assert SPREAD.search(plain) and COVERAGE.search(plain), page
    for answer in (tmp_path / 'tables' / 'prediction.json', tmp_path / 'verify' / 'verify.json'):
        told = json.loads(answer.read_text(encoding='utf-8'))
        assert told.get('k') == 2.0 or 'k = 2' in told['rule']
