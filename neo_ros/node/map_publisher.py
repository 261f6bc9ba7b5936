"""The map of the scene as a latched topic, drawn when somebody first asks for it."""
from collections.abc import Callable
import threading

from geometry_msgs.msg import Point, Pose
from nav_msgs.msg import MapMetaData, OccupancyGrid
from neo_ros.errors import NeoError
from neo_ros.node.interface import MAP
from neo_ros.node.loaded_model import LoadedModel
from neo_ros.node.message_types import as_int8
from neo_ros.runtime.scene_map import read_scene_map, SceneMap
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import Header


class MapPublisher:
    """
    Publishes the map of a model to whoever listens, also to those who come later.

    Nothing is drawn before somebody listens: it takes a second of a core, longer the more was
    learnt, in a thread of its own. `report` gets what went wrong.
    """

    def __init__(self, node: Node, report: Callable[[str], None]) -> None:
        self._node, self._report = node, report
        self._model: LoadedModel | None = None
        self._frame_id = ''
        self._drawn: LoadedModel | None = None
        self._busy = threading.Lock()
        self._publisher = node.create_publisher(
            OccupancyGrid, MAP.name,
            QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL),
            event_callbacks=PublisherEventCallbacks(matched=lambda _: self._attend()))

    def use(self, model: LoadedModel, frame_id: str) -> None:
        """Publish the map of this model from now on, in this frame."""
        if (model, frame_id) != (self._model, self._frame_id):
            self._model, self._frame_id, self._drawn = model, frame_id, None
            self._attend()

    def destroy(self) -> None:
        """Take the topic out of the graph."""
        self._model = None
        with self._busy:
            self._node.destroy_publisher(self._publisher)

    def _attend(self) -> None:
        model = self._model
        if (model is None or model is self._drawn
                or not self._publisher.get_subscription_count()):
            return
        self._drawn = model
        threading.Thread(target=self._draw, args=(model, self._frame_id), name='map',
                         daemon=True).start()

    def _draw(self, model: LoadedModel, frame_id: str) -> None:
        try:
            drawn = read_scene_map(model.description['path'], model.card)
        except NeoError as error:
            self._report(f'no map: {error}')
            return
        if drawn is None:
            self._report('no map: the model has no scene memory')
            return
        with self._busy:
            # Another model may have been loaded meanwhile, or the node cleaned up.
            if (model, frame_id) == (self._model, self._frame_id):
                stamp = self._node.get_clock().now().to_msg()
                self._publisher.publish(
                    grid_message(drawn, Header(stamp=stamp, frame_id=frame_id)))


def grid_message(drawn: SceneMap, header: Header) -> OccupancyGrid:
    """Return a map as a message; its origin lies on the floor."""
    height, width = drawn.cells.shape
    x, y = drawn.origin
    return OccupancyGrid(
        header=header, data=as_int8(drawn.cells.ravel()), info=MapMetaData(
            map_load_time=header.stamp, resolution=drawn.resolution, width=width, height=height,
            origin=Pose(position=Point(x=x, y=y, z=drawn.floor))))
