"""What is installed and from where: the lock file, the manifest's keys, what the middleware can."""

import importlib.util
import re
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest

ROOT = Path(__file__).resolve().parents[2]
#: Keys of rosdep's index that are no ROS packages, as far as the manifests need them.
ROSDEP = {'python3-hypothesis', 'python3-matplotlib', 'python3-numpy', 'python3-pymodbus', 'python3-pytest',
          'python3-pytest-timeout', 'python3-pytest-xdist', 'python3-scipy', 'python3-yaml'}
#: What the package imports and rosdep has no key for; docs/how-to/workspace.md names it.
BY_PIP = {'mcap', 'zstandard', 'lz4', 'starlette', 'uvicorn', 'wsproto'}
#: Import name -> key where they differ.
KEYS = {'yaml': 'python3-yaml', 'mpl_toolkits': 'python3-matplotlib'}


def supply():
    spec = importlib.util.spec_from_file_location('supply', ROOT / 'tools' / 'supply.py')
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_every_pinned_package_has_a_hash_and_no_other_is_locked():
    text = (ROOT / 'requirements' / 'locked.txt').read_text()   # make lock writes it
    entries = re.findall(r'^(\S+==\S+)((?: \\\n    --hash=sha256:[0-9a-f]{64})+)$', text, re.MULTILINE)
    assert [name for name, _ in entries] == supply().pins()


def test_every_import_is_a_key_of_the_manifest():
    root = ElementTree.parse(ROOT / 'package.xml').getroot()
    keys = {child.text for child in root if child.tag.endswith('depend')}
    assert {key for key in keys if key.startswith('python3-')} <= ROSDEP
    imported = set()
    for file in (ROOT / 'stepdiag_ros').rglob('*.py'):
        imported |= set(re.findall(r'^\s*(?:from|import) (\w+)', file.read_text(encoding='utf-8'), re.MULTILINE))
    words = {name for name in imported if importlib.util.find_spec(name) is not None}   # not prose in a docstring
    foreign = words - set(sys.stdlib_module_names) - {'stepdiag_ros'} - BY_PIP
    missing = {name for name in foreign if KEYS.get(name, name) not in keys and f'python3-{name}' not in keys}
    assert not missing
    page = (ROOT / 'docs' / 'how-to' / 'workspace.md').read_text(encoding='utf-8')
    assert all(name in page for name in BY_PIP)


def test_the_wheels_middleware_has_no_security_as_the_page_says():
    """When it gets it, SECURITY.md has to say so, and how enclaves are made."""
    found = [file for file in Path(sys.prefix).rglob('config.h')
             if 'HAVE_SECURITY' in file.read_text(encoding='utf-8', errors='replace')]
    if not found:
        pytest.skip('no Fast DDS from wheels in this environment')
    assert all('#define HAVE_SECURITY 0' in file.read_text() for file in found)
    assert '`HAVE_SECURITY` is 0' in (ROOT / 'SECURITY.md').read_text(encoding='utf-8')
