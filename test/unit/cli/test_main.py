"""The command line: help, exit statuses, one line for bad input, lazy imports."""

import subprocess
import sys

import pytest

from stepdiag_ros.cli import main as cli
from stepdiag_ros.cli.progress import Bar


def stepdiag(*words: str) -> subprocess.CompletedProcess:
    return subprocess.run([sys.executable, '-m', 'stepdiag_ros.cli.main', *words],
                          capture_output=True, text=True, timeout=120)


def test_help_names_every_command():
    done = stepdiag('--help')
    assert done.returncode == 0
    for name, _, text in cli._available():
        assert f'\n    {name}' in done.stdout and text.split()[0] in done.stdout


@pytest.mark.parametrize('command', [entry[0] for entry in cli._available()])
def test_every_command_explains_itself(command):
    done = stepdiag(command, '--help')
    assert done.returncode == 0, done.stderr
    assert f'usage: stepdiag {command}' in done.stdout and len(done.stdout) > 200


@pytest.mark.parametrize('command', ['evaluate', 'replay', 'info'])
def test_bad_input_is_one_line_and_status_2(command):
    done = stepdiag(command, '/nowhere/bag')
    assert done.returncode == 2 and not done.stdout
    assert done.stderr.startswith('stepdiag: /nowhere/bag: does not exist')
    assert done.stderr.count('\n') == 1


def test_an_unknown_command_is_refused_with_the_choices():
    done = stepdiag('calibrat')
    assert done.returncode == 2 and 'calibrate' in done.stderr


def test_help_of_the_whole_imports_no_ros():
    code = ('import sys; from stepdiag_ros.cli.main import build_parser; build_parser("info"); '
            'sys.exit("rclpy" in sys.modules)')
    assert subprocess.run([sys.executable, '-c', code], timeout=120).returncode == 0


def test_ctrl_c_is_status_130(monkeypatch):
    def interrupted(asked):
        raise KeyboardInterrupt
    monkeypatch.setattr(cli, 'build_parser', interrupted)
    assert cli.main(['info']) == 130


class Stream:
    def __init__(self, terminal: bool):
        self.text, self._terminal = '', terminal

    def isatty(self) -> bool:
        return self._terminal

    def write(self, text: str) -> None:
        self.text += text

    def flush(self) -> None:
        pass


def test_a_bar_rewrites_one_line_on_a_terminal():
    stream = Stream(terminal=True)
    bar = Bar('calibrating', stream=stream)
    bar.show(1, 4, 'X to stop 1', 65.0)
    bar.show(4, 4)
    bar.close()
    assert stream.text.count('\n') == 1 and '1/4  1:05 left  X to stop 1' in stream.text
    assert '█' * 28 in stream.text


def test_a_bar_in_a_file_is_a_line_now_and_then():
    stream = Stream(terminal=False)
    bar = Bar('calibrating', stream=stream)
    for i in range(101):
        bar.show(i, 100)
    bar.close()
    assert stream.text.count('\n') == 2 and '100/100' in stream.text


def test_a_quiet_bar_says_nothing():
    stream = Stream(terminal=True)
    bar = Bar('calibrating', quiet=True, stream=stream)
    bar.show(1, 2)
    bar.say('up')
    bar.close()
    assert stream.text == ''
