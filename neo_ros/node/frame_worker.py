"""The thread that widens frames, away from the executor; no ROS in here."""
from collections.abc import Callable
from dataclasses import dataclass
import threading
import time
from typing import Any, NamedTuple, Protocol

from neo_ros.errors import ImageRejected, ModelError
from neo_ros.messages.frame_processor import FrameProcessor, WideFrame
from neo_ros.node.frame_statistics import Statistics
from neo_ros.node.one_slot import Mailbox

# How long a changed `max_fps` may go unnoticed.
LOOK_S = 0.1


@dataclass(frozen=True)
class Frame:
    """A camera message, the newest CameraInfo if there is one, and when the image came in."""

    image: Any
    camera_info: Any | None
    received: float  # time.perf_counter()


class Wanted(NamedTuple):
    """Which outputs somebody subscribes to; learn: images are looked at for the memory's sake."""

    image: bool = True
    compressed: bool = True
    mask: bool = True
    confidence: bool = True
    camera_info: bool = True
    pose: bool = False
    base_pose: bool = False
    status: bool = False
    depth: bool = False
    points: bool = False
    panorama: bool = False
    panorama_mask: bool = False
    transform: bool = False
    learn: bool = False

    @property
    def infer(self) -> bool:
        """Whether an image has to be widened for it."""
        return any(self._replace(mask=False, camera_info=False))


class Outputs(Protocol):
    """Where widened frames go."""

    def wanted(self) -> Wanted:
        """Say which outputs somebody subscribes to."""

    def publish(self, header: Any, frame: WideFrame, wanted: Wanted) -> None:
        """Send the wanted outputs under the header of their image."""


class FrameWorker:
    """
    Takes the newest frame, widens it, publishes it, counts it; never queues.

    `report` gets the words of every refusal. `max_fps` (0 = no limit) and `processor` may be
    changed while running: the next frame goes by them. After `stop` returned nothing is published
    any more, even when the network is still at work on a frame: inference cannot be interrupted,
    its result is thrown away.
    """

    def __init__(self, processor: FrameProcessor, outputs: Outputs, statistics: Statistics,
                 report: Callable[[str], None], max_fps: float = 0.0) -> None:
        self.max_fps = max_fps
        self.processor = processor
        self._outputs = outputs
        self._statistics = statistics
        self._report = report
        self._mailbox: Mailbox[Frame] = Mailbox()
        self._publishing = threading.Lock()
        self._forgets = True
        self._stopped = threading.Event()
        # A daemon, so that a signal in the middle of a long inference can end the process.
        self._thread = threading.Thread(target=self._run, name='extrapolate', daemon=True)

    @property
    def busy(self) -> bool:
        """Whether the thread has not ended."""
        return self._thread.is_alive()

    def start(self) -> None:
        """Begin to take frames."""
        self._thread.start()

    def submit(self, frame: Frame) -> None:
        """Hand over a frame; one that still waits is dropped for it."""
        self._statistics.count_received()
        if self._mailbox.put(frame):
            self._statistics.count_dropped()

    def forget(self) -> None:
        """Take the next frame for the first: the camera may have been carried elsewhere."""
        self._forgets = True

    def stop(self, timeout: float) -> bool:
        """Stop publishing at once; return whether the thread ended within `timeout` seconds."""
        with self._publishing:
            self._stopped.set()
        self._mailbox.close()
        self._thread.join(timeout)
        return not self.busy

    def _run(self) -> None:
        while (frame := self._mailbox.take()) is not None:
            taken = time.perf_counter()
            self._serve(frame, taken)
            # Wait before taking, so that what is taken then is the newest.
            while not self._stopped.is_set() and (pause := self._pause_after(taken)) > 0:
                self._stopped.wait(min(pause, LOOK_S))

    def _pause_after(self, taken: float) -> float:
        max_fps = self.max_fps  # Read once: the executor's thread may set it to 0 meanwhile.
        return taken + 1 / max_fps - time.perf_counter() if max_fps > 0 else 0.0

    def _serve(self, frame: Frame, taken: float) -> None:
        try:
            wanted = self._outputs.wanted()
            if not wanted.infer:
                self.forget()  # Nobody follows the camera meanwhile.
            elif self._forgets:
                self._forgets = False
                self.processor.reset()
            if not any(wanted):
                return
            wide = self.processor.process(
                frame.image, frame.camera_info, infer=wanted.infer)
            processed = time.perf_counter()
            with self._publishing:
                if self._stopped.is_set():
                    return
                self._outputs.publish(frame.image.header, wide, wanted)
        except ImageRejected as rejection:
            self._reject(rejection.reason, str(rejection))
            return
        except ModelError as error:  # Somebody has changed its memory, which is read as needed.
            self._reject('model', str(error))
            return
        except Exception as error:  # One bad frame must not end the thread and with it the node.
            if not self._stopped.is_set():
                self._reject('internal', f'{type(error).__name__}: {error}')
            return
        done = time.perf_counter()
        self._statistics.count_published({
            'queue': 1e3 * (taken - frame.received), **wide.stages_ms,
            'publish': 1e3 * (done - processed), 'total': 1e3 * (done - frame.received)},
            wide.out_of_scene, None if wide.image is None else wide.guided, wide.camera_note)

    def _reject(self, reason: str, message: str) -> None:
        self._statistics.count_rejected(reason, message)
        self._report(f'frame rejected ({reason}): {message}')
