"""What a path means: a rosbag2 directory or a bare ``.mcap``; which files, what metadata says."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from stepdiag_ros.errors import StepdiagError

METADATA = 'metadata.yaml'
#: libyaml's loader where PyYAML was built with it: ten times as fast.
_Loader = getattr(yaml, 'CSafeLoader', yaml.SafeLoader)


@dataclass(frozen=True)
class BagSource:
    """Files of a bag in order of recording, and its ``metadata.yaml``.

    ``counts``: messages by topic as the metadata claims, ``None`` without metadata;
    ``warnings``: what is odd about the bag as a directory.
    """

    path: Path
    files: tuple[Path, ...]
    counts: dict[str, int] | None = None
    warnings: tuple[str, ...] = ()
    metadata: dict[str, Any] = field(default_factory=dict)


def open_bag(path: str | Path) -> BagSource:
    """Resolve ``path``; :class:`StepdiagError` if there is no bag."""
    path = Path(path)
    if not path.exists():
        raise StepdiagError(f'{path}: does not exist; give a rosbag2 directory or a .mcap file')
    if path.is_file():
        if path.name == METADATA:
            return open_bag(path.parent)
        return BagSource(path, (path,))
    present = tuple(sorted(path.glob('*.mcap')))
    file = path / METADATA
    if not file.exists():
        if not present:
            others = sorted(p.name for p in path.iterdir())[:3]
            raise StepdiagError(f'{path}: holds neither {METADATA} nor a .mcap file'
                                + (f' (it holds {", ".join(others)})' if others else '; it is empty'))
        return BagSource(path, present, warnings=(
            f'{METADATA} is missing; reading {len(present)} .mcap file(s) by name; '
            'stepdiag recover writes a new one',))
    return _from_metadata(path, file, present)


def _from_metadata(path: Path, file: Path, present: tuple[Path, ...]) -> BagSource:
    try:
        info = yaml.load(file.read_text(encoding='utf-8'), _Loader)['rosbag2_bagfile_information']
        storage = str(info.get('storage_identifier', 'mcap'))
        listed = [str(name) for name in info.get('relative_file_paths') or []]
        counts = {str(entry['topic_metadata']['name']): int(entry['message_count'])
                  for entry in info.get('topics_with_message_count') or []}
    except (yaml.YAMLError, UnicodeDecodeError, KeyError, TypeError, ValueError, AttributeError) as error:
        if not present:
            raise StepdiagError(f'{file}: cannot be read as rosbag2 metadata ({error!r}) and there '
                                'is no .mcap file beside it') from None
        return BagSource(path, present, warnings=(
            f'{METADATA} cannot be read as rosbag2 metadata; reading the .mcap files by name',))
    if storage != 'mcap':
        raise StepdiagError(f'{path}: is stored as {storage}, this program reads mcap; convert it: '
                            f'ros2 bag convert -i {path} -o out.yaml with storage_id: mcap')
    packed = [name for name in listed if not name.endswith('.mcap')]
    if packed:
        raise StepdiagError(f'{path}: {packed[0]} is compressed as a whole file; unpack it and take '
                            f'the ending off in {METADATA}')
    if str(info.get('compression_mode') or '').lower() == 'message':
        raise StepdiagError(f'{path}: its messages are compressed one by one; convert it: '
                            f'ros2 bag convert -i {path} -o out.yaml without compression_mode')
    files = tuple(path / name for name in listed)
    absent = [f.name for f in files if not f.exists()]
    if absent and len(absent) < len(files):
        raise StepdiagError(f'{path}: {METADATA} names {", ".join(absent)}, which is missing')
    warnings = []
    if absent or not files:
        if not present:
            raise StepdiagError(f'{path}: {METADATA} names {", ".join(absent) or "no file"} and there '
                                'is no .mcap file beside it')
        warnings.append(f'{METADATA} names {", ".join(absent) or "no file"}, which is not there; '
                        f'reading {", ".join(f.name for f in present)} instead')
        files = present
    extra = sorted({f.name for f in present} - {f.name for f in files})
    if extra:
        warnings.append(f'{", ".join(extra)} is not named in {METADATA} and was not read')
    return BagSource(path, files, counts, tuple(warnings), info)
