"""Registers and packets of the analogue input box."""

import struct

import numpy as np
import pytest

from stepdiag_ros.devices import t7


def test_readings_and_volts():
    calibration = t7.Calibration()
    volts = np.linspace(-10.0, 10.0, 401)
    np.testing.assert_allclose(calibration.volts(calibration.raw(volts)), volts, atol=1.6e-4)
    assert calibration.volts(np.array([33523])) == 0.0
    assert calibration.raw(np.array([1e6])) == 0xFFFE   # 0xFFFF marks skipped scans


def test_constants_as_they_lie_in_the_flash():
    calibration = t7.Calibration(3e-4, -3.1e-4, 33000.0, -10.0)
    found = t7.Calibration.unpack(calibration.pack() + b'rest')
    assert found.positive_slope == pytest.approx(3e-4) and found.center == 33000.0
    assert found.negative_slope == pytest.approx(-3.1e-4)


def test_a_packet_of_the_data_sheet():
    """Bytes laid out by hand after LabJack's example of a spontaneous stream."""
    data = struct.pack('>HHHBBBBHHH', 7, 0, 14, 1, 76, 16, 0, 96, 2941, 3) + struct.pack('>2H', 33523, 40000)
    packets = t7.PacketStream().feed(data)
    assert len(packets) == 1
    assert (packets[0].transaction, packets[0].status, packets[0].additional) == (7, 2941, 3)
    assert packets[0].raw.tolist() == [33523, 40000]
    assert t7.pack_packet(7, packets[0].raw, backlog=96, status=2941, additional=3) == data


@pytest.mark.parametrize('size', [1, 5, 16, 1000])
def test_packets_come_out_however_they_are_cut(size):
    whole = b''.join(t7.pack_packet(i, np.arange(8) + i) for i in range(20))
    stream, found = t7.PacketStream(), []
    for at in range(0, len(whole), size):
        found += stream.feed(whole[at:at + size])
    assert [p.transaction for p in found] == list(range(20))
    assert found[3].raw.tolist() == list(range(3, 11))


@pytest.mark.parametrize('data', [b'\xff' * 64, b'HTTP/1.1 400 Bad Request\r\n',
                                  t7.pack_packet(0, np.arange(4))[:7] + b'\x03' + bytes(20)])
def test_what_is_no_packet_is_refused(data):
    with pytest.raises(ValueError, match='no stream packet'):
        t7.PacketStream().feed(data)


def test_registers_are_big_endian():
    assert t7.float_registers(1.0) == [0x3F80, 0x0000]
    assert t7.uint_registers(0x12345678) == [0x1234, 0x5678]
    np.testing.assert_array_equal(t7.floats([0x3F80, 0, 0xC000, 0]), [1.0, -2.0])
