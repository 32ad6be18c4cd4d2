"""Answer a sealed set: diagnose every log, knowing nothing but the log, and lock the answers.

``DIR/answers/log_NNN/gap.json`` is the contract's answer; ``extra.json`` beside it holds what only
the scoring needs (probabilities of everything, the errors before and after, the time taken).
``DIR/answers.json`` publishes the SHA-256 of all of them.
"""

import hashlib
import json
import os
import time
from pathlib import Path
from typing import Any

from stepdiag_ros.bag.reader import read_log
from stepdiag_ros.blind.pool import side_by_side
from stepdiag_ros.blind.seal import LOGS, MANIFEST, SCHEMA, write_json
from stepdiag_ros.effects import all_effects
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.gap.diagnose import diagnose
from stepdiag_ros.guard.jsontext import to_json

ANSWERS, ANSWER_HASHES = 'answers', 'answers.json'
FILES = ('gap.json', 'extra.json')


def answer_log(path: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """The contract's answer to one log, and what the scoring needs besides."""
    log = read_log(path)
    begin = time.process_time()
    diagnosis = diagnose(log, [kind() for kind in all_effects().values()])
    seconds = time.process_time() - begin
    errors = {'before': diagnosis.plain.to_json_dict()['errors'],
              'after': diagnosis.solution.to_json_dict()['errors']}
    gap = diagnosis.cross_validation
    extra = {'seconds': seconds, 'ranking': dict(diagnosis.ranking),
             'sets': [[list(names), p] for names, p in diagnosis.sets], 'errors': errors,
             'closing': {'before': gap.before, 'after': gap.after, 'count': gap.count}}
    return diagnosis.to_json_dict(), extra


def answer(folder: Path, processes: int = 2, progress: bool = True) -> str:
    """Answer all logs of the set; returns the SHA-256 of the answers.

    Answers that are there are kept, so that a cut run is resumed; once all are there and hashed,
    answering again is refused.
    """
    names = log_names(folder)
    if (folder / ANSWER_HASHES).exists():
        raise StepdiagError(f'{folder}: is answered already; open it, or remove {ANSWER_HASHES} '
                            'and answers/ to answer anew')
    missing = [n for n in names if not all((folder / ANSWERS / n / f).exists() for f in FILES)]
    # One thread a log: the time that is reported is that of one core.
    for variable in ('OPENBLAS_NUM_THREADS', 'OMP_NUM_THREADS'):
        os.environ[variable] = '1'
    for _ in side_by_side(_one, {name: (str(folder), name) for name in missing}, processes,
                          'answered' if progress else ''):
        pass
    return lock(folder, names)


def lock(folder: Path, names: list[str]) -> str:
    """Hash the answers and publish; returns the hash of all."""
    hashes = answer_hashes(folder, names)
    whole = hashlib.sha256(to_json(hashes, indent=None, sort_keys=True).encode()).hexdigest()
    write_json(folder / ANSWER_HASHES, {'schema': SCHEMA, 'answers_sha256': whole, 'files': hashes})
    return whole


def answer_hashes(folder: Path, names: list[str]) -> dict[str, str]:
    """SHA-256 of each answer's files."""
    return {f'{name}/{file}': hashlib.sha256((folder / ANSWERS / name / file).read_bytes()).hexdigest()
            for name in names for file in FILES}


def log_names(folder: Path) -> list[str]:
    """Names of the set's logs, in order."""
    if not (folder / MANIFEST).exists():
        raise StepdiagError(f'{folder}: has no {MANIFEST}; it is no sealed set, or its sealing was cut '
                            'short: run stepdiag blind seal again')
    manifest = json.loads((folder / MANIFEST).read_text())
    names = sorted(p.name for p in (folder / LOGS).iterdir() if p.is_dir())
    if len(names) != manifest['logs']:
        raise StepdiagError(f'{folder}: holds {len(names)} logs and {MANIFEST} says {manifest["logs"]}; '
                            'the set is not as it was sealed')
    return names


def _one(folder: str, name: str) -> None:
    place = Path(folder)
    gap, extra = answer_log(place / LOGS / name)
    out = place / ANSWERS / name
    out.mkdir(parents=True, exist_ok=True)
    write_json(out / 'extra.json', extra)
    write_json(out / 'gap.json', gap)
