"""Topics around a wide image, and what their messages tell a viewer; duck-typed."""
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from neo_ros.bags import BagTopic
from neo_ros.errors import ImageRejected
from neo_ros.messages import read_compressed_image, read_image
from neo_ros.messages.memory_messages import IMAGE
from neo_ros.messages.scene_outputs import POSE, STATUS, WIDENING
from neo_ros.pictures.header import compressed_image_size
import numpy as np

# Larger compressed pictures are refused instead of being passed on.
MAX_COMPRESSED_BYTES = 16 * 1024 * 1024
# Where only the share of the last seconds is known: less is no recognised place.
LEAST_GUIDED = 0.5
GUIDED_SHARE, GUIDED, REJECTED = 'guided by the scene memory', 'guided', 'rejected'
IN_SCENE, LATENCY = 'in the trained scene', 'latency total median/p95/max [ms]'


@dataclass(frozen=True)
class WideTopics:
    """A wide image, raw or compressed, and what the node publishes beside it."""

    image: str

    @property
    def confidence(self) -> str:
        """How sure the model is."""
        return f'{self._wide}/confidence'

    @property
    def mask(self) -> str:
        """Which pixels the model made up."""
        return f'{self._wide}/mask'

    @property
    def status(self) -> str:
        """What is true of each single image."""
        return f'{self._wide}/status'

    @property
    def pose(self) -> str:
        """Where the camera was."""
        return f'{self._wide}/pose'

    @property
    def camera(self) -> str:
        """The camera's namespace, where the node is."""
        return self._wide.rpartition('/')[0]

    def fits(self, topic: BagTopic) -> bool:
        """Say whether a topic is of the type that its name says; others may have the name, too."""
        expected = {self.confidence: IMAGE, self.mask: IMAGE, self.status: STATUS,
                    self.pose: POSE, '/diagnostics': STATUS}.get(topic.name)
        return expected in (None, topic.msgtype)

    @property
    def _wide(self) -> str:
        return self.image.removesuffix('/compressed').rpartition('/')[0]


def read_picture(message: Any) -> np.ndarray | bytes:
    """
    Return RGB uint8 (H, W, 3) of an Image; of a CompressedImage its bytes as they are.

    Raises ImageRejected for what cannot be shown.
    """
    if hasattr(message, 'encoding'):
        return read_image(message)
    data = bytes(message.data)
    compressed_image_size(data)
    if len(data) > MAX_COMPRESSED_BYTES:
        raise ImageRejected('size', f'data: expected at most {MAX_COMPRESSED_BYTES} bytes, got '
                            f'{len(data)}')
    return data


def read_pixels(message: Any) -> np.ndarray | None:
    """Return RGB uint8 (H, W, 3) of an Image or a CompressedImage; None where it is unusable."""
    try:
        return (read_image if hasattr(message, 'encoding') else read_compressed_image)(message)
    except ImageRejected:
        return None


def read_grey(message: Any) -> np.ndarray:
    """Return uint8 (H, W) of a mono8 Image; raises ImageRejected."""
    return np.ascontiguousarray(read_image(message)[..., 0])


def seen_share(mask: np.ndarray) -> tuple[float, float, float, float] | None:
    """
    Return the camera's frame of an extrapolated mask, uint8 (H, W), 0 = seen by the camera.

    (left, top, width, height) in shares of the picture; None where no pixel was seen.
    """
    rows, columns = np.flatnonzero((mask == 0).any(1)), np.flatnonzero((mask == 0).any(0))
    if not rows.size:
        return None
    height, width = mask.shape
    return (float(columns[0] / width), float(rows[0] / height),
            float((columns[-1] + 1 - columns[0]) / width),
            float((rows[-1] + 1 - rows[0]) / height))


class NodeDiagnosis:
    """
    Reads /diagnostics for the node in a camera's namespace.

    Where that node has another name and only one fov_extrapolator has ever been heard of, it is
    that one; what another camera's node says would be worse than nothing.
    """

    def __init__(self, camera: str) -> None:
        self._own = f'{camera}/fov_extrapolator: {WIDENING}'
        self._heard: set[str] = set()
        self._memory = self._by_frame = False

    def read_frame(self, statuses: Sequence[Any]) -> Mapping[str, Any]:
        """
        Return what the DiagnosticArray of one image says: `recognised` of a SourceState.

        Without a memory no image is guided: until there is a sign of one, nothing is said.
        """
        guided = {entry.key: entry.value for status in statuses[:1]
                  for entry in status.values}.get(GUIDED)
        self._by_frame = guided is not None
        self._memory |= guided == 'true'
        return {'recognised': guided == 'true'} if self._memory and self._by_frame else {}

    def read(self, statuses: Sequence[Any]) -> Mapping[str, Any]:
        """
        Return what a DiagnosticArray's `status` says of the node.

        The fields `level`, `message`, `out_of_scene`, `recognised` and `node_ms` of a
        SourceState; empty where no status is the node's. Of single images their own status says
        more; then nothing is said here of `recognised`.
        """
        status = self._status(statuses)
        if status is None:
            return {}
        found = _read_status(status)
        self._memory = found['recognised'] is not None
        return {key: value for key, value in found.items()
                if key != 'recognised' or not (self._memory and self._by_frame)}

    def rejected(self, statuses: Sequence[Any]) -> int | None:
        """Return how many images the node has rejected so far; None where it does not say."""
        status = self._status(statuses)
        values = {entry.key: entry.value for entry in status.values} if status else {}
        return int(values[REJECTED]) if values.get(REJECTED, '').isdecimal() else None

    def _status(self, statuses: Sequence[Any]) -> Any | None:
        nodes = {status.name: status for status in statuses
                 if status.name.endswith(f'fov_extrapolator: {WIDENING}')}
        self._heard |= set(nodes)
        alone = next(iter(self._heard)) if len(self._heard) == 1 else ''
        return nodes.get(self._own if self._own in self._heard else alone)


def _read_status(status: Any) -> Mapping[str, Any]:
    values = {entry.key: entry.value for entry in status.values}
    # rclpy gives a byte as bytes, rosbags as int.
    level = status.level if isinstance(status.level, int) else int.from_bytes(status.level)
    try:
        node_ms = float(values[LATENCY].split('/')[0])
    except (KeyError, ValueError):
        node_ms = None
    try:
        recognised = float(values[GUIDED_SHARE].removesuffix('%')) / 100 >= LEAST_GUIDED
    except (KeyError, ValueError):
        recognised = None
    return {'level': level, 'message': status.message, 'node_ms': node_ms,
            'recognised': recognised, 'out_of_scene': values.get(IN_SCENE) == 'false'}
