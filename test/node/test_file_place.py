"""The ways to say where a file lies."""
from pathlib import Path
import sys

from neo_ros.errors import ConfigError
from neo_ros.machine.files import share_dir
from neo_ros.node.file_place import find_model
import pytest


def test_every_way_ends_in_a_path(monkeypatch):
    monkeypatch.setenv('HOME', '/home/ada')
    monkeypatch.delenv('AMENT_PREFIX_PATH', raising=False)
    assert [find_model(place) for place in (
        '', 'room.onnx', '/data/a room?#.onnx', '~/rooms/a.onnx', 'file:///data/a%20room.onnx',
        'package://std_msgs/models/room.onnx')] == [
        str(share_dir() / 'models' / 'demo_flat.onnx'), 'room.onnx', '/data/a room?#.onnx',
        '/home/ada/rooms/a.onnx', '/data/a room.onnx',
        str(Path(sys.prefix, 'share/std_msgs/models/room.onnx'))]


@pytest.mark.parametrize('place, words', [
    ('http://example.org/room.onnx', 'expected a path, file:///PATH or package://PACKAGE/PATH'),
    ('file://room.onnx', 'expected a path, file:///PATH'),
    ('package://nowhere/room.onnx', "no package 'nowhere'"),
    ('package:///room.onnx', "no package ''"),
    ('~nobody_of_that_name/room.onnx', 'home of a user that exists'),
], ids=['scheme', 'relative', 'package', 'no package', 'user'])
def test_a_place_that_is_none_is_refused(place, words):
    with pytest.raises(ConfigError, match=f'model: .*{words}'):
        find_model(place)
