"""Poses a second of the whole virtual sensor: ours, the bare formula, and the general ray tracers.

A pose is one position and attitude of the mirror; the scene is layout b, one interferometer beam
and one PSD beam with its detector.  Everybody traces the same poses, all on one core.  Errors are
against the closed form in extended precision (64-bit mantissa), so they are each tracer's own rounding.

    python bench/bench_rays.py                  ours, the formula, and the peers if they are installed
    python bench/bench_rays.py --peers          install the peers first (2.4 GB, into build/peers)

Writes docs/bench/rays.md and prints it.
"""

import os

# One core for everybody, before NumPy is loaded.
os.environ.update({'OMP_NUM_THREADS': '1', 'OPENBLAS_NUM_THREADS': '1', 'NUMBA_NUM_THREADS': '1'})

import argparse
import platform
import subprocess
import sys
import tempfile
import time
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import numpy as np

from stepdiag_ros.model.description import Machine, Setup
from stepdiag_ros.model.machine import rotation
from stepdiag_ros.model.mirror_form import SphericalForm, quadratic_form
from stepdiag_ros.model.optics import Body, Plane
from stepdiag_ros.model.sensor import station, turned
from stepdiag_ros.virtual.scene import SensorScene

ROOT = Path(__file__).resolve().parents[1]
PEERS = ROOT / 'build' / 'peers'
MACHINE = Machine('bench', 'FXYZ', (0.8, 0.6, 0.5), (0.0, 0.0, -0.15))
SETUP = Setup('npp', 0.35, (0.02, 0.0), ((0.0, 0.0),))
LASER, MOUNT = (7e-4, 1e-3), (1e-4, 3e-4)
BEST_OF = 7


