"""Structured inputs for the fuzzer: logs, cell files, effect files and tables that are nearly right.

Each function takes a :class:`random.Random`, so that a seed names an input for good.
"""

import random
import re
import struct

import bags

#: Values that somebody may write where a number, a name or a list belongs.
ODD = ('0', '-1', '1', '2', '201', '1000000', '1e300', '-1e300', '1.0e+300', '5e-324', '.inf', '-.inf', '.nan', 'true', 'null',
       '2020-01-01', '12:30:00', '9' * 400, '0x' + 'f' * 300, '""', '[]', '{}', '[1]', '[[1]]', '[0.1, 0.2, 0.3]',
       '{a: 1}', '"\\e[31m"', '"\\0"', '&a x', '*a', '!!binary aa', '!!set {a}', '<b>', '"$\\\\frac{$"', '~', '-0.0', '0.1',
       '1e-12', '99', 'ppp', 'XYZ', 'ZZZ', '"' + 'x' * 500 + '"')
NUMBERS = (0.0, -0.0, 1e-9, -1e-6, 1.0, 1e3, 1e9, 1e150, 1e300, -1e300, 5e-324, float('inf'), float('-inf'), float('nan'))


def odd_yaml(rng: random.Random, text: str) -> str:
    """A YAML text of ours with one to four values exchanged, or a line gone or doubled."""
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        how = rng.random()
        places = list(re.finditer(r'(?<=[:\[,] )[^\s,{}\[\]]+|(?<=\[)[^\s,{}\[\]]+', text))
        if how < 0.7 and places:
            place = rng.choice(places)
            text = text[:place.start()] + rng.choice(ODD) + text[place.end():]
        elif how < 0.9:
            lines = text.splitlines()
            at = rng.randrange(len(lines))
            lines[at:at + 1] = rng.choice(([], [lines[at]] * 2, [lines[at][:rng.randrange(len(lines[at]) + 1)]],
                                           [lines[at] + rng.choice(ODD)], [' ' + lines[at]]))
            text = '\n'.join(lines) + '\n'
        else:
            at = rng.randrange(len(text))
            text = text[:at] + rng.choice(('\x00', '\ud800', '&', '*', '{', '[', '\t', ': ', '\n', 'é', '\x1b')) + text[at:]
    return text


def odd_table(rng: random.Random) -> str:
    """A CSV of a positioning test with something odd in it."""
    head = rng.choice(('cycle,direction,target_mm,measured_mm', 'target_mm,deviation_um', 'time_s,target_m,measured_m',
                       'target_mm;measured_mm', 'target_mm,measured_mm,target_mm', 'target,measured', 'target_km,measured_mm'))
    width = len(re.split('[,;]', head))
    mark = ';' if ';' in head else ','
    rows = [[f'{k if name.startswith(("target", "measured", "time")) else 1}' for name in re.split('[,;]', head)]
            for k in range(rng.choice((0, 1, 2, 3, 10)))]
    for _ in range(rng.choice((0, 1, 3))):
        if rows:
            rows[rng.randrange(len(rows))][rng.randrange(width)] = rng.choice(
                (*ODD, *map(str, NUMBERS), '1,2', '"1', '1e400', '0x10', '١', '1_000', ' 5 '))
    if rng.random() < 0.2 and rows:
        rows[-1].append('7')
    return head + '\n' + '\n'.join(mark.join(row) for row in rows) + rng.choice(('', '\n', '\r\n', '\x00', '\n#end'))


