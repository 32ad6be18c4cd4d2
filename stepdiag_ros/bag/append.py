"""Going on in a bag whose recorder has ended: what it holds is mended and kept, a further file is begun.

A rosbag2 directory may hold several files, read one after the other.  The file that a killed recorder
left torn is mended in place; the torn one stays beside it under the ending ``.torn``.
"""

import os
import shutil
import tempfile
from dataclasses import dataclass
from pathlib import Path

from stepdiag_ros.bag.recover import recover
from stepdiag_ros.bag.scan import MAGIC
from stepdiag_ros.bag.source import open_bag
from stepdiag_ros.bag.tables import collect
from stepdiag_ros.bag.writer import BagWriter, Earlier, EarlierTopic
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.guard import strict_yaml


@dataclass(frozen=True)
class Continued:
    """``writer`` into the bag's next file, ``received`` messages by topic before, names of files ``mended``."""

    writer: BagWriter
    received: dict[str, int]
    mended: tuple[str, ...]


def go_on(path: Path, compression: str = 'zstd') -> Continued:
    """Open an existing bag for further messages; :class:`StepdiagError` if it cannot be mended."""
    files = sorted(path.glob('*.mcap'), key=lambda file: (len(file.name), file.name))
    if not files:
        raise StepdiagError(f'{path}: holds no .mcap file; name a bag that holds one, or a new one')
    mended, kept = [], []
    for file in files:
        if not _whole(file):
            if not _mend(file):
                continue   # it ended before anything was written
            mended.append(file.name)
        kept.append(file)
    topics: dict[str, EarlierTopic] = {}
    spans = []
    for file in kept:
        tables = collect(open_bag(file), lambda topic: False)
        times = [t for table in tables.topics.values() for t in table.log_times if len(t)]
        spans.append((file.name, int(min(t.min() for t in times)) if times else 0,
                      int(max(t.max() for t in times)) if times else 0,
                      sum(table.count for table in tables.topics.values())))
        for name, table in tables.topics.items():
            before = topics.get(name)
            topics[name] = EarlierTopic(
                table.type, strict_yaml.load(table.metadata.get('offered_qos_profiles', '') or '[]', table.topic) or [],
                table.metadata.get('topic_type_hash', ''), table.count + (before.count if before else 0))
    number = 1 + max((int(f.stem.rsplit('_', 1)[-1]) for f in files if f.stem.rsplit('_', 1)[-1].isdigit()), default=0)
    writer = BagWriter(path, compression=compression, earlier=Earlier(number, tuple(spans), topics))
    return Continued(writer, {name: topic.count for name, topic in topics.items()}, tuple(mended))


def _whole(file: Path) -> bool:
    """Whether a file was closed in order: it ends in MCAP's magic bytes."""
    with open(file, 'rb') as stream:
        stream.seek(0, os.SEEK_END)
        if stream.tell() < 2 * len(MAGIC):
            return False
        stream.seek(-len(MAGIC), os.SEEK_END)
        return stream.read() == MAGIC


def _mend(file: Path) -> bool:
    """Replace a torn file by what can be read of it; ``False`` if that is nothing."""
    with tempfile.TemporaryDirectory(prefix='.mending_', dir=file.parent) as folder:
        target = Path(folder) / file.stem.rsplit('_', 1)[0]
        try:
            recover(file, target)
        except StepdiagError:
            shutil.move(file, file.with_name(f'{file.name}.torn'))
            return False
        shutil.move(file, file.with_name(f'{file.name}.torn'))
        shutil.move(next(target.glob('*.mcap')), file)
    return True
