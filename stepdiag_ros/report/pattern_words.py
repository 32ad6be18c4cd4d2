"""What has no name in plain words, from the label of its form: who it is, what it does, what it follows."""

import re

WHO = {
    'displacement': 'the laser length', 'spot': 'the spot', 'spot_x': 'the spot in x', 'spot_y': 'the spot in y',
    'tool point': 'the tool point', 'beam': "the laser beam's direction", 'mirror': "the mirror's attitude",
    'tool': 'the tool', 'length': 'the unit of length', 'X': "X's position", 'Y': "Y's position", 'Z': "Z's position",
    'the machine on its feet': 'the machine on its feet', 'what X carries': 'what X carries',
    'what Y carries': 'what Y carries', 'what Z carries': 'what Z carries', 'the description': 'in the description'}
DOES = {'turned and shifted': 'turns and shifts', 'turned': 'turns', 'shifted': 'shifts', 'off': 'shifts',
        'stretched': 'is stretched'}
FOLLOWS = (
    (r'by the place of ([XYZ])', 'with where {0} stands'),
    (r'by the place of ([XYZ]), bent', 'with where {0} stands, not in proportion'),
    (r'by the length of the path', "with the length of the laser's path"),
    (r'by the length of the path, bent', "with the length of the laser's path, not in proportion"),
    (r'by the length of the path, otherwise in each setup', "with the length of the laser's path, otherwise in each "
     'setup'),
    (r'by the direction of ([XYZ])', 'with the direction in which {0} moves'),
    (r'by the direction of ([XYZ]), by place', 'with the direction in which {0} moves, by place'),
    (r'by the direction of ([XYZ]) at each place', 'with the direction in which {0} moves, otherwise at each place'),
    (r'by the direction of ([XYZ]) along ([XYZ])', 'with the direction in which {0} moves, otherwise along {1}'),
    (r'by which axis moved last', 'with which axis moved last'),
    (r'by the last move, each axis in its direction', 'with which axis moved last and in which direction'),
    (r'by the last move, fading with (\S+) s', 'with each move, fading in {0} s'),
    (r'by where ([XYZ]) stood before, over (\S+) s', 'with where {0} stood before, over some {1} s'),
    (r'and on as the spot wanders (\S+) mm along (\S+)', 'off and on as the spot wanders {0} mm along {1}'),
)
DEEDS = (
    (r'places by direction in (\w+)', 'belongs to places along {0}, and is opposite forward and backward'),
    (r'places in (\w+)', 'belongs to places along {0}, the same in every run'),
    (r'places by direction', 'belongs to places, opposite forward and backward, in all setups'),
    (r'places', 'belongs to places, the same in every run and setup'),
    (r'slow shape along (\w+)', 'bends slowly along {0}'),
    (r'slow shape by direction', 'bends slowly along the travel and is opposite forward and backward'),
    (r'drift inside the runs', 'drifts inside each run, every run in its own way'),
    (r'ramp inside the runs', 'runs away steadily inside each run, every run in its own way'),
    (r'slow in time in (\w+)', 'changes slowly with time in setup {0}'),
    (r'slow in time', 'changes slowly with time, over the whole log'),
    (r'wandering inside the runs', 'wanders inside each run'),
    (r'wandering in time', 'wanders with time'),
    (r'one stop, (\S+) stop (\d+)', 'is off at a single stop (run {0}, stop {1})'),
    (r'jump at (\S+) stop (\d+)', 'jumps once (run {0}, stop {1}) and stays there'),
    (r'inside the dwells, (.*)', 'moves while the machine stands still at a stop ({0})'),
    (r'bent beyond (\d+) % of the range', 'is bent beyond {0} % of its range'),
    (r'bent over the range', 'is bent over its range'),
    (r"follows the spot's distance, (.*)", "follows how far the spot lies from the detector's middle ({0})"),
    (r'follows the spot at (\S+), saturating at (.*)', 'follows the spot along {0}, up to some {1}'),
    (r'follows the (\w+), saturating at (.*)', 'follows the {0}, up to some {1}'),
    (r'follows spot', 'follows the spot'),
    (r'follows spot, (\w+)', 'follows the spot, {0}'),
    (r'follows distance, (\w+)', 'follows the distance, {0}'),
    (r'follows axis that moved', 'follows which axis moved'),
    (r'another unit from (\S+) stop (\d+) on', 'is another one from run {0}, stop {1} on'),
    (r'another unit in each run', 'is another one in each run'),
    (r'another gain (above|below) (\w) = 0', 'is read with another gain {0} {1} = 0'),
    (r'the axes of the detector are not square(.*)', 'is read along axes that are not square{0}'),
    (r'in part what was seen before, fading with (\S+) s', 'is in part where it was before, fading in {0} s'),
    (r'rings after each move at (.*), τ = (.*)', 'rings after each move at {0}, fading in {1}'),
    (r'rings after the moves of each axis at (.*), τ = (.*)', 'rings after the moves of each axis at {0}, fading in '
     '{1}'),
    (r'the standoff of (.*) is off', 'the standoff of {0} is off'),
)


def pattern_words(label: str) -> str:
    """What an unexplained pattern looks like, from the label of the diagnosis."""
    who, colon, rest = label.partition(': ')
    if colon and who in WHO:
        said = _matched(DEEDS, rest) or _does(rest)
        if said:
            return f'{WHO[who]} {said}'
    return _error_motion(label) or _alike(label) or (f'{who}: {pattern_words(rest)}' if colon else label)


def _matched(rules: tuple[tuple[str, str], ...], text: str) -> str:
    for pattern, words in rules:
        match = re.fullmatch(pattern, text)
        if match:
            return words.format(*match.groups())
    return ''


def _does(rest: str) -> str:
    """What is done and what it follows; '' of anything else."""
    for how, does in DOES.items():
        if rest.startswith(f'{how}, '):
            return f'{does} with time ({rest[len(how) + 2:]})'
        follows = _matched(FOLLOWS, rest[len(how) + 1:]) if rest.startswith(f'{how} ') else ''
        if follows:
            return f'{does} {follows}'
    return ''


def _error_motion(label: str) -> str:
    """An error motion that changes; '' of anything else."""
    match = re.fullmatch(r'E([XYZABC])([XYZ]) (changes its shape|has another shape in each run)(.*)', label)
    if not match:
        return ''
    motion, axis, changes, tail = match.groups()
    turns = {'A': 'X', 'B': 'Y', 'C': 'Z'}
    who = f'the carriage of {axis} turns about {turns[motion]}' if motion in turns else \
        f'{axis} is off along itself' if motion == axis else f'the guideway of {axis}'
    shape = re.fullmatch(r', (slope|bow|S), (.*)', tail)
    if shape:
        form = {'slope': 'in proportion to the place', 'bow': 'as a bow', 'S': 'as an S'}[shape[1]]
        tail = f', {form}; {shape[2]}'
    in_time = changes.startswith('changes')
    told = f'with time ({tail[2:]})' if in_time else 'otherwise in each run'
    if motion in turns or motion == axis:
        return f'{who}, by its place {"and " if in_time else ""}{told}'
    return f'{who} changes its shape in {motion} {told}'


def _alike(label: str) -> str:
    match = re.fullmatch(r'(.*): not alike from (.*) to \2', label)
    return f'a known pattern ({match[1]}) whose size differs from {match[2]} to {match[2]}' if match else ''