def odd_log(rng: random.Random, sound: bytes) -> bytes:
    """A sound bag with an odd description, or with odd numbers in many messages of one kind."""
    records = bags.unpacked(sound)
    channels = {struct.unpack_from('<H', body)[0]: body for kind, body in records if kind == bags.CHANNEL}
    if rng.random() < 0.5:
        number = next(n for n, body in channels.items() if b'cell_description' in body)
        for at, (kind, body) in enumerate(records):
            if kind == bags.MESSAGE and struct.unpack_from('<H', body)[0] == number:
                text = odd_yaml(rng, body[22 + 8:-1].decode()).encode('utf-8', 'surrogatepass')
                records[at] = kind, body[:22] + b'\x00\x01\x00\x00' + struct.pack('<I', len(text) + 1) + text + b'\x00'
        return bags.put_together(records)
    number = rng.choice(list(channels))
    share, special = rng.choice((0.02, 0.3, 1.0)), struct.pack('<d', rng.choice(NUMBERS))
    slot = rng.randrange(64)
    for at, (kind, body) in enumerate(records):
        if kind == bags.MESSAGE and struct.unpack_from('<H', body)[0] == number and rng.random() < share:
            place = 22 + 4 + 8 * (slot % max(1, (len(body) - 26) // 8))
            wide = rng.choice((1, 2, 4, 8))
            records[at] = kind, body[:place] + special[-wide:] + body[place + wide:]
    return bags.put_together(records)


#: An effect of somebody's own that uses every hook.
EFFECT = '''"""Everything that an effect may do."""

import numpy as np

from stepdiag_ros.effects.base import Effect, Form, Moment, Parameter, StopView
from stepdiag_ros.effects.patterns import follow, saturating
from stepdiag_ros.effects.timeforms import time_profiles


class Own(Effect):
    name = 'own'
    title = 'The tool grows, the spot is pulled.'
    short = 'tool growth'
    parameters = (Parameter('amp', 'm', 0.0, 5e-5, meaning='growth'),
                  Parameter('tau', 's', 5.0, 300.0, meaning='time constant'))
    remedy = 'Wait.'

    def before_pose(self, moment: Moment) -> None:
        grown = self.amp * saturating(moment.seconds, self.tau)
        moment.shift = moment.shift - grown[:, None] * np.array([0.0, 0.0, 1.0])

    def before_light(self, moment: Moment) -> None:
        moment.laser = moment.laser + 1e-9 * moment.rng.normals('turn', 0, len(moment.seconds), 2)

    def after_light(self, moment: Moment) -> None:
        moment.spot = moment.spot * 1.0

    def appearance(self, view: StopView) -> list[Form]:
        along_z = -view.by_shift[2:]
        return [follow(view, profile, along_z, ('growth',), 1e-5) for profile in time_profiles(view.elapsed)]
'''
#: What somebody may write where an expression belongs.
EXPRESSIONS = ('None', '0', '-1', '1e300', '10 ** 400', "float('nan')", 'np.nan', '[]', '()', '{}', "''", '1 / 0', 'np.zeros(3)',
               'np.zeros((0, 0))', 'np.full(7, np.nan)', 'moment', 'view', 'self', 'undefined', "'x' * 3", 'object()', 'np.array(1j)',
               '[None]', 'lambda *a: 1', 'Own', "np.array(['a'])", 'True')
STATEMENTS = ('raise ValueError("one\\ntwo")', 'raise KeyError', 'raise SystemExit(0)', 'return None', 'return 3', 'pass', 'import nothing',
              'raise StopIteration', 'del self', 'assert False', 'raise MemoryError', 'moment.spot = None', 'moment.shift = 1',
              'self.amp = None', 'raise BaseException("b")', 'view.reading[:] = 0', 'moment.seconds[:] = 0', 'yield 1')


def odd_effect(rng: random.Random) -> str:
    """An effect file with one to three expressions or statements exchanged, or letters spoilt."""
    text = EFFECT
    for _ in range(rng.choice((1, 1, 2, 3))):
        lines = text.splitlines()
        at = rng.randrange(len(lines))
        how = rng.random()
        if how < 0.5:     # not what is assigned to: whoever overwrites numpy has overwritten it
            places = list(re.finditer(r"[\w.]+\([^()]*\)|\d[\d.e-]*|'[^']*'|(?<=[=(, ])\w[\w.]*(?![\w.]| =)", text))
            place = rng.choice(places)
            text = text[:place.start()] + rng.choice(EXPRESSIONS) + text[place.end():]
        elif how < 0.8:
            indent = re.match(' *', lines[at])[0]
            lines[at] = indent + rng.choice(STATEMENTS)
            text = '\n'.join(lines) + '\n'
        elif how < 0.9:
            lines[at:at + 1] = rng.choice(([], [lines[at]] * 2, [' ' + lines[at]]))
            text = '\n'.join(lines) + '\n'
        else:
            at = rng.randrange(len(text))
            text = text[:at] + rng.choice(('\x00', '\ud800', '(', '"""', '\t', '\\', 'é', '\x1b')) + text[at:]
    return text