def poses(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Mirror poses all over the volume with ordinary errors."""
    rng = np.random.default_rng(1)
    p = rng.uniform(0, 1, (n, 3)) * MACHINE.volume + MACHINE.tool + rng.normal(0, 1e-5, (n, 3))
    return p, rotation(rng.normal(0, 5e-5, (n, 3)))


def formula(p: np.ndarray, R: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The contract's closed form as one would write it in NumPy when it has to be fast."""
    base = station(MACHINE, SETUP)
    b, d = turned(base.triad, LASER), base.triad[2]
    m = (R.reshape(-1, 3) @ -turned(base.triad, MOUNT)).reshape(-1, 3)
    cosine = m @ b
    distance = np.einsum('ij,ij->i', p - base.origin, m) / cosine
    start = base.beam_origins(np.array(SETUP.psd_offset))[0]
    out = np.einsum('ij,ij->i', p - start, m) / cosine
    back = b - (2.0 * cosine / np.einsum('ij,ij->i', m, m))[:, None] * m
    home = -out * (b @ d) / (back @ d)
    spot = (out[:, None] * b + home[:, None] * back) @ base.triad[:2].T
    return distance, spot


def reference(p: np.ndarray, R: np.ndarray, start: np.ndarray, b: np.ndarray, m0: np.ndarray,
              triad: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distance from the base unit's origin 0 and spot, in extended precision, for whatever frame is given."""
    p, R, start, m0, triad = (np.asarray(a, np.longdouble) for a in (p, R, start, m0, triad))
    b = np.asarray(b, np.longdouble)
    b = b / np.sqrt(np.sum(b * b))
    m = np.sum(R * m0, axis=-1)
    cosine = np.sum(m * b, -1)
    distance, out = np.sum(p * m, -1) / cosine, np.sum((p - start) * m, -1) / cosine
    back = b - (2 * cosine / np.sum(m * m, -1))[:, None] * m
    home = -out * np.sum(b * triad[2]) / np.sum(back * triad[2], -1)
    path = out[:, None] * b + home[:, None] * back
    return distance, np.stack([np.sum(path * axis, -1) for axis in triad[:2]], -1)


def best(function: Callable, rounds: int = BEST_OF) -> tuple[float, object]:
    """Shortest of some runs (a busy machine only ever adds) and the result."""
    times = []
    for _ in range(rounds):
        start = time.perf_counter()
        result = function()
        times.append(time.perf_counter() - start)
    return min(times), result


def error_m(got: tuple[np.ndarray, np.ndarray], want: tuple[np.ndarray, np.ndarray]) -> tuple[float, float]:
    k = len(got[0])
    return tuple(float(np.max(np.abs(np.reshape(g, np.shape(w[:k])) - w[:k]))) for g, w in zip(got, want, strict=True))


def install_peers() -> None:
    python = PEERS / 'bin' / 'python'
    if not python.exists():
        subprocess.run([sys.executable, '-m', 'venv', str(PEERS)], check=True)
    subprocess.run([str(python), '-m', 'pip', 'install', '-q', '-r', str(ROOT / 'requirements' / 'bench.txt')],
                   check=True)


def run_peers(python: Path, p: np.ndarray, R: np.ndarray) -> list[tuple[str, float, int, tuple[float, float]]]:
    """Name with version, seconds, poses, errors of each peer, measured in its own process."""
    base = station(MACHINE, SETUP)
    normal = np.einsum('ij,njk,k->ni', base.triad, R, -turned(base.triad, MOUNT))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    point = (p - base.origin) @ base.triad.T
    beam = np.array([LASER[1], -LASER[0], 1.0])
    beam /= np.linalg.norm(beam)
    start = np.array([*SETUP.psd_offset, 0.0])
    # The exact answer to the inputs that they get, not to those they were rounded from.
    want = reference(point, normal[:, :, None], start, beam, np.ones(1), np.eye(3))
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        given, got = Path(folder) / 'in.npz', Path(folder) / 'out.npz'
        np.savez(given, point=point, normal=normal, beam=beam, psd_start=start)
        subprocess.run([str(python), '-W', 'ignore', str(ROOT / 'bench' / 'peers_rays.py'), str(given), str(got)],
                       check=True)
        with np.load(got) as data:
            for name in sorted({key.split('|')[0] for key in data.files}):
                measured = data[f'{name}|distance'], data[f'{name}|spot']
                label = name.replace(',', f' {data[f"{name}|version"]},', 1) if ',' in name else \
                    f'{name} {data[f"{name}|version"]}'
                rows.append((label, float(data[f'{name}|seconds']), len(measured[0]), error_m(measured, want)))
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--peers', action='store_true', help='install the peers into build/peers if they are not there')
    parser.add_argument('--peers-python', type=Path, default=PEERS / 'bin' / 'python',
                        help='a Python that has them already')
    parser.add_argument('--poses', type=int, default=200_000)
    parser.add_argument('--out', type=Path, default=ROOT / 'docs' / 'bench' / 'rays.md')
    args = parser.parse_args()
    if args.peers:
        install_peers()

    p, R = poses(args.poses)
    base = station(MACHINE, SETUP)
    want = reference(p.astype(np.longdouble) - base.origin, R,
                     base.beam_origins(np.array(SETUP.psd_offset))[0].astype(np.longdouble) - base.origin,
                     base.triad[2] - np.longdouble(LASER[0]) * base.triad[1] + np.longdouble(LASER[1]) * base.triad[0],
                     -(base.triad[2] - np.longdouble(MOUNT[0]) * base.triad[1]
                       + np.longdouble(MOUNT[1]) * base.triad[0]), base.triad)
    scene = SensorScene.of_setup(MACHINE, SETUP)

    def ours(n: int = args.poses, **more) -> tuple[np.ndarray, np.ndarray]:
        return tuple(scene.measure(p[:n], R[:n], beam_tilt=LASER, mirror_tilt=MOUNT, **more))

    # Turn about, so that a slow minute of the machine falls on both.
    formula_s, ours_s = np.inf, np.inf
    for _ in range(3):
        seconds, by_formula = best(lambda: formula(p, R), 3)
        formula_s = min(formula_s, seconds)
        seconds, by_ours = best(ours, 3)
        ours_s = min(ours_s, seconds)
    rows = [('stepdiag, traced', ours_s, args.poses, error_m(by_ours, want)),
            ('bare NumPy formula', formula_s, args.poses, error_m(by_formula, want))]
    note = ''
    if args.peers_python.exists():
        rows += run_peers(args.peers_python, p[:min(20_000, args.poses)], R[:min(20_000, args.poses)])
    else:
        note = '\nThe peers are not installed here; run `python bench/bench_rays.py --peers`.\n'

    rate = args.poses / ours_s
    lines = ['# Poses a second of the virtual sensor', '',
             'Made by `python bench/bench_rays.py --peers`. One interferometer beam and one PSD beam against a flat',
             'mirror, whose pose is another one each time; one core; best of several runs. Errors are the largest of',
             'all poses against the closed form with a 64-bit mantissa.', '',
             f'{platform.processor() or platform.machine()}, Python {platform.python_version()}, '
             f'NumPy {np.__version__}; {args.poses} poses (peers: as many as a second or so allows).',
             'All in one run of one machine: the ratios last longer than the rates.', '',
             '| | poses/s | stepdiag is | distance error / m | spot error / m |', '|---|---:|---:|---:|---:|']
    for name, seconds, count, errors in rows:
        times = rate * seconds / count
        lines.append(f'| {name} | {count / seconds:,.0f} | {f"{times:.2f}×" if times < 20 else f"{times:,.0f}×"} | '
                     f'{errors[0]:.1e} | {errors[1]:.1e} |')
    one_by_one = [count / seconds for name, seconds, count, _ in rows[2:] if ',' not in name]
    if one_by_one:
        lines += ['', f'Targets: at least 200× the best general tracer that takes the scene as it is: '
                  f'{rate / max(one_by_one):,.0f}×, {"met" if rate >= 200 * max(one_by_one) else "MISSED"}. '
                  f'Within 2× of the formula: {rate * formula_s / args.poses:.2f}× its rate, '
                  f'{"met" if rate * formula_s >= args.poses / 2 else "MISSED"}.', '',
                  'The row "rays moved by hand" is what a patient user of batoid gets: as only one body moves here,',
                  "NumPy code of his own carries every pose's rays into the mirror's frame, so that one call traces",
                  'all. It is no scene any more, and it does not carry over to two bodies that move apart.']
    lines += [note, '## How it grows, and what a form costs', '', '| poses | scene | ms | poses/s | peak MB |',
              '|---:|---|---:|---:|---:|']
    glass = Body.glass('window', 1.5168, Plane((0.0, 0.0, 0.05), (0.0, 0.0, -1.0)),
                       Plane((0.0, 0.0, 0.054), (1e-3, 0.0, 1.0)))
    window = SensorScene.of_setup(MACHINE, SETUP, [glass])
    cases = [(n, 'flat mirror', lambda n=n: ours(n)) for n in (1, 100, 1000, 10_000, 100_000) if n <= args.poses]
    largest = min(100_000, args.poses)
    cases += [(largest, 'spherical mirror', lambda: ours(largest, mirror_form=SphericalForm(1e-5))),
              (largest, 'mirror by a height function', lambda: ours(largest, mirror_form=quadratic_form(1e-5, 2e-6))),
              (largest, 'flat mirror behind a wedged window',
               lambda: window.measure(p[:largest], R[:largest], beam_tilt=LASER, mirror_tilt=MOUNT))]
    for n, name, function in cases:
        seconds, _ = best(function)
        tracemalloc.start()
        function()
        peak = tracemalloc.get_traced_memory()[1] / 1e6
        tracemalloc.stop()
        lines.append(f'| {n} | {name} | {seconds * 1e3:.2f} | {n / seconds:,.0f} | {peak:.1f} |')
    text = '\n'.join(line for line in lines if line is not None) + '\n'
    args.out.parent.mkdir(parents=True, exist_ok=True)
    args.out.write_text(text, encoding='utf-8')
    print(text)


if __name__ == '__main__':
    main()
