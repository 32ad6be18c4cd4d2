"""How well one source serves many machines: the queue against the best of all schedules, and a hall that runs.

  python bench/bench_hall.py                     the queue, by its own code with a simulated clock
  python bench/bench_hall.py --live HALL.yaml    brings a hall up (without gap monitors), calibrates it, reads its logs

A machine alternates moves that need no light (approach, return, next setup) with runs that do.  The queue serves first
come, first served.  The exact schedule knows all times beforehand and is free to let the light wait for a machine that
comes soon; it is found by dynamic programming over who goes next, dominated states left out, so its makespan is a lower
bound for any queue.  The figures stand in docs/bench/hall.md.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from stepdiag_ros.nodes.source_queue import SourceQueue

#: Time of putting the light from one machine to another [s], as measured with `--live`.
HANDOVER_S = 0.15
Chain = list[tuple[float, float]]      # (without light, with light) [s] of each run


def drawn(rng: np.random.Generator, machines: int, runs: int, dark: float) -> list[Chain]:
    """Machines of different size: runs of 20 to 120 s, between them on average ``dark`` times as long without light."""
    chains = []
    for _ in range(machines):
        light = rng.uniform(20.0, 120.0)
        # Forward and backward: the way back begins where the way there ended.
        chains.append([(light * dark * rng.uniform(0.5, 3.5) if k % 2 == 0 else 1.0, light * rng.uniform(0.9, 1.1))
                       for k in range(runs)])
    return chains


def by_queue(chains: list[Chain]) -> tuple[float, float]:
    """Makespan [s] and the share of the time in which the light was wanted and idle, by the queue."""
    clock = [0.0]
    queue = SourceQueue(float('inf'), lambda: clock[0])
    events = [(chain[0][0], 'asks', j, None) for j, chain in enumerate(chains)]
    at = [0] * len(chains)
    while events:
        events.sort(key=lambda event: event[:3])
        clock[0], what, j, request = events.pop(0)
        if what == 'asks':
            queue.ask(b'%d/%d' % (j, at[j]), str(j), 0, chains[j][at[j]][1])
        elif what == 'has it':
            queue.granted(request)
            events.append((clock[0] + chains[j][at[j]][1], 'gives it back', j, request))
        else:
            queue.release(request.key)
            at[j] += 1
            if at[j] < len(chains[j]):
                events.append((clock[0] + chains[j][at[j]][0], 'asks', j, None))
        picked = queue.next()
        if picked is not None:
            events.append((clock[0] + HANDOVER_S, 'has it', int(picked.machine), picked))
    return clock[0], queue.measure().idle_share


def exact(chains: list[Chain], limit: int = 200_000) -> tuple[float, bool]:
    """The least makespan [s] of any order; False where states had to be dropped (then it is only an upper bound)."""
    count, whole = len(chains), True
    tails = [[0.0] * (len(chain) + 1) for chain in chains]
    for j, chain in enumerate(chains):
        for k in reversed(range(len(chain))):
            tails[j][k] = tails[j][k + 1] + chain[k][0] + chain[k][1] + HANDOVER_S
    best = by_queue(chains)[0]
    # State: runs done by each, time at which the light is free, times at which each is ready.
    layer = {(0,) * count: [(0.0, *(chain[0][0] for chain in chains))]}
    for _ in range(sum(map(len, chains))):
        following: dict[tuple[int, ...], list[tuple[float, ...]]] = {}
        for done, states in layer.items():
            for state in states:
                for j in range(count):
                    if done[j] == len(chains[j]):
                        continue
                    begin = max(state[0], state[1 + j])
                    end = begin + HANDOVER_S + chains[j][done[j]][1]
                    after = (*done[:j], done[j] + 1, *done[j + 1:])
                    ready = list(state[1:])
                    ready[j] = end + chains[j][after[j]][0] if after[j] < len(chains[j]) else 0.0
                    left = sum(chain[k][1] + HANDOVER_S for chain, d in zip(chains, after, strict=True)
                               for k in range(d, len(chain)))
                    bound = max([end + left] + [max(end, r) + tails[i][after[i]] - chains[i][after[i]][0]
                                                for i, r in enumerate(ready) if after[i] < len(chains[i])])
                    if bound < best - 1e-9 or (bound <= best + 1e-9 and left == 0.0):
                        # Times before the light is free are all alike.
                        following.setdefault(after, []).append((end, *(max(end, r) for r in ready)))
        layer = {done: _undominated(states) for done, states in following.items()}
        if sum(map(len, layer.values())) > limit:
            whole = False
            layer = {done: sorted(states)[:50] for done, states in layer.items()}
        if not layer:
            return best, whole     # nothing is better than the queue
    return min(best, min(state[0] for states in layer.values() for state in states)), whole


def _undominated(states: list[tuple[float, ...]]) -> list[tuple[float, ...]]:
    kept: list[tuple[float, ...]] = []
    for state in sorted(set(states)):
        if not any(all(a <= b for a, b in zip(other, state, strict=True)) for other in kept):
            kept.append(state)
    return kept


def simulate(draws: int) -> None:
    print(f'handover {HANDOVER_S} s; {draws} draws each; makespan over that of the exact schedule: median, worst')
    print('| machines | runs each | without light / with | queue / exact, median | worst | light idle though wanted |')
    print('|---|---|---|---|---|---|')
    for machines, runs, dark in ((4, 4, 0.1), (4, 4, 0.5), (4, 4, 1.0), (4, 4, 3.0), (4, 8, 0.5), (16, 8, 0.5)):
        rng, ratios, idle, whole = np.random.default_rng(23), [], [], True
        for _ in range(draws):
            chains = drawn(rng, machines, runs, dark)
            makespan, share = by_queue(chains)
            if machines * runs <= 32:
                least, complete = exact(chains)
                whole &= complete
            else:   # too many orders: the light's own work, or the longest machine's
                least = max(sum(light + HANDOVER_S for chain in chains for _, light in chain)
                            + min(chain[0][0] for chain in chains),
                            max(sum(a + b + HANDOVER_S for a, b in chain) for chain in chains))
            ratios.append(makespan / least)
            idle.append(share)
        kind = '' if machines * runs <= 32 and whole else ' (bound)'
        print(f'| {machines} | {runs} | {dark:g} | {np.median(ratios):.3f}{kind} | {max(ratios):.3f} | '
              f'{100 * np.mean(idle):.2f} % |')


def live(path: Path, arguments: list[str]) -> None:
    """A hall that runs: how the light was used, how long it took, what a machine costs."""
    from stepdiag_ros.bag.reader import read_log
    from stepdiag_ros.nodes import bringup
    from stepdiag_ros.nodes.hall import MACHINE_NODES, Hall
    bringup.START_TIMEOUT_S = 300.0     # what is measured is not the start
    nodes = tuple(name for name in MACHINE_NODES if name != 'gap_monitor')
    with tempfile.TemporaryDirectory() as folder, \
            Hall(path, bag_folder=Path(folder) / 'bags', runtime=Path(folder) / 'run', nodes=nodes,
                 say=lambda text: print(f'# {text}', flush=True)) as hall:
        machines, began, cpu = len(hall.machines), time.monotonic(), _cpu_s(hall)
        answer = Path(folder) / 'answer.json'     # longer than a pipe holds
        with open(answer, 'w', encoding='utf-8') as out:
            command = subprocess.Popen([sys.executable, '-m', 'stepdiag_ros.cli.main', 'calibrate', '--all', '--json',
                                        *arguments], stdout=out)
        memory = 0.0
        while command.poll() is None:
            hall.watch()
            memory = max(memory, _memory_mib(hall))
            time.sleep(1.0)
        took, cpu = time.monotonic() - began, _cpu_s(hall) - cpu
        results = json.loads(answer.read_text(encoding='utf-8'))
        usage = {v.key: v.value for v in hall.source.operator.health('multiplexer').values}
        light, lost, ends = 0.0, 0, []
        for name, result in results.items():
            if not result['stops']:
                print(f'{name}: {result["outcome"]}: {result["message"]}')
                continue
            log = read_log(result['bag'])
            spans = [np.ptp(log.steps.time_ns[log.steps.run == n]) * 1e-9 for n in set(log.steps.run)]
            light += sum(spans)
            ends += [log.steps.time_ns[log.steps.run == n][[0, -1]] for n in set(log.steps.run)]
            lost += sum('dwell' in w or 'hold no usable' in w for w in log.warnings)
            print(f'{name}: {result["outcome"]}: {result["message"]}; {len(spans)} runs, {sum(spans):.1f} s of light')
        print(f'{machines} machines, {took:.0f} s; light needed {light:.1f} s; held {usage["held_s"]} s, idle though '
              f'wanted {usage["idle_s"]} s ({100 * float(usage["idle_share"]):.1f} %), {usage["grants"]} grants, '
              f'handover {usage["handover_s"]} s')
        # No schedule can do with less than the light's own work and a handover between two runs.
        least = light + (len(ends) - 1) * float(usage['handover_s'])
        measured = (max(end for _, end in ends) - min(begin for begin, _ in ends)) * 1e-9
        print(f'{len(ends)} runs from first to last {measured:.1f} s, least of any schedule {least:.1f} s: '
              f'{measured / least:.3f}')
        print(f'memory {memory / machines:.0f} MiB a machine (proportional set size, the source\'s share included), '
              f'processor {cpu / took / machines:.2f} a machine; warnings of lost dwells: {lost}; load {os.getloadavg()}')


def _processes(hall) -> list[int]:
    """All processes of the hall: what it started, and what those did."""
    found = [pid for part in (*hall.machines.values(), hall.source) for pid in part.pids().values()]
    for pid in found:
        for task in Path(f'/proc/{pid}/task').glob('*/children'):
            found += [int(child) for child in task.read_text().split()]
    return found


def _memory_mib(hall) -> float:
    return sum(int(line.split()[1]) for pid in _processes(hall)
               for line in Path(f'/proc/{pid}/smaps_rollup').read_text().splitlines() if line.startswith('Pss:')) / 1024


def _cpu_s(hall) -> float:
    """Processor time [s] of all processes so far."""
    ticks = 0
    for pid in _processes(hall):
        fields = Path(f'/proc/{pid}/stat').read_text().rpartition(')')[2].split()
        ticks += int(fields[11]) + int(fields[12])
    return ticks / os.sysconf('SC_CLK_TCK')


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--draws', type=int, default=20)
    parser.add_argument('--live', type=Path, metavar='HALL.yaml')
    given, rest = parser.parse_known_args()
    if given.live is not None:
        live(given.live, rest)
    else:
        simulate(given.draws)
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
