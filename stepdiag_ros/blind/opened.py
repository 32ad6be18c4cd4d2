"""Open a sealed and answered set: check both hashes, score, and show it as table, picture and JSON."""

import datetime
import hashlib
import json
from pathlib import Path
from typing import Any

from stepdiag_ros.blind.answer import ANSWER_HASHES, ANSWERS, answer_hashes, log_names
from stepdiag_ros.blind.score import COUNTS_FROM, Case, proportion, score
from stepdiag_ros.blind.seal import MANIFEST, SEALED, read_json, write_json
from stepdiag_ros.blind.world import CATEGORIES
from stepdiag_ros.errors import StepdiagError

WORLDS, SETTLED = 'worlds.json', 'settled.json'
MARK = '<!-- results -->'
ROWS = (
    ('false_alarms', 'false alarms on null logs', '0 of 300', True),
    ('false_alarms_untidy', 'the same with untidy noise', '≤ 1 of 300', True),
    ('false_alarms_live', 'the same, live logs', '0 of 30', True),
    ('false_alarms_loaded', 'the same, live logs on a busy computer', '0 of 30', True),
    ('detection', 'detection', '≥ 99 %', True),
    ('first_right', 'right effect first, among separable ones', '≥ 98 %', True),
    ('first_right_all', 'right effect first, all', '≥ 95 %', True),
    ('mean_probability', 'mean probability on the truth', '≥ 0.90', False),
    ('set_coverage', '95 % sets: coverage', '≥ 0.95', True),
    ('set_size', '95 % sets: mean size', '≤ 1.5', False),
    ('outside_unknown', 'effect from outside: called unknown', '≥ 85 %', True),
    ('outside_misnamed', 'effect from outside: misnamed', '≤ 5 %', True),
    ('outside_sure', 'the same, at 0.85 and more', '≤ 3 %', True),
    ('outside_unknown_separable', 'called unknown, among those that no name imitates', '–', True),
    ('outside_sure_separable', 'misnamed at 0.85 and more, among these', '–', True),
    ('pair_exact', 'both of a pair, exactly', '≥ 90 %', True),
    ('where_f1', 'where, F1', '≥ 0.90', False),
    ('gap_closed', 'gap closed on held-out data', '≥ 95 %', False),
    ('gap_closed_together', 'the same, all logs together', '–', False),
    ('held_out_chi2', 'reduced χ² on held-out data, median', '≤ 1.05', False),
    ('bias_removed', 'bias of the 21 errors removed', '≥ 95 %', False),
    ('bias_removed_median', 'the same, median of the logs', '–', False),
    ('en_at_most_1', 'En ≤ 1', '≥ 95 %', True),
    ('settled', 'one recommended extra run settles a set', '≥ 90 %', True),
    ('settled_all', 'the same, effects below 8 σ too', '–', True),
    ('calibration_error', 'calibration error of the probabilities', '≤ 0.03', False),
    ('calibration_error_large', 'the same, from 200 σ', '≤ 0.03', False),
    ('seconds', 'time for one log, median [s]', '≤ 10', False))
"""Figure, its name, its target, whether it is a proportion."""


def open_set(folder: Path) -> dict[str, Any]:
    """Check the hashes and score; writes ``score.json``, ``score.md`` and ``score.png`` into the set."""
    cases, head = load(folder)
    result = {**head, 'opened': datetime.date.today().isoformat(),
              'categories': {category: sum(c.category == category for c in cases) for category in CATEGORIES},
              **score(cases)}
    settled = read_json(folder / SETTLED)
    rows = settled.get('logs', [])
    if settled and len(rows) == settled.get('of', len(rows)):  # a cut run of them says nothing of the set
        weakest = {case.name: case.weakest for case in cases}
        for figure, least in (('settled', COUNTS_FROM), ('settled_all', 0.0)):
            counted = [row['settled'] for row in rows if weakest[row['log']] >= least]
            result['figures'][figure] = proportion(sum(counted), len(counted))
    write_json(folder / 'score.json', result)
    (folder / 'score.md').write_text(table(result) + '\n')
    draw(result, folder / 'score.png')
    return result


def into_page(result: dict[str, Any], folder: Path, page: Path) -> None:
    """Replace what stands below ``<!-- results -->`` of a page by the table, and its picture by the set's."""
    text = page.read_text()
    if MARK not in text:
        raise StepdiagError(f'{page}: has no line {MARK}; add it where the results shall stand')
    picture = page.parent / 'images' / 'blind.png'
    picture.parent.mkdir(exist_ok=True)
    picture.write_bytes((folder / 'score.png').read_bytes())
    counts = ', '.join(f'{n} {category}' for category, n in result['categories'].items())
    head = (f'{result["logs"]} logs ({counts}), purpose `{result["purpose"]}`, seed {result["seed"]}, opened on '
            f'{result["opened"]}.  SHA-256 of the truth `{result["truth_sha256"]}`, of the answers '
            f'`{result["answers_sha256"]}`.')
    peers = folder / 'peers.md'
    rest = f'\n### Peers on the same logs\n\n{peers.read_text()}' if peers.exists() else ''
    page.write_text(f'{text.split(MARK)[0]}{MARK}\n\n{head}\n\n{table(result)}\n\n'
                    f'![Seen and named, calibration](images/blind.png)\n{rest}')


