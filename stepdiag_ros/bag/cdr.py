"""CDR to arrays, many messages at once.

Messages of one type and one length nearly always have the same layout.  They
are laid under each other as a byte matrix, one row a message, and every field is
one strided view of its columns.  Where a string or a sequence has another length
in some rows the matrix is split, so the cost is per layout and not per message.

The alignment rules are those of OMG DDS-XTypes 1.3, 7.4.1 (XCDR1, alignment up to
8) and 7.4.2 (XCDR2, up to 4), either byte order, counted from the end of the
four-byte encapsulation header.
"""

from dataclasses import dataclass

import numpy as np

from stepdiag_ros.bag.msgdef import SEQUENCE, SIZES, UNSUPPORTED, Field
from stepdiag_ros.guard import limits

#: Representation identifier -> (byte order, greatest alignment).
REPRESENTATIONS = {0x0000: ('>', 8), 0x0001: ('<', 8),
                   0x0006: ('>', 4), 0x0007: ('<', 4),    # PLAIN_CDR2 of XTypes
                   0x0010: ('>', 4), 0x0011: ('<', 4)}    # the same as RTPS vendors send it
ENCAPSULATION = 4

_CODES = {'bool': 'u1', 'byte': 'u1', 'char': 'u1', 'int8': 'i1', 'uint8': 'u1', 'int16': 'i2',
          'uint16': 'u2', 'int32': 'i4', 'uint32': 'u4', 'float32': 'f4', 'int64': 'i8',
          'uint64': 'u8', 'float64': 'f8'}


@dataclass(frozen=True)
class Decoded:
    """Messages of one layout: ``rows`` (n,) of the matrix; ``values`` by field path.

    A scalar is (n,), a sequence of k elements (n, k), a string (n,) of bytes.
    """

    rows: np.ndarray
    values: dict[str, np.ndarray]


def decode(matrix: np.ndarray, fields: tuple[Field, ...],
           wanted: frozenset[str]) -> tuple[list[Decoded], np.ndarray]:
    """Decode the rows of ``matrix`` (n, length) uint8, encapsulation header first.

    Returns the layouts found and the rows (m,) that do not hold their type.
    Nothing beyond the last of the ``wanted`` field paths is looked at.
    """
    last = max(i for i, field in enumerate(fields) if field.path in wanted)
    fields = fields[:last + 1]
    done: list[Decoded] = []
    bad: list[np.ndarray] = []
    if matrix.shape[1] < ENCAPSULATION:
        return done, np.arange(len(matrix))
    identifier = matrix[:, 0].astype(np.uint16) << 8 | matrix[:, 1]
    known = np.isin(identifier, list(REPRESENTATIONS))
    if not known.all():
        bad.append(np.flatnonzero(~known))
    for value, rows in alike(identifier):
        if value not in REPRESENTATIONS:
            continue
        order, greatest = REPRESENTATIONS[value]
        _decode_rows(matrix, rows, fields, wanted, order, greatest, done, bad)
    return done, np.sort(np.concatenate(bad)) if bad else np.zeros(0, np.intp)


def _decode_rows(matrix: np.ndarray, rows: np.ndarray, fields: tuple[Field, ...],
                 wanted: frozenset[str], order: str, greatest: int,
                 done: list[Decoded], bad: list[np.ndarray]) -> None:
    """Walk the fields for ``rows``; a stack holds the groups still to be finished."""
    length = matrix.shape[1]
    whole = len(rows) == len(matrix)
    stack: list[tuple[np.ndarray, int, int, dict[str, np.ndarray]]] = [(rows, ENCAPSULATION, 0, {})]
    while stack:
        rows, position, start, values = stack.pop()
        body = matrix if whole and len(rows) == len(matrix) else matrix[rows]
        for number in range(start, len(fields)):
            field = fields[number]
            if field.kind == UNSUPPORTED:
                bad.append(rows)
                break
            count = 1 if field.array is None else field.array
            if field.kind == 'string' or field.array == SEQUENCE:
                position = _align(position, 4, greatest)
                if position + 4 > length:
                    bad.append(rows)
                    break
                counts = body[:, position:position + 4].view(order + 'u4')[:, 0]
                count = int(counts[0])
                if not (counts == count).all():
                    stack += _split(rows, counts, position, number, values)
                    break
                position += 4
                if field.kind == 'string' and count > _longest(field.path):
                    bad.append(rows)
                    break
            size = 1 if field.kind == 'string' else SIZES[field.kind]
            if count:
                position = _align(position, size, greatest)
            end = position + size * count
            if end > length:
                bad.append(rows)
                break
            if field.path in wanted:
                values[field.path] = _columns(body, position, end, field, order)
            position = end
        else:
            done.append(Decoded(rows, values))


def _longest(path: str) -> int:
    """Bytes that a text may have: a document, or a name."""
    return limits.YAML_BYTES if path == 'data' else 4 * limits.NAME_LETTERS


def alike(values: np.ndarray) -> list[tuple[int, np.ndarray]]:
    """Each distinct value of an integer array (n,), and where it stands, in rising order."""
    order = np.argsort(values, kind='stable')
    kept = values[order]
    starts = np.flatnonzero(np.concatenate([[True], kept[1:] != kept[:-1]])) if len(kept) else np.zeros(0, np.intp)
    return [(int(kept[start]), rows) for start, rows in
            zip(starts, np.split(order, starts[1:]) if len(starts) else [], strict=True)]


def _split(rows: np.ndarray, counts: np.ndarray, position: int, number: int,
           values: dict[str, np.ndarray]) -> list[tuple]:
    """One entry of the stack for each count that occurs."""
    parts = []
    for _, some in alike(counts):
        parts.append((rows[some], position, number, {k: v[some] for k, v in values.items()}))
    return parts


def _align(position: int, size: int, greatest: int) -> int:
    step = min(size, greatest)
    return position + (ENCAPSULATION - position) % step


def _columns(body: np.ndarray, start: int, end: int, field: Field, order: str) -> np.ndarray:
    """View of the bytes ``start:end`` of every row as the field's values."""
    if field.kind == 'string':
        if end == start:
            return np.zeros(len(body), 'S1')
        return body[:, start:end].view(f'S{end - start}')[:, 0]
    if end == start:
        return np.zeros((len(body), 0), _CODES[field.kind])
    columns = body[:, start:end].view(order + _CODES[field.kind])
    return columns if field.array is not None else columns[:, 0]
