"""What `stepdiag watch` shows of what the nodes say."""

from stepdiag_ros.cli.watch import screen
from stepdiag_ros.nodes.overview import GONE_S, Said

LIGHT = Said(0.5, True, 'a has the light', {
    'holder': 'a', 'held_for_s': '3.2', 'expected_s': '20', 'queue': 'b c', 'waits_s': '17 37', 'held_s': '180',
    'idle_s': '2', 'idle_share': '0.011', 'grants': '9'})
BUSY = Said(0.2, True, 'X to stop 4 of 12', {'goal': 'under way', 'stop': '13', 'stops': '52', 'time_left_s': '39'})


def test_the_light_its_queue_and_each_machine_have_a_line():
    assert screen({'/hall/multiplexer': LIGHT, '/a/step_sequencer': BUSY,
                   '/b/step_sequencer': Said(0.1, True, 'ready', {'goal': 'none'}),
                   '/a/recorder': Said(0.1, True, 'recording')}) == [
        '/hall: a has the light for 3 of about 20 s',
        '  waiting: b ~17 s, c ~37 s',
        '  used 180 s in 9 grants, idle though wanted 1.1 %',
        '/a: [█████···············] 13/52 stops, about 39 s of measuring left: X to stop 4 of 12',
        '/b: ready']


def test_who_is_unwell_or_silent_is_named_and_who_is_gone_is_not_shown():
    lines = screen({'/a/psd_driver': Said(0.1, False, 'stalled'), '/a/recorder': Said(9.0, True, 'recording'),
                    '/b/step_sequencer': Said(GONE_S + 1.0, True, 'ready')})
    assert lines == ['  /a/psd_driver: stalled', '  /a/recorder: silent for 9 s']


def test_nobody_has_the_light():
    assert screen({'/hall/multiplexer': Said(0.0, True, 'nobody has the light', {'holder': '', 'queue': ''})}) == [
        '/hall: nobody has the light', '  waiting: nobody']
