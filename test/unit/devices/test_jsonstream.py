"""Framing of JSON without help from newlines."""

import json

import pytest

from stepdiag_ros.devices.jsonstream import JsonStream

VALUES = [{'id': 1, 'result': [0, 1, 2]}, {'text': 'a } { " \\ b\n', 'deep': {'a': [{}, []]}}, [1, 2], {}]


@pytest.mark.parametrize('between', ['', '\n', '\r\n', ' \n\n '])
@pytest.mark.parametrize('size', [1, 2, 7, 1000])
def test_values_come_out_however_they_are_cut(between, size):
    data = between.join(json.dumps(value) for value in VALUES).encode() + between.encode()
    stream, found = JsonStream(), []
    for at in range(0, len(data), size):
        found += stream.feed(data[at:at + size])
    assert found == VALUES


@pytest.mark.parametrize('data', [b'HTTP/1.1 200 OK', b'{"a": tru}', b'{]}', b'{"a" 1}', b'\xff\xfe{}'])
def test_what_is_not_json_is_refused(data):
    with pytest.raises(ValueError):
        JsonStream().feed(data)


def test_a_value_that_never_ends_is_refused():
    stream = JsonStream()
    with pytest.raises(ValueError):
        for _ in range(3):
            stream.feed(b'{"a": "' + b'x' * 700_000)


@pytest.mark.parametrize('data', [b'[' * 100_000, b'{"a":' * 100_000, b'[' * 100_000 + b']' * 100_000])
def test_what_is_nested_too_deep_is_refused(data):
    with pytest.raises(ValueError):
        JsonStream().feed(data)
