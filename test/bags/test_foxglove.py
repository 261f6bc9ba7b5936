"""Foxglove's own messages, in JSON and protobuf, hold a camera as ROS messages do."""
import base64
from importlib.util import find_spec
import json
from pathlib import Path
from typing import Any

import cv2
from mcap.writer import Writer as McapWriter
from neo_ros.bags import BagReader
from neo_ros.captures.bag import read_bag_capture
from neo_ros.errors import BagError
from neo_ros.geometry import CameraPose, Intrinsics
from neo_ros.geometry.camera_pose import quaternion_from_rotation, T_BODY_OPTICAL
import numpy as np
import pytest

START, STEP, COUNT = 1_700_000_000_000_000_000, 100_000_000, 4
CAMERA = Intrinsics(32, 24, 30.0, 31.0, 16.5, 12.0)
IMAGES = np.random.default_rng(3).integers(0, 256, (COUNT, 24, 32, 3), np.uint8)
BODY = [CameraPose.from_planar(0.3 * i, -0.1 * i, 0, 0.2 * i).T_world_cam
        @ np.linalg.inv(T_BODY_OPTICAL) for i in range(COUNT)]
needs_protobuf = pytest.mark.skipif(
    find_spec('mcap_protobuf') is None, reason='needs the extra foxglove')


def _stamped(stamp_ns: int, frame: str, **fields: Any) -> dict[str, Any]:
    seconds, rest = divmod(stamp_ns, 1_000_000_000)
    return {'timestamp': (seconds, rest), 'frame_id': frame, **fields}


def _transform(stamp_ns: int, parent: str, child: str, T: np.ndarray) -> dict[str, Any]:
    found = _stamped(stamp_ns, '', parent_frame_id=parent, child_frame_id=child,
                     translation=dict(zip('xyz', T[:3, 3].tolist())),
                     rotation=dict(zip('xyzw', quaternion_from_rotation(T[:3, :3]).tolist())))
    del found['frame_id']
    return found


def _entries(raw: bool) -> list[tuple[str, str, int, dict[str, Any]]]:
    """Return (topic, type, log time, fields) of a camera that drives."""
    k = [30.0, 0, 16.0, 0, 31.0, 11.5, 0, 0, 1]
    # The mount is told once, long before the images.
    entries = [('/mount', 'FrameTransform', START - 10**9, _transform(
        START - 10**9, 'base_link', 'optical', T_BODY_OPTICAL))]
    for i, image in enumerate(IMAGES):
        stamp = START + i * STEP
        entries += [
            ('/tf', 'FrameTransform', stamp, _transform(stamp, 'map', 'base_link', BODY[i])),
            ('/eye/calibration', 'CameraCalibration', stamp, _stamped(
                stamp, 'optical', width=32, height=24, distortion_model='plumb_bob', K=k, D=[],
                R=[], P=[])),
            ('/eye/image', 'RawImage', stamp, _stamped(
                stamp, 'optical', width=32, height=24, encoding='rgb8', step=96,
                data=image.tobytes())) if raw else
            ('/eye/image', 'CompressedImage', stamp, _stamped(
                stamp, 'optical', format='png',
                data=cv2.imencode('.png', image[..., ::-1])[1].tobytes()))]
    return entries


def _as_json(fields: dict[str, Any]) -> bytes:
    seconds, rest = fields['timestamp']
    content = {**fields, 'timestamp': {'sec': seconds, 'nsec': rest}}
    if 'data' in content:
        content['data'] = base64.b64encode(content['data']).decode()
    return json.dumps(content).encode()


def _write(path: Path, protobuf: bool, raw: bool) -> Path:
    with path.open('wb') as file:
        writer = McapWriter(file)
        writer.start()
        channels: dict[str, int] = {}
        kinds = _protobuf_types() if protobuf else {}
        for topic, name, stamp, fields in _entries(raw):
            if topic not in channels:
                schema = writer.register_schema(
                    f'foxglove.{name}', 'protobuf' if protobuf else 'jsonschema',
                    kinds['schema'] if protobuf else b'{}')
                channels[topic] = writer.register_channel(
                    topic, 'protobuf' if protobuf else 'json', schema)
            if protobuf:
                seconds, rest = fields['timestamp']
                message = kinds[name](**{**fields, 'timestamp': {
                    'seconds': seconds, 'nanos': rest}})
                data = message.SerializeToString()
            else:
                data = _as_json(fields)
            writer.add_message(channels[topic], stamp, data, stamp)
        writer.finish()
    return path


