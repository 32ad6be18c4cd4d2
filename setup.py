"""Installs stepdiag_ros, by colcon as an ament_python package and by pip alike.

The version stands in package.xml, which ROS tools read, and nowhere else here.
"""

from glob import glob
from pathlib import Path
from xml.etree import ElementTree

from setuptools import find_packages, setup

NAME = 'stepdiag_ros'
NODES = (
    'interferometer_driver',
    'psd_driver',
    'step_sequencer',
    'evaluation_solver',
    'recorder',
    'gap_monitor',
    'multiplexer',
    'bringup',
)

# From the oldest that `make test-floor` passes with (requirements/floor.txt) to before the next major version after
# those of requirements/run.txt; pymodbus changes what it offers with each minor one.
REQUIRES = (
    'numpy>=1.26.4,<3',
    'scipy>=1.11.4,<2',
    'PyYAML>=6.0.1,<7',
    'mcap>=1.5.0,<2',
)
EXTRAS = {'pictures': ['matplotlib>=3.6.3,<4'], 'compression': ['zstandard>=0.22.0,<1', 'lz4>=4.0.2,<5'],
          'instruments': ['pymodbus>=3.6.3,<3.17'],
          'web': ['starlette>=0.31.1,<2', 'uvicorn>=0.27.1,<1', 'wsproto>=1.2.0,<2']}

manifest = ElementTree.parse(Path(__file__).with_name('package.xml')).getroot()

setup(
    name=NAME,
    version=manifest.findtext('version'),
    description=manifest.findtext('description'),
    license=manifest.findtext('license'),
    maintainer=manifest.findtext('maintainer'),
    maintainer_email=manifest.find('maintainer').get('email'),
    packages=find_packages(include=[NAME, f'{NAME}.*']),
    package_data={NAME: ['py.typed', *(f'**/*.{kind}' for kind in ('yaml', 'html', 'css', 'js', 'svg', 'xml', 'c', 'h',
                                                                   'hal'))]},
    python_requires='>=3.11',
    # ROS 2 itself and stepdiag_msgs come with colcon or by `make setup`; reading and evaluating needs neither.
    install_requires=list(REQUIRES),
    extras_require=EXTRAS | {'all': sorted({name for names in EXTRAS.values() for name in names})},
    zip_safe=False,
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{NAME}']),
        (f'share/{NAME}', ['package.xml']),
        (f'share/{NAME}/launch', sorted(glob('launch/*.launch.py'))),
        (f'share/{NAME}/cells', sorted(glob('cells/*.yaml'))),
        (f'share/{NAME}/layouts', sorted(glob('layouts/*'))),
    ],
    entry_points={
        'console_scripts': [
            f'stepdiag = {NAME}.cli.main:main',
            *(f'{node} = {NAME}.start:{node}' for node in NODES),
        ],
        f'{NAME}.interferometers': [f'ids3010 = {NAME}.devices.ids3010:from_settings'],
        f'{NAME}.position_sensors': [f'modbus = {NAME}.devices.modbus_psd:from_settings'],
        f'{NAME}.controls': [f'linuxcnc_rsh = {NAME}.devices.linuxcnc_rsh:from_settings'],
    },
)
