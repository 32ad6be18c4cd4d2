"""From a cell file to the parameters of every node."""

from pathlib import Path

import pytest
import yaml

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.model.description import Description
from stepdiag_ros.nodes.graph import hardware_endpoints, namespace_of, write_graph
from stepdiag_ros.virtual.cell import parse_cell

CELL = """
schema: 1
machine: {name: hall 2, chain: FXYZ, volume: [0.2, 0.16, 0.12], tool: [0.0, 0.0, -0.1]}
plan: {steps: 2}
setups:
  ppp: {standoff: 0.2, psd_offset: [0.02, 0.0], beams: [[0.0, 0.0], [0.0, 0.03]]}
instruments:
  interferometer: {host: 10.0.0.5, port: 9090}
  psd: {host: 10.0.0.6, port: 502, stream_port: PORT, channels: [4, 5, 6, 7], length: 0.02}
  cnc: {host: 10.0.0.7, port: 5007}
sampling: {interferometer: 2000.0, psd: 1000.0, block: 0.1}
"""
ENDPOINTS = {'interferometer': {'host': '127.0.0.1', 'port': 4001},
             'psd': {'host': '127.0.0.1', 'port': 4002, 'stream_port': 4003},
             'cnc': {'host': '127.0.0.1', 'port': 4004, 'setup_codes': {'ppp': 'M101'}}}


def cell(stream_port: int = 702):
    return parse_cell(CELL.replace('PORT', str(stream_port)), 'hall.yaml')


@pytest.mark.parametrize(('name', 'namespace'), [
    ('demo', '/demo'), ('hall 2', '/hall_2'), ('5axis', '/m5axis'), ('Ä/ö', '/machine'), ('', '/machine')])
def test_namespaces_are_valid_in_ros(name, namespace):
    assert namespace_of(name) == namespace


def test_parameters_reach_the_nodes_by_file(tmp_path):
    graph = write_graph(cell(), ENDPOINTS, tmp_path, bag=tmp_path / 'bag')
    assert graph.namespace == '/hall_2'
    content = yaml.safe_load(graph.parameters_file.read_text())
    driver = content['/**/interferometer_driver']['ros__parameters']
    assert driver['port'] == 4001 and driver['beams'] == 2 and driver['setup'] == 'ppp'
    assert driver['sample_rate'] == 2000.0 and driver['block_samples'] == 200
    psd = content['/**/psd_driver']['ros__parameters']
    assert psd['stream_port'] == 4003 and psd['channels'] == [4, 5, 6, 7] and psd['length'] == 0.02
    sequencer = content['/**/step_sequencer']['ros__parameters']
    assert sequencer['setup_codes'] == ['ppp=M101']
    assert content['/**/recorder']['ros__parameters']['bag'] == str(tmp_path / 'bag')
    text = Path(sequencer['description_file']).read_text(encoding='utf-8')
    assert Description.from_yaml(text) == cell().description


def test_what_a_user_must_set_for_a_real_machine_is_a_key_of_the_cell_file(tmp_path):
    text = CELL.replace('PORT', '702').replace('tool:', 'origin: [-0.8, 0.0, -0.5], tool:') \
        .replace('port: 5007', 'port: 5007, setup_codes: {ppp: M103}') \
        .replace('length: 0.02', 'length: 0.02, mode: poll')
    real = parse_cell(text + 'motion: {stand: 30.0}\n', 'hall.yaml')
    content = yaml.safe_load(write_graph(real, hardware_endpoints(real), tmp_path).parameters_file.read_text())
    sequencer = content['/**/step_sequencer']['ros__parameters']
    assert sequencer['origin'] == [-0.8, 0.0, -0.5] and sequencer['stand'] == 30.0
    assert sequencer['setup_codes'] == ['ppp=M103'] and not sequencer['ask_operator']
    assert content['/**/psd_driver']['ros__parameters']['mode'] == 'poll'


def test_codes_that_are_no_m_codes_of_ones_own_are_refused():
    with pytest.raises(StepdiagError, match=r'setup_codes\.ppp: is .*M100 to M199'):
        parse_cell(CELL.replace('PORT', '702').replace('port: 5007', 'port: 5007, setup_codes: {ppp: "M2 M30"}'))


def test_hardware_is_where_the_file_says():
    assert hardware_endpoints(cell())['psd'] == {'host': '10.0.0.6', 'port': 502, 'stream_port': 702}


def test_hardware_without_a_port_is_refused():
    with pytest.raises(StepdiagError, match='hall.yaml: instruments.psd.stream_port is 0'):
        hardware_endpoints(cell(stream_port=0))
