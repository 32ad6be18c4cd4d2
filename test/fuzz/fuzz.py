"""The fuzzer: ``make fuzz TIME=3600``, or ``python test/fuzz/fuzz.py --seconds 60 --kinds bag cell``.

Turns about what comes from outside: mutated bags, odd logs, cell files, effect files and tables through the commands,
spoilt JSON-RPC, Modbus and linuxcncrsh between drivers and virtual instruments, both ways.  It keeps every input that
made a command do what no command may: a traceback, a hang, much memory, JSON that is none, more than one line of
complaint.  Inputs that were found stand in ``--out``, each with the command line beside it; what was found on a wire comes
again with the seed that is printed (``--again SEED``).  Exit status 1 if there are any.
"""

import argparse
import random
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
import harness
import inputs
import wires

import bags

#: Of inputs: files that are given to commands, and what passes over wires.
KINDS = ('bag', 'log', 'cell', 'effect', 'table', 'truth', 'budget', *wires.KINDS)


class Fuzzer:
    """Draws inputs from a seed, runs commands on them, keeps the findings."""

    def __init__(self, seed: int, out: Path, kinds: tuple[str, ...] = KINDS):
        self.seed, self.out, self.kinds = seed, out, kinds
        self.turns = self.runs = 0
        self.statuses: dict[int, int] = {}
        self.found: dict[str, str] = {}
        self._folder = tempfile.TemporaryDirectory(prefix='stepdiag-fuzz-')
        self.place = Path(self._folder.name)
        if set(kinds) - set(wires.KINDS):
            harness.warm_up()
            self.sound = dict(bags.small_bags(self.place))
            diagonals = str(self.place / 'diagonals')
            self.beside = {'truth': harness.run(['evaluate', diagonals, '--json']).out,
                           'budget': harness.run(['uncertainty', '--print-budget']).out}
        self.wires = wires.Wires(self.place) if set(kinds) & set(wires.KINDS) else None

    def try_file(self, data: bytes, ending: str, commands: tuple[str, ...], what: str) -> list[str]:
        """Run the commands on a file that holds ``data``; what is wrong, a line each."""
        said = []
        with tempfile.TemporaryDirectory(dir=self.place) as name:
            folder = Path(name)
            given = folder / f'given{ending}'
            given.write_bytes(data)
            for command in commands:
                outcome = harness.run(harness.arguments(command, given, folder))
                self.runs += 1
                self.statuses[outcome.status] = self.statuses.get(outcome.status, 0) + 1
                if fault := harness.judge(outcome, len(data)):
                    said.append(f'{command}: {what}: {fault}')
                    self._keep(data, ending, command, fault)
                elif outcome.status < 0:
                    break      # it asks for long work; the next command would be asked for the same
        return said

    def _keep(self, data: bytes, ending: str, command: str, fault: str) -> None:
        kind = f'{command}: {fault[-120:]}'
        if kind in self.found:
            return
        self.out.mkdir(parents=True, exist_ok=True)
        file = self.out / f'{len(self.found):04d}_{command}{ending}'
        file.write_bytes(data)
        file.with_suffix('.txt').write_text(f'stepdiag {command} {file.name}\n{fault}\n', encoding='utf-8')
        self.found[kind] = str(file)
        print(f'FOUND {file}: {fault}', flush=True)

    def turn(self) -> None:
        """One input of each kind."""
        for kind in self.kinds:
            name = f'{self.seed}/{kind}/{self.turns}'
            if kind in wires.KINDS:
                self.try_wire(kind, name)
            else:
                self._file(kind, random.Random(name))
        self.turns += 1

    def try_wire(self, kind: str, name: str) -> None:
        """The attack on a kind of instrument that a seed names."""
        said = self.wires.turn(kind, random.Random(name))
        self.runs += 1
        for line in said:
            if line[-120:] not in self.found:
                self.found[line[-120:]] = name
                print(f'FOUND --kinds {kind} --again {name}: {line}', flush=True)

    def _file(self, kind: str, rng: random.Random) -> None:
        few = tuple(rng.sample(harness.COMMANDS, 2))
        if kind == 'bag':
            self.try_file(bags.mutated(rng.choice(list(self.sound.values())), rng), '.mcap', few, 'mutated bag')
        elif kind == 'log':
            self.try_file(inputs.odd_log(rng, self.sound[rng.choice(('diagonals', 'ways'))]), '.mcap', few, 'odd log')
        elif kind == 'cell':
            text = inputs.odd_yaml(rng, rng.choice((bags.CELL, bags.WAYS)))
            self.try_file(text.encode('utf-8', 'surrogatepass'), '.yaml', ('simulate shown', 'simulate'), 'cell')
        elif kind == 'effect':
            self.try_file(inputs.odd_effect(rng).encode('utf-8', 'surrogatepass'), '.py',
                          (rng.choice(harness.EFFECT_COMMANDS),), 'effect file')
        elif kind == 'truth':
            self.try_file(wires.odd_json(self.beside[kind].encode(), rng), '.json', (kind,), 'known errors')
        elif kind == 'budget':
            self.try_file(inputs.odd_yaml(rng, self.beside[kind]).encode('utf-8', 'surrogatepass'), '.yaml', (kind,), 'budget')
        else:
            self.try_file(inputs.odd_table(rng).encode('utf-8', 'surrogatepass'), '_x.csv', ('import',), 'table')

    def close(self) -> None:
        if self.wires is not None:
            self.wires.__exit__()
        self._folder.cleanup()


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--seconds', type=float, default=60.0, help='how long (default: 60)')
    parser.add_argument('--seed', type=int, default=None, help='what is drawn (default: another each time)')
    parser.add_argument('--kinds', nargs='+', choices=KINDS, default=KINDS, help='of inputs (default: all)')
    parser.add_argument('--out', type=Path, default=Path('build/fuzz'), help='where findings go (default: build/fuzz)')
    parser.add_argument('--attacks', action='store_true', help='the ready-made attacks alone')
    parser.add_argument('--again', metavar='SEED', help='one attack on a wire that was found, by the seed that was printed')
    given = parser.parse_args()
    seed = random.SystemRandom().randrange(1 << 32) if given.seed is None else given.seed
    print(f'seed {seed}, {given.seconds:g} s, {", ".join(given.kinds)}', flush=True)
    fuzzer, end = Fuzzer(seed, given.out, tuple(given.kinds)), time.monotonic() + given.seconds
    try:
        if given.attacks:
            for name, make in bags.attacks().items():
                fuzzer.try_file(make(), '.mcap', ('info', 'recover', 'evaluate', 'report'), name)
        elif given.again:
            fuzzer.try_wire(given.again.split('/')[1], given.again)
        else:
            while time.monotonic() < end:
                fuzzer.turn()
    finally:
        fuzzer.close()
    by_status = ', '.join(f'{count} with status {status}' for status, count in sorted(fuzzer.statuses.items()))
    print(f'{fuzzer.turns} turns, {fuzzer.runs} runs ({by_status}), {len(fuzzer.found)} findings')
    return 1 if fuzzer.found else 0


if __name__ == '__main__':
    sys.exit(main())
