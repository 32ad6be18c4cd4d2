"""Edits of LinuxCNC's INI files that leave every other line as it is."""

import re

SECTION = re.compile(r'\s*\[(\w+)\]')


def get(text: str, section: str, key: str) -> list[str]:
    """All values of a key in a section, in their order."""
    inside, found = False, []
    for line in text.splitlines():
        head = SECTION.match(line)
        if head:
            inside = head.group(1) == section
        elif inside and (pair := re.match(rf'\s*{re.escape(key)}\s*=\s*(.*?)\s*$', line)):
            found.append(pair.group(1))
    return found


def put(text: str, section: str, key: str, values: list[str]) -> str:
    """The text with exactly these values of a key in a section; no values: the key is taken out.

    A section that is not there is added at the end.
    """
    lines, done, inside = [], False, False
    fresh = [f'{key} = {value}' for value in values]
    for line in text.splitlines():
        head = SECTION.match(line)
        if head:
            inside = head.group(1) == section
            lines.append(line)
            if inside and not done and not get(text, section, key):
                lines += fresh
                done = True
            continue
        if inside and re.match(rf'\s*{re.escape(key)}\s*=', line):
            if not done:
                lines += fresh
                done = True
            continue
        lines.append(line)
    if not done and fresh:
        lines += [f'[{section}]', *fresh]
    return '\n'.join(lines) + '\n'
