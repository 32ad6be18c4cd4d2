"""Lays both packages side by side into a ROS workspace: `make ros-workspace WS=/path/to/ws`.

ROS allows no package inside another: colcon, rosdep and bloom stop at the first package.xml and do not find
msg_defs/ below it.  In WS/src they are next to each other, as links to this checkout or, with --copy, as files
of their own (bloom wants a repository that holds them so).
"""

import argparse
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = {'stepdiag_ros': ROOT, 'stepdiag_msgs': ROOT / 'msg_defs'}


def lay(workspace: Path, copy: bool) -> list[Path]:
    """Put the packages into ``workspace``/src; where they are.  SystemExit says what is in the way."""
    source = workspace / 'src'
    source.mkdir(parents=True, exist_ok=True)
    places = []
    for name, package in PACKAGES.items():
        place = source / name
        if place.resolve() == package:
            places.append(place)   # this checkout stands in the workspace, or it was laid there before
            continue
        if place.exists() or place.is_symlink():
            raise SystemExit(f'ros-workspace: {place} is there already and is no link to {package}; move it away')
        if ROOT.is_relative_to(source.resolve()) and name == 'stepdiag_ros':
            places.append(ROOT)
            continue
        if copy:
            copy_tracked(package, place)
        else:
            place.symlink_to(package, target_is_directory=True)
        places.append(place)
    return places


def copy_tracked(package: Path, place: Path) -> None:
    """Copy the files that git knows; the messages package is next to the other, not in it."""
    known = subprocess.run(['git', 'ls-files', '-z', '--cached', '--others', '--exclude-standard', '.'],
                           cwd=package, capture_output=True, check=True)
    for name in filter(None, known.stdout.decode().split('\0')):
        if package == ROOT and name.startswith('msg_defs/') or not (package / name).is_file():
            continue
        (place / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(package / name, place / name)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('workspace', type=Path, help='folder of the workspace; made if it is not there')
    parser.add_argument('--copy', action='store_true', help='copy the files instead of linking them')
    given = parser.parse_args()
    for place in lay(given.workspace.absolute(), given.copy):
        print(place)
    print(f'build with: cd {given.workspace} && rosdep install --from-paths src -y --ignore-src && colcon build')
    return 0


if __name__ == '__main__':
    sys.exit(main())
