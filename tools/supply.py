"""What is installed, for those who must know: `make sbom` and `make lock`.

`sbom` writes build/sbom.cdx.json, a CycloneDX bill of materials of the environment .venv.
`lock` writes requirements/locked.txt: every pinned package with the hashes of its files.
The first uses a tool in an environment of its own, build/tools; the second pip alone.
"""

import argparse
import json
import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
REQUIREMENTS = ROOT / 'requirements'
PYTHONS = ('3.11', '3.12', '3.13')
PINNED = ('build', 'run', 'test', 'constraints')
HEAD = ('# Every package that `make setup-tests` installs, with the hashes of its files; with HASHES=1 it installs\n'
        '# nothing else.  Written by `make lock`.\n')


def tools() -> Path:
    """The folder with the tools' programs; the environment is made when it is not there."""
    place = ROOT / 'build' / 'tools'
    stamp, wanted = place / 'made_of', (REQUIREMENTS / 'tools.txt').read_text()
    if not stamp.exists() or stamp.read_text() != wanted:
        subprocess.run([sys.executable, '-m', 'venv', '--clear', str(place)], check=True)
        subprocess.run([str(place / 'bin' / 'pip'), 'install', '-q', '-r', str(REQUIREMENTS / 'tools.txt')], check=True)
        stamp.write_text(wanted)
    return place / 'bin'


def pins() -> list[str]:
    """``name==version`` of every pinned package, in order of the name."""
    lines = set()
    for name in PINNED:
        for line in (REQUIREMENTS / f'{name}.txt').read_text().splitlines():
            if pin := line.split('#')[0].strip():
                lines.add(pin)
    return sorted(lines, key=str.lower)


def lock() -> None:
    """Ask pip, for each Python, which file of each package it would take, and note the file's hash."""
    hashes: dict[str, set[str]] = {pin: set() for pin in pins()}
    for python in PYTHONS:
        wheels, sources = list(hashes), []
        # Only for wheels does pip answer for another Python; the few packages without one are the same for all.
        options = ['--python-version', python, '--only-binary=:all:', '--target', str(ROOT / 'build' / 'nowhere')]
        while True:
            found = asked(wheels, options)
            if isinstance(found, dict):
                break
            wheels.remove(found)
            sources.append(found)
        rest = asked(sources, []) if sources else {}
        if isinstance(rest, str):
            raise SystemExit(f'lock: {rest} is not to be had')
        for pin in hashes:
            hashes[pin].add((found | rest)[canonical(pin.split('==')[0])])
    text = ''.join(f'{pin}' + ''.join(f' \\\n    --hash=sha256:{value}' for value in sorted(values)) + '\n'
                   for pin, values in hashes.items())
    (REQUIREMENTS / 'locked.txt').write_text(HEAD + text)
    print(REQUIREMENTS / 'locked.txt')


def asked(wanted: list[str], options: list[str]) -> dict[str, str] | str:
    """The hash of the file that pip would take, by package; or the one of the ``wanted`` that has none."""
    command = [sys.executable, '-m', 'pip', 'install', '--disable-pip-version-check', '--dry-run', '--quiet',
               '--ignore-installed', '--no-deps', '--report', '-', *options, *wanted]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        missing = re.search(r'No matching distribution found for (\S+)', done.stderr)
        if missing is None:
            raise SystemExit(f'lock: pip says {done.stderr.strip().splitlines()[-1]}')
        return missing[1]
    return {canonical(item['metadata']['name']): item['download_info']['archive_info']['hashes']['sha256']
            for item in json.loads(done.stdout)['install']}


def canonical(name: str) -> str:
    """A package's name as indexes compare it."""
    return re.sub(r'[-_.]+', '-', name).lower()


def sbom(environment: Path, out: Path) -> None:
    out.parent.mkdir(parents=True, exist_ok=True)
    subprocess.run([str(tools() / 'cyclonedx-py'), 'environment', '--output-reproducible', '--of', 'JSON',
                    '-o', str(out), str(environment / 'bin' / 'python')], check=True)
    print(out)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('what', choices=('sbom', 'lock'))
    parser.add_argument('--venv', type=Path, default=ROOT / '.venv', help='environment to describe (default: .venv)')
    parser.add_argument('--out', type=Path, default=ROOT / 'build' / 'sbom.cdx.json', help='bill of materials to write')
    given = parser.parse_args()
    if given.what == 'lock':
        lock()
    else:
        sbom(given.venv.absolute(), given.out)
    return 0


if __name__ == '__main__':
    sys.exit(main())
