"""What a path means: a rosbag2 directory or a bare ``.mcap``; which files, what metadata says."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.guard import limits, strict_yaml
from stepdiag_ros.guard.files import open_regular, read_text

METADATA = 'metadata.yaml'


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
    if '\0' in str(path) or not path.exists():
        raise StepdiagError(f'{path}: does not exist; give a rosbag2 directory or a .mcap file')
    if not path.is_dir():
        open_regular(path).close()
        return open_bag(path.parent) if path.name == METADATA else BagSource(path, (path,))
    try:
        present = tuple(sorted(file for file in path.glob('*.mcap') if file.is_file()))
    except OSError as error:
        raise StepdiagError(f'{path}: cannot be read: {error.strerror}') from None
    if len(present) > limits.BAG_FILES:
        raise StepdiagError(f'{path}: holds {len(present)} .mcap files; a bag has at most {limits.BAG_FILES}')
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
    text = read_text(file, limits.YAML_BYTES, 'rosbag2 metadata file')
    try:
        info = strict_yaml.load(text, str(file))['rosbag2_bagfile_information']
        storage = str(info.get('storage_identifier', 'mcap'))
        listed = [str(name) for name in info.get('relative_file_paths') or []]
        counts = {str(entry['topic_metadata']['name']): int(entry['message_count'])
                  for entry in info.get('topics_with_message_count') or []}
    except (StepdiagError, KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        if not present:
            raise StepdiagError(f'{file}: cannot be read as rosbag2 metadata ({error}) and there '
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
    outside = [name for name in listed if Path(name).is_absolute() or '..' in Path(name).parts or '\0' in name]
    if outside or len(listed) > limits.BAG_FILES or len(set(listed)) != len(listed):
        what = f'the file {outside[0]!r}, which is not below it' if outside else \
            f'{len(listed)} files' if len(listed) > limits.BAG_FILES else 'a file twice'
        raise StepdiagError(f'{path}: {METADATA} names {what}; mend it with: stepdiag recover {path}')
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
