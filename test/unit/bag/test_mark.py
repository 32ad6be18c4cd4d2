"""A recorder that is started again by the same process finds the bag that it tore; no other does."""

import subprocess
import sys
from pathlib import Path

WRITE = """
import os, sys
from pathlib import Path
from stepdiag_ros.bag.mark import Mark
mark = Mark(Path(sys.argv[1]), 'mill')
print(mark.torn())
mark.put(Path(sys.argv[1]) / 'log')
if sys.argv[2] == 'closes':
    mark.remove()
sys.stdout.flush()
os._exit(9)
"""
#: Starts a recorder twice, as `ros2 launch` does.
PARENT = """
import subprocess, sys
for _ in range(2):
    subprocess.run([sys.executable, '-c', *sys.argv[1:]])
"""


def started(folder: Path, end: str, by_itself: bool = False) -> list[str]:
    """What one recorder, or two of one parent after each other, found."""
    command = [sys.executable, '-c', *(() if by_itself else (PARENT,)), WRITE, str(folder), end]
    return subprocess.run(command, capture_output=True, text=True).stdout.split()


def test_it_is_found_by_the_next_of_the_same_parent_alone(tmp_path):
    (tmp_path / 'log').mkdir()
    assert started(tmp_path, 'dies') == ['None', str(tmp_path / 'log')]
    assert started(tmp_path, 'dies')[0] == 'None'       # another session, whatever lies there
    assert started(tmp_path, 'closes', by_itself=True) == ['None']
    assert started(tmp_path, 'closes') == ['None', 'None']


def test_one_that_is_to_write_another_bag_is_not_the_one_that_died(tmp_path):
    (tmp_path / 'log').mkdir()
    write = "Path(sys.argv[1]), 'mill', {})"
    first, other = (WRITE.replace("Path(sys.argv[1]), 'mill')", write.format(f'str(Path(sys.argv[1]) / "{name}")'), 1)
                    for name in ('log', 'second'))
    parent = "import subprocess, sys\nfor code in sys.argv[1:3]:\n" \
             "    subprocess.run([sys.executable, '-c', code, *sys.argv[3:]])\n"
    for codes, found in ((first, other), 'None'), ((first, first), str(tmp_path / 'log')):
        said = subprocess.run([sys.executable, '-c', parent, *codes, str(tmp_path), 'dies'],
                              capture_output=True, text=True).stdout.split()
        assert said == ['None', found]


def test_a_writer_that_lives_keeps_its_bag(tmp_path):
    from stepdiag_ros.bag.mark import Mark
    (tmp_path / 'log').mkdir()
    Mark(tmp_path, 'mill').put(tmp_path / 'log')
    assert Mark(tmp_path, 'mill').torn() is None
    assert Mark(tmp_path, 'other').torn() is None


def test_what_is_no_mark_is_passed_over(tmp_path):
    from stepdiag_ros.bag.mark import Mark
    for content in ('', '{', '[]', '{"bag": 1}', '{"bag": "x", "writer": "y", "parent": 0}'):
        (tmp_path / '.mill.recording').write_text(content, encoding='utf-8')
        assert Mark(tmp_path, 'mill').torn() is None
