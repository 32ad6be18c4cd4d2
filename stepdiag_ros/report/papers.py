"""The papers' tables and figures, made again and set beside the published ones.

    python -m stepdiag_ros.report.papers --out docs/papers

writes one page a paper with its pictures, and an index.  What cannot be reached, and
where a text leaves a choice open, is stated on the page.
"""

import argparse
import sys
from pathlib import Path

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.report import (
    papers_dahlem,
    papers_hiruya,
    papers_ibaraki,
    papers_limits,
    papers_renishaw,
    papers_wang,
)

PAGES = {
    'renishaw_2016': ('Renishaw 2016: laser diagonal measurements', papers_renishaw.page),
    'wang_liotto_2003': ('Wang & Liotto 2003: body diagonals, step diagonal, lines', papers_wang.page),
    'ibaraki_2006': ('Ibaraki, Goto, Matsubara 2006: a new formulation', papers_ibaraki.page),
    'dahlem_2018': ('Dahlem et al. 2018: the enhanced step diagonal', papers_dahlem.page),
    'ibaraki_hiruya_2020': ('Ibaraki & Hiruya 2020: multilateration, regulated beam', papers_hiruya.page),
    'mirror_squared': ('Where it fails: mirror squared to the diagonal, R_x = R_y', papers_limits.mirror_page),
    'machine_c': ('Where it fails: what body diagonals cannot see', papers_limits.equal_page),
    'angles_in_a_step_diagonal': ('Where it fails: angular errors in a step diagonal', papers_limits.angle_page),
}


def write(out: Path) -> list[Path]:
    """Write all pages and pictures below ``out``; returns the pages."""
    written = []
    for name, (_, page) in PAGES.items():
        written.append(_put(out / f'{name}.md', page(out)))
    index = ('# The papers, made again\n\nMade by `python -m stepdiag_ros.report.papers --out docs/papers`; '
             'the same numbers are tests in `test/unit/estimate`.\n\n'
             + ''.join(f'- [{title}]({name}.md)\n' for name, (title, _) in PAGES.items())
             + '\nWhat each method assumes and cannot see: [methods](../explanation/methods.md).\n')
    written.append(_put(out / 'README.md', index))
    return written


def _put(path: Path, text: str) -> Path:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding='utf-8')
    except OSError as error:
        raise StepdiagError(f'{path}: cannot be written: {error}') from None
    return path


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--out', type=Path, default=Path('docs/papers'), metavar='FOLDER',
                        help='where to write (default: docs/papers)')
    args = parser.parse_args(argv)
    try:
        for path in write(args.out):
            print(path)
    except StepdiagError as error:
        print(f'papers: {error}', file=sys.stderr)
        return 2
    return 0


if __name__ == '__main__':
    sys.exit(main())
