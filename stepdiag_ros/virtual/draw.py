"""Random numbers that depend on what they are for, not on when they are asked for.

Every draw is addressed by (seed, stream name, index): the counter of a Philox
generator is the index, its key a hash of seed and name.  Sensors, controller and
offline simulation thus agree on the draws of arrival 17 or sample 40 000 whatever
the order, the process or the block size in which they ask.  numpy's own ``normal``
uses a varying number of raw words for one value and so cannot be addressed;
Box and Muller's transform uses exactly two.
"""

import hashlib
from functools import lru_cache

import numpy as np

_WORDS = 4   # a Philox4x64 block


@lru_cache(maxsize=256)
def _key(seed: int, stream: str) -> tuple[int, int]:
    digest = hashlib.sha256(f'{seed}/{stream}'.encode()).digest()
    return int.from_bytes(digest[:8], 'little'), int.from_bytes(digest[8:16], 'little')


def uniforms(seed: int, stream: str, first: int, count: int, columns: int = 1) -> np.ndarray:
    """(count, columns) numbers in (0, 1) for the indices ``first … first + count - 1``."""
    blocks = -(-columns // _WORDS)
    generator = np.random.Philox(key=np.array(_key(seed, stream), np.uint64),
                                 counter=first * blocks)
    raw = generator.random_raw(count * blocks * _WORDS).reshape(count, blocks * _WORDS)
    return ((raw[:, :columns] >> np.uint64(11)).astype(float) + 0.5) * 2.0 ** -53


def normals(seed: int, stream: str, first: int, count: int, columns: int = 1) -> np.ndarray:
    """(count, columns) standard normal numbers for the indices ``first … first + count - 1``."""
    even = columns + columns % 2
    flat = uniforms(seed, stream, first, count, even)
    radius = np.sqrt(-2.0 * np.log(flat[:, 0::2]))
    angle = 2.0 * np.pi * flat[:, 1::2]
    pair = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1)
    return pair.reshape(count, even)[:, :columns]
