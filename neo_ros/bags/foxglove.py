"""Foxglove's own messages, in JSON or protobuf, with the fields of their ROS messages."""
import base64
from collections.abc import Callable
import json
from types import SimpleNamespace
from typing import Any

from neo_ros.bags.topic import Channel, JSON
import numpy as np

Reader = Callable[[bytes], Any]
VIDEO = 'foxglove_msgs/msg/CompressedVideo'


def reader_of(encoding: str, channel: Channel) -> Reader:
    """
    Return a function from the bytes of a message to an object with the ROS message's fields.

    It raises ValueError, KeyError, TypeError or AttributeError where the bytes are no such
    message. Protobuf needs the extra `foxglove`.
    """
    convert = _CONVERTERS[channel.schema.rpartition('.')[2]]
    if encoding == JSON:
        return lambda data: convert(json.loads(data, object_hook=lambda x: SimpleNamespace(**x)))
    from mcap.records import Schema
    from mcap_protobuf.decoder import DecoderFactory
    decode = DecoderFactory().decoder_for(encoding, Schema(
        data=channel.schema_data, encoding=channel.schema_encoding, id=1, name=channel.schema))
    if decode is None:
        raise ValueError(f'expected a protobuf schema, got {channel.schema_encoding!r}')
    return lambda data: convert(decode(data))


def with_header(video: Any) -> Any:
    """Return a CompressedVideo with a header, as the messages of other cameras have one."""
    return SimpleNamespace(header=SimpleNamespace(stamp=video.timestamp, frame_id=video.frame_id),
                           format=video.format, data=video.data)


def _header(message: Any, frame_id: str) -> Any:
    stamp = message.timestamp
    # JSON writes sec and nsec, protobuf seconds and nanos.
    seconds = stamp.sec if hasattr(stamp, 'sec') else stamp.seconds
    rest = stamp.nsec if hasattr(stamp, 'nsec') else stamp.nanos
    return SimpleNamespace(stamp=SimpleNamespace(sec=seconds, nanosec=rest), frame_id=frame_id)


def _data(message: Any) -> np.ndarray:
    data = message.data
    return np.frombuffer(
        base64.b64decode(data, validate=True) if isinstance(data, str) else data, np.uint8)


def _compressed_image(message: Any) -> Any:
    return SimpleNamespace(header=_header(message, message.frame_id), format=message.format,
                           data=_data(message))


def _raw_image(message: Any) -> Any:
    return SimpleNamespace(
        header=_header(message, message.frame_id), width=message.width, height=message.height,
        encoding=message.encoding, is_bigendian=0, step=message.step, data=_data(message))


def _calibration(message: Any) -> Any:
    roi = SimpleNamespace(x_offset=0, y_offset=0, width=0, height=0, do_rectify=False)
    k, d, r, p = (np.array(getattr(message, name), np.float64) for name in 'KDRP')
    # Foxglove leaves out what is not there; ROS fills it up.
    return SimpleNamespace(
        header=_header(message, message.frame_id), width=message.width, height=message.height,
        distortion_model=message.distortion_model, d=d, k=k if k.size else np.zeros(9),
        r=r if r.size else np.eye(3).reshape(-1), p=p if p.size else np.zeros(12), binning_x=0,
        binning_y=0, roi=roi)


def _transform(message: Any) -> Any:
    return SimpleNamespace(
        header=_header(message, message.parent_frame_id), child_frame_id=message.child_frame_id,
        transform=SimpleNamespace(translation=message.translation, rotation=message.rotation))


_CONVERTERS: dict[str, Callable[[Any], Any]] = {
    'CompressedImage': _compressed_image,
    'RawImage': _raw_image,
    'CameraCalibration': _calibration,
    'FrameTransform': lambda message: SimpleNamespace(transforms=[_transform(message)]),
    'FrameTransforms': lambda message: SimpleNamespace(
        transforms=[_transform(entry) for entry in message.transforms]),
}