def _protobuf_types() -> dict[str, Any]:
    """Make Foxglove's types, with the numbers of their fields, and the schema of all of them."""
    from google.protobuf import descriptor_pb2, message_factory, timestamp_pb2
    from google.protobuf.descriptor_pool import DescriptorPool

    string, number, data, real, other = 9, 7, 12, 1, 11  # protobuf's own numbers of types
    stamp = ('timestamp', other, 'google.protobuf.Timestamp')
    layouts: dict[str, list[tuple[Any, ...]]] = {
        'CompressedImage': [(1, *stamp), (4, 'frame_id', string), (2, 'data', data),
                            (3, 'format', string)],
        'RawImage': [(1, *stamp), (7, 'frame_id', string), (2, 'width', number),
                     (3, 'height', number), (4, 'encoding', string), (5, 'step', number),
                     (6, 'data', data)],
        'CameraCalibration': [(1, *stamp), (9, 'frame_id', string), (2, 'width', number),
                              (3, 'height', number), (4, 'distortion_model', string),
                              *((5 + i, name, real) for i, name in enumerate('DKRP'))],
        'Vector3': [(1 + i, name, real) for i, name in enumerate('xyz')],
        'Quaternion': [(1 + i, name, real) for i, name in enumerate('xyzw')],
        'FrameTransform': [(1, *stamp), (2, 'parent_frame_id', string),
                           (3, 'child_frame_id', string),
                           (4, 'translation', other, 'foxglove.Vector3'),
                           (5, 'rotation', other, 'foxglove.Quaternion')],
    }
    file = descriptor_pb2.FileDescriptorProto(
        name='foxglove.proto', package='foxglove', syntax='proto3',
        dependency=['google/protobuf/timestamp.proto'])
    for name, layout in layouts.items():
        entry = file.message_type.add(name=name)
        for place, field, kind, *type_name in layout:
            entry.field.add(name=field, number=place, type=kind,
                            label=3 if len(field) == 1 and field in 'DKRP' else 1,
                            type_name=f'.{type_name[0]}' if type_name else None)
    times = descriptor_pb2.FileDescriptorProto.FromString(
        timestamp_pb2.DESCRIPTOR.serialized_pb)
    pool = DescriptorPool()
    pool.Add(times)  # type: ignore[no-untyped-call,unused-ignore]
    pool.Add(file)  # type: ignore[no-untyped-call,unused-ignore]
    kinds: dict[str, Any] = {
        name: message_factory.GetMessageClass(pool.FindMessageTypeByName(f'foxglove.{name}'))
        for name in layouts}
    kinds['schema'] = descriptor_pb2.FileDescriptorSet(file=[times, file]).SerializeToString()
    return kinds


@pytest.mark.parametrize('raw', [False, True], ids=['compressed', 'raw'])
@pytest.mark.parametrize('protobuf', [
    False, pytest.param(True, marks=needs_protobuf)], ids=['json', 'protobuf'])
def test_a_camera_is_read(tmp_path: Path, protobuf: bool, raw: bool) -> None:
    capture = read_bag_capture(_write(tmp_path / 'a.mcap', protobuf, raw))
    found = [frame.pose.T_world_cam for frame in capture.frames if frame.pose is not None]
    np.testing.assert_allclose(found, [T @ T_BODY_OPTICAL for T in BODY], atol=1e-6)
    lens = capture.frames[0].lens
    assert lens is not None and lens.intrinsics == CAMERA and lens.is_pinhole
    for index, image in capture.images(range(COUNT)):
        np.testing.assert_array_equal(image, IMAGES[index])


@pytest.mark.parametrize('data', [b'', b'[]', b'{"timestamp": 3}', b'\xff', b'{"data": "?"}'])
def test_damaged_messages_are_bag_errors(tmp_path: Path, data: bytes) -> None:
    with (tmp_path / 'a.mcap').open('wb') as file:
        writer = McapWriter(file)
        writer.start()
        channel = writer.register_channel('/eye', 'json', writer.register_schema(
            'foxglove.CompressedImage', 'jsonschema', b'{}'))
        writer.add_message(channel, 1, data, 1)
        writer.finish()
    with BagReader(tmp_path / 'a.mcap') as bag:
        message, = bag.messages()
        with pytest.raises(BagError, match='/eye: the message at 1 ns is no foxglove.Compressed'):
            message.read()
