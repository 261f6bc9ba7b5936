"""Load a model in another thread; the executor's, which waits for it, keeps the node going."""
from collections.abc import Callable, Iterable
from concurrent.futures import Future, wait
import threading

from neo_ros.node.loaded_model import Load, load_model, LoadedModel
from neo_ros.node.parameters import NodeParameters
from rclpy.subscription import Subscription

LOOK_S = 0.005  # An image waits so long at most.
# Of one topic at a time: who sends faster than it is heard must not hold up the others.
MOST_TAKEN = 100


class ModelLoader:
    """
    Loads one model at a time.

    `load` makes an extrapolator of a path, a number of threads and ONNX Runtime's providers.
    `meanwhile` is called every LOOK_S seconds. Once `is_ended` says so, nobody waits any more:
    KeyboardInterrupt, as from a signal, for rclpy swallows all else.
    """

    def __init__(self, load: Load, meanwhile: Callable[[], None], is_ended: Callable[[], bool]
                 ) -> None:
        self._load, self._meanwhile, self._is_ended = load, meanwhile, is_ended
        self._thread: threading.Thread | None = None

    @property
    def busy(self) -> bool:
        """Whether a model is being loaded."""
        return self._thread is not None and self._thread.is_alive()

    def load(self, values: NodeParameters) -> LoadedModel:
        """Load, check and warm up the model that the parameters name; raises ModelError."""
        loaded: Future[LoadedModel] = Future()

        def load() -> None:
            try:
                loaded.set_result(load_model(values, self._load))
            except Exception as error:
                loaded.set_exception(error)

        # A daemon, so that a signal can end the process: TensorRT takes minutes.
        self._thread = threading.Thread(target=load, name='load', daemon=True)
        self._thread.start()
        while not wait([loaded], LOOK_S).done:
            if self._is_ended():
                raise KeyboardInterrupt
            self._meanwhile()
        self._thread.join()
        self._thread = None
        return loaded.result()


def take_waiting(subscriptions: Iterable[Subscription]) -> None:
    """Take what has come, where the executor cannot: its thread is busy, and this is it."""
    for subscription in list(subscriptions):
        for _ in range(MOST_TAKEN):
            with subscription.handle:
                found = subscription.handle.take_message(subscription.msg_type, subscription.raw)
            if found is None:
                break
            subscription.callback(found[0])
