"""The interface for programs and notebooks: its names, their documentation, and the page that shows them."""

import inspect
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

import stepdiag_ros
from stepdiag_ros import api

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / 'docs' / 'tutorials' / 'in_python.md'


def test_the_names_are_those_of_the_api_and_of_the_page():
    assert stepdiag_ros.__all__ == api.__all__ == sorted(api.__all__, key=lambda name: (name[0].islower(), name))
    table = PAGE.read_text(encoding='utf-8').split('| name |')[1]
    assert sorted(re.findall(r'`(\w+)`', ''.join(line.split('|')[1] for line in table.splitlines()[2:]))) == \
        sorted(api.__all__)
    with pytest.raises(AttributeError):
        stepdiag_ros.something_else  # noqa: B018


@pytest.mark.parametrize('name', api.__all__)
def test_every_name_is_documented_and_its_functions_are_typed(name):
    thing = getattr(stepdiag_ros, name)
    assert inspect.getdoc(thing)
    if inspect.isfunction(thing):
        signature = inspect.signature(thing)
        assert signature.return_annotation is not inspect.Signature.empty
        assert all(p.annotation is not inspect.Parameter.empty for p in signature.parameters.values())


def test_the_package_is_imported_without_what_it_does_not_need_yet():
    code = 'import sys, stepdiag_ros; sys.exit(any(m in sys.modules for m in ("numpy", "rclpy", "matplotlib")))'
    assert subprocess.run([sys.executable, '-c', code]).returncode == 0
    code = ('import sys; from stepdiag_ros import read_log; '
            'sys.exit(any(m in sys.modules for m in ("rclpy", "matplotlib")))')
    assert subprocess.run([sys.executable, '-c', code]).returncode == 0


def test_the_blocks_of_the_page_run_one_after_the_other(tmp_path, monkeypatch, capsys):
    blocks = re.findall(r'```python\n(.*?)```', PAGE.read_text(encoding='utf-8'), re.DOTALL)
    assert len(blocks) == 7
    (tmp_path / 'cells').symlink_to(ROOT / 'cells')
    monkeypatch.chdir(tmp_path)
    space: dict = {}
    for block in blocks:
        exec(compile(block, str(PAGE), 'exec'), space)
    said = capsys.readouterr().out
    assert 'EXX at 0.200 m' in said and 'no_such_bag: does not exist' in said
    assert space['solution'].dof > 100 and space['found'].deviation_m.shape == (2, 3)
    assert space['diagnosis'].verdict in ('no_gap', 'explained', 'partly_explained', 'unexplained')


def test_a_log_with_a_mistake_of_commissioning_is_not_diagnosed():
    log = api.simulate(ROOT / 'cells' / 'demo.yaml', setups=['ppp', 'npp'], rate_hz=100.0)
    halved = replace(log, displacement=replace(log.displacement, values=log.displacement.values / 2.0))
    with pytest.raises(api.StepdiagError, match='not sane; nothing is diagnosed before this is put right: .*half'):
        api.diagnose(halved)
