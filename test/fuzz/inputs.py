"""Structured inputs for the fuzzer: logs, cell files and tables that are nearly right.

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
