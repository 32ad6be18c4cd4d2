"""Writes docs/explanation/effects.md from what the effects say of themselves.

    python tools/effects_table.py            # write the page
    python tools/effects_table.py --check    # say whether it is up to date, write nothing
"""

import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / 'docs' / 'explanation' / 'effects.md'

HEAD = '''\
# The effects

What the rigid-body machine with 21 errors, a flat mirror and ideal sensors leaves out. The gap diagnosis
looks for these nineteen, in the names of the [wire contract](../reference/contract.md); the virtual cell can do
each of them. This page is made by `python tools/effects_table.py` from the classes in
`stepdiag_ros/effects/`: edit those.

An effect has two faces. It **acts** in the virtual cell: it moves an axis, turns a mirror, changes the air or a
reading. It **appears** in a log: a few *forms*, each a set of columns that the change of the readings is a
combination of, to first order. Forms are broad on purpose — a drift may be linear, exponential, a cycle
or merely smooth — and each is paid for by the evidence according to how much it could have fitted. Slow
effects show twice: from stop to stop, under the noise of every arrival, and as a slope inside each
dwell, under the sensor's noise alone, which is often the sharper eye. The tests hold both faces against
each other.

An effect of your own is one Python file with a class that has the same two faces: see
[a new effect](../how-to/add_an_effect.md).

| effect | what happens | signature | distinguished from |
|---|---|---|---|
'''


def page() -> str:
    from stepdiag_ros.effects import all_effects

    effects = list(all_effects().values())
    rows = [f'| [`{kind.name}`](#{kind.name}) | {kind.title} | {kind.signature} | {kind.neighbours} |'
            for kind in effects]
    return HEAD + '\n'.join(rows) + '\n' + ''.join(_section(kind) for kind in effects)


def _section(kind) -> str:
    physics = sys.modules[kind.__module__].__doc__.strip().split('\n\n', 1)[-1]
    lines = [f'\n## {kind.name}\n', physics + '\n',
             'In a cell file:\n', '| parameter | unit | plausible | meaning |', '|---|---|---|---|']
    for p in kind.parameters:
        size = f' ({p.size})' if p.size > 1 else ''
        lines.append(f'| `{p.name}`{size} | {p.unit} | {p.low:g} … {p.high:g} | {p.meaning or kind.title} |')
    if kind.course_of:
        replaced = [p.name for p in kind.parameters if p.name not in kind.course_keeps]
        lines.append(f'\nOr with a [`course`](../reference/cell_file.md#effects-in-the-course-of-time) of '
                     f'{" and ".join(f"`{n}`" for n in kind.course_of)} in place of '
                     f'{", ".join(f"`{n}`" for n in replaced)}.')
    lines += [f'\n**Signature.** {kind.signature}', f'\n**Neighbours.** {kind.neighbours}',
              f'\n**Remedy.** {kind.remedy}', f'\n*Sources:* {"; ".join(kind.sources)}.\n']
    return '\n'.join(lines)


def main(arguments: list[str]) -> int:
    text = page()
    if '--check' in arguments:
        if PAGE.read_text(encoding='utf-8') == text:
            return 0
        print(f'{PAGE} is not what the effects say; run python tools/effects_table.py', file=sys.stderr)
        return 1
    PAGE.write_text(text, encoding='utf-8')
    return 0


if __name__ == '__main__':
    sys.path.insert(0, str(ROOT))
    sys.exit(main(sys.argv[1:]))
