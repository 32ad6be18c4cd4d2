"""Documentation that points nowhere, or names what does not exist, fails."""

import re
from pathlib import Path

import pytest

from stepdiag_ros.cli.main import COMMANDS

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / 'README.md', *sorted((ROOT / 'docs').rglob('*.md'))]
LINK = re.compile(r'\]\(([^)#\s]+)(?:#[^)]*)?\)')


def prose(page: Path) -> str:
    """A page without its code, in which brackets mean something else."""
    text = re.sub(r'^```.*?^```', '', page.read_text(), flags=re.DOTALL | re.MULTILINE)
    return re.sub(r'`[^`\n]*`', '', text)


@pytest.mark.parametrize('page', PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_somewhere(page: Path) -> None:
    for target in LINK.findall(prose(page)):
        if '://' not in target:
            assert (page.parent / target).exists(), f'{page.relative_to(ROOT)} links to {target}'


def test_every_page_is_reached_from_the_index() -> None:
    """Following links from docs/README.md; decisions are listed by their folder."""
    start = ROOT / 'docs' / 'README.md'
    reached, waiting = {start}, [start]
    while waiting:
        page = waiting.pop()
        for target in LINK.findall(prose(page)):
            linked = (page.parent / target).resolve()
            if '://' not in target and linked.suffix == '.md' and linked.exists() and linked not in reached:
                reached.add(linked)
                waiting.append(linked)
    pages = [page for page in PAGES[1:] if page.parent.name != 'decisions']
    lost = [str(page.relative_to(ROOT)) for page in pages if page not in reached]
    assert not lost, f'no link leads to {lost}'


def test_decisions_are_numbered_once() -> None:
    numbers = {}
    for page in (ROOT / 'docs' / 'decisions').glob('[0-9]*.md'):
        number = page.name[:4]
        assert number not in numbers, f'{page.name} and {numbers[number]} have the same number'
        numbers[number] = page.name
        assert page.read_text().startswith(f'# {number} '), f'{page.name} must start with its number'


def test_commands_of_the_first_page_exist() -> None:
    modules = {name: module for name, module, _ in COMMANDS}
    for command in re.findall(r'`stepdiag ([a-z]+)', (ROOT / 'README.md').read_text()):
        file = ROOT / 'stepdiag_ros' / 'cli' / f'{modules[command]}.py'
        assert file.is_file(), f'README.md names `stepdiag {command}`, which does not exist'