def load(folder: Path) -> tuple[list[Case], dict[str, Any]]:
    """All cases of a set whose hashes are right, and what identifies the set."""
    names = log_names(folder)
    if not (folder / ANSWER_HASHES).exists():
        raise StepdiagError(f'{folder}: is not answered yet; run stepdiag blind answer {folder}')
    if not (folder / SEALED).exists():
        raise StepdiagError(f'{folder / SEALED}: is not there; put the sealed truth back to open the set')
    text = (folder / SEALED).read_text()
    published = json.loads((folder / MANIFEST).read_text())['truth_sha256']
    if hashlib.sha256(text.encode()).hexdigest() != published:
        raise StepdiagError(f'{folder / SEALED}: its SHA-256 is not the one published in {MANIFEST}; '
                            'the truth was changed after sealing')
    locked = json.loads((folder / ANSWER_HASHES).read_text())
    for file, digest in answer_hashes(folder, names).items():
        if locked['files'].get(file) != digest:
            raise StepdiagError(f'{folder / ANSWERS / file}: its SHA-256 is not the one published in '
                                f'{ANSWER_HASHES}; the answer was changed after answering')
    truth = json.loads(text)
    judged = read_json(folder / WORLDS)
    cases = []
    for name in names:
        place = folder / ANSWERS / name
        cases.append(Case(name, {**truth['logs'][name], **judged.get(name, {})},
                          json.loads((place / 'gap.json').read_text()),
                          json.loads((place / 'extra.json').read_text())))
    return cases, {'seed': truth['seed'], 'purpose': truth['purpose'], 'logs': len(names),
                   'truth_sha256': published, 'answers_sha256': locked['answers_sha256']}


def shown(figure: dict[str, Any], proportion: bool) -> str:
    """One figure with its interval, or how many it is the mean of."""
    if figure['value'] is None:
        return '– (none)'
    if proportion:
        low, high = figure['interval']
        return (f'{figure["hits"]} of {figure["count"]} = {100.0 * figure["value"]:.1f} % '
                f'[{100.0 * low:.1f}, {100.0 * high:.1f}]')
    return f'{figure["value"]:.3g} ({figure["count"]})'


def table(result: dict[str, Any]) -> str:
    """The figures as Markdown: the table, the curve, and every effect by itself."""
    figures = result['figures']
    lines = ['| | target | measured |', '|---|---|---|']
    lines += [f'| {name} | {target} | {shown(figures[key], proportion)} |'
              for key, name, target, proportion in ROWS if key in figures]
    lines += ['', '95 % intervals in brackets (Wilson); numbers of logs or statements in parentheses.', '',
              '| visibility [σ] | detection | right effect first | outside called unknown |',
              '|---|---|---|---|']
    lines += [f'| {row["from"]:g} – {row["to"]:g} | {shown(row["detection"], True)} | '
              f'{shown(row["first_right"], True)} | {shown(row["outside_unknown"], True)} |'
              for row in result['curve']]
    lines += ['', '| effect (from 8 σ) | logs | detected | first | instead |', '|---|---|---|---|---|']
    for name, row in sorted(result['by_effect'].items()):
        instead = ', '.join(f'{n} {k}' for n, k in sorted(row['instead'].items(), key=lambda i: -i[1]))
        lines.append(f'| {name} | {row["count"]} | {row["detected"]} | {row["first"]} | {instead or "–"} |')
    return '\n'.join(lines)


def draw(result: dict[str, Any], path: Path) -> None:
    """Detection and naming over visibility, and how well probabilities are calibrated."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    figure = Figure(figsize=(10.0, 4.2), layout='constrained')
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2)
    for key, name, mark in (('detection', 'detected', 'o'), ('first_right', 'right effect first', 's'),
                            ('outside_unknown', 'outside called unknown', '^')):
        rows = [r for r in result['curve'] if r[key]['value'] is not None]
        middle = [(r['from'] * r['to']) ** 0.5 for r in rows]
        value = [r[key]['value'] for r in rows]
        errors = [[max(0.0, r[key]['value'] - r[key]['interval'][0]) for r in rows],
                  [max(0.0, r[key]['interval'][1] - r[key]['value']) for r in rows]]
        left.errorbar(middle, value, yerr=errors, marker=mark, capsize=3, label=name)
    left.set(xscale='log', xlabel='visibility of the effect [standard deviations]', ylim=(-0.03, 1.03),
             ylabel='share of the logs', title='Seen and named')
    left.set_xticks([3, 4, 5, 8, 10, 15, 20, 40], labels=['3', '4', '5', '8', '10', '15', '20', '40'])
    left.minorticks_off()
    left.axvline(8.0, color='0.7', lw=1.0)
    left.grid(alpha=0.3)
    left.legend(loc='lower right')
    bins = result['calibration']['bins']
    right.plot([0, 1], [0, 1], color='0.7', lw=1.0)
    right.plot([b['said'] for b in bins], [b['true'] for b in bins], marker='o')
    right.set(xlabel='probability that was given', ylabel='share that was true', aspect='equal',
              xlim=(-0.03, 1.03), ylim=(-0.03, 1.03), title='Calibration of the probabilities')
    right.grid(alpha=0.3)
    figure.savefig(path, dpi=130)
