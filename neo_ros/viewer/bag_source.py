"""Pictures from a bag, with the timing that it was recorded with, as the viewers play it."""
from dataclasses import replace
import logging
from pathlib import Path
import threading
from typing import Any

from neo_ros.bags import BagReader, BagTopic
from neo_ros.bags.camera_choice import CameraChoice, find_camera
from neo_ros.bags.camera_topics import COMPRESSED, find_truth_topic, first_size, IMAGE
from neo_ros.bags.reading import BagMessage, LONGEST_GAP_NS
from neo_ros.errors import BagError, ConfigError, GeometryError, ImageRejected
from neo_ros.messages import FrameProcessor
from neo_ros.messages.stamps import NS_PER_S
from neo_ros.runtime import FovExtrapolator
from neo_ros.viewer.bag_moments import Companion, picture_at, picture_before
from neo_ros.viewer.bag_pictures import BagPictures
from neo_ros.viewer.hub import Hub
from neo_ros.viewer.pictures import CAMERAS, SourcePicture, SourceState, TRUTH
from neo_ros.viewer.playback import FASTEST, Jump, Playback, SLOWEST
from neo_ros.viewer.tiles import draw_tiles
from neo_ros.viewer.timeline import read_timeline
from neo_ros.viewer.wide_topics import WideTopics

WIDE = '/wide/image'
logger = logging.getLogger(__name__)
# A picture that would come later than this after its time is left out for a newer one.
LATE_S = 0.2
# But not for longer than this: where a bag is read slower than it is played all come late.
LEAST_OFTEN_S = 0.5
# What is said before a picture that is jumped to: diagnostics come once a second.
LEAD_NS = 3 * NS_PER_S // 2
# What is said of a picture may be recorded after it.
TOGETHER_NS = NS_PER_S // 50
# So long a viewer's command waits.
SLICE_S = 0.05


class BagSource:
    """
    Shows the wide pictures of a bag, or those that a model makes of its camera.

    A bag with a topic .../wide/image, as `neo replay` and `neo record` write it, is shown as it
    is; else the camera of `choice` is widened with the model of `model`. Of several wide topics
    the viewers choose. Raises BagError for bags and topics that cannot be used, ConfigError for a
    calibration, ModelError for the model.
    """

    def __init__(self, bag: Path, model: Path, rate: float = 1.0,
                 choice: CameraChoice = CameraChoice()) -> None:
        if not SLOWEST <= rate <= FASTEST:
            raise ConfigError(f'rate: expected {SLOWEST:g} to {FASTEST:g}, got {rate:g}')
        self._bag, self._choice = bag, choice
        # The model that its camera is widened with; None where it has wide images.
        self.model: Path | None = None
        with BagReader(bag) as reader:
            for damage in reader.damages:
                logger.warning('%s: %s', bag, damage)
            span_ns = reader.span_ns
            wides = _find_wide(reader, choice.image_topic)
            if wides:
                self._wide = {wide.name: wide for wide in wides}
                # Of several cameras nobody knows whose truth it would be.
                truth = None if wides[1:] else find_truth_topic(
                    reader, wides[0], first_size(reader, wides[0]))
                camera = wides[0].name
            else:
                camera, truth = self._load(reader, model)
        self._truth = truth.name if truth is not None else None
        cameras = sorted(self._wide) if wides else [camera]
        beside = [*([TRUTH] if truth is not None else []), *([CAMERAS] if cameras[1:] else [])]
        self.playback = Playback(span_ns, rate, camera, cameras, beside)
        self._span = (span_ns[0] / NS_PER_S, span_ns[1] / NS_PER_S)
        self._pictures = self._make_pictures()

    def _load(self, reader: BagReader, model: Path) -> tuple[str, BagTopic | None]:
        """Take the camera that is widened; return its name, and its truth."""
        extrapolator = FovExtrapolator.load(model)
        self.model, target = model, extrapolator.expansion.target
        self._memory = extrapolator.card.memory is not None
        self._processor = FrameProcessor(extrapolator, self._choice.rectify)
        self._camera = find_camera(reader, extrapolator.expansion.source, self._choice)
        image, info = self._camera.image, self._camera.info
        self._info = '' if info is None else info.name, self._camera.first_info(reader)
        return image.name, find_truth_topic(reader, image, (target.width, target.height))

    def _make_pictures(self) -> BagPictures:
        camera = self.playback.camera
        state = SourceState(f'{self._bag.name} {camera}', span=self._span)
        if self.model is None:
            return BagPictures(self._wide[camera], WideTopics(camera), state,
                               self.playback.timeline)
        return BagPictures(self._camera.image, WideTopics(f'{self._camera.wide}/image'), state,
                           self.playback.timeline, self._processor, self._memory, self._info)

    def run(self, hub: Hub, stop: threading.Event) -> None:
        """Play the bag as the viewers wish until `stop` is set; BagError without pictures."""
        player, hub.playback = self.playback, self.playback
        if self.model is None:
            threading.Thread(target=read_timeline, name='viewer timeline', daemon=True, args=(
                self._bag, player.timelines, self._truth, stop)).start()
        with BagReader(self._bag) as reader:
            run = _Run(self, reader, hub, stop)
            first_ns = picture_at(reader, self._pictures.image.name, player.span_ns[0])
            if first_ns is None:
                raise BagError(f'{self._bag}: no picture of {self._pictures.image.name} can be '
                               'read')
            run.play(first_ns, False)
            while not stop.is_set():
                jump = player.take_jump()
                if jump is not None:
                    run.jump(jump)
                else:
                    player.end()
                    run.rest()


class _Run:
    """One run through a bag: what is shown, and how its time goes with the clock's."""

    def __init__(self, source: BagSource, reader: BagReader, hub: Hub,
                 stop: threading.Event) -> None:
        self._source, self._reader, self._hub, self._stop = source, reader, hub, stop
        self._player = source.playback
        self._pictures = source._pictures
        self._shown: SourcePicture | None = None
        self._shown_ns = self._player.span_ns[0]
        self._shown_at = 0.0  # By the clock.
        # A time of the clock, the log time then, and how fast it goes.
        self._anchor: tuple[float, int, float] | None = None
        self._owed = False
        self._viewers = 0
        self._rejected: set[int] = set()
        self._make_companions()
        self._pictures.forget(hub)
        self._report()

    def jump(self, jump: Jump) -> None:
        """Go on elsewhere."""
        if self._player.camera != self._pictures.image.name and self._source.model is None:
            self._pictures = self._source._make_pictures()
            self._make_companions()
        name, here_ns = self._pictures.image.name, self._shown_ns
        if jump.back:
            found = picture_before(self._reader, name, here_ns)
        else:
            found = picture_at(self._reader, name, here_ns if jump.to_ns is None else jump.to_ns)
        self.play(here_ns if found is None else found, True)

    def play(self, start_ns: int, owed: bool) -> None:
        """Show what comes from a log time on, until it ends or something else is wanted."""
        pictures = self._pictures
        self._anchor, self._owed = None, owed
        pictures.forget(self._hub)
        for message in self._reader.messages(pictures.read, max(start_ns - LEAD_NS, 0)):
            early = message.stamp_ns < start_ns
            if early and message.topic.name == pictures.image.name:
                continue
            due = self._hub.clock.now() if early else self._hold(message)
            if due is None:
                return
            now = self._hub.clock.now()
            late = now - due > LATE_S and now - self._shown_at < LEAST_OFTEN_S
            if not (late and message.topic.name in pictures.skipped):
                self._take(message, due)

    def rest(self) -> None:
        """Wait for a command."""
        while not (self._stop.is_set() or self._player.jumps):
            self._idle()

    def _hold(self, message: BagMessage) -> float | None:
        """Wait until a message is due, and say when it was; None: something else is wanted."""
        clock, player, stamp_ns = self._hub.clock, self._player, message.stamp_ns
        if (self._shown is not None and stamp_ns <= self._shown_ns + TOGETHER_NS and not self._owed
                and message.topic.name != self._pictures.image.name):
            return self._shown.captured
        while not (self._stop.is_set() or player.jumps):
            if not (self._owed or player.moves and self._hub.wanted.image):
                self._idle()
                continue
            self._hub.where.stands = None
            if self._owed or not player.playing:
                return clock.now()
            if self._anchor is None or self._anchor[2] != player.rate:
                ahead = 0 if self._anchor is None else (
                    stamp_ns - self._shown_ns) / NS_PER_S / player.rate
                self._anchor = clock.now() + max(ahead, 0), stamp_ns, player.rate
            if stamp_ns - self._shown_ns > LONGEST_GAP_NS:  # The robot's clock was set.
                self._anchor = clock.now(), stamp_ns, player.rate
            at, at_ns, rate = self._anchor
            due = at + (stamp_ns - at_ns) / NS_PER_S / rate
            if clock.now() >= due:
                return due
            clock.pause(min(due - clock.now(), SLICE_S), self._stop)
        return None

    def _idle(self) -> None:
        """Stand still; who comes meanwhile sees the picture that is shown."""
        hub, self._anchor = self._hub, None
        self._report()
        if self._shown is not None:
            hub.where.stands = self._shown.captured
            if self._viewers != hub.changes and hub.wanted.image:
                self._viewers = hub.changes
                self._publish(replace(self._shown, captured=hub.clock.now()))
        hub.clock.pause(SLICE_S, self._stop)

    def _take(self, message: BagMessage, due: float) -> None:
        try:
            picture = self._pictures.take(message, due, self._hub)
        except (ImageRejected, GeometryError, BagError) as error:
            if self._source.model is not None and message.topic == self._pictures.image:
                if message.stamp_ns not in self._rejected:  # It may have been played before.
                    self._player.timeline.reject(message.stamp_ns)
                self._rejected.add(message.stamp_ns)
            self._hub.report(replace(self._described(), level=1, message=str(error)))
            return
        if picture is not None:
            if not self._owed:
                self._player.count_step()
            self._shown_ns, self._owed, self._viewers = message.stamp_ns, False, self._hub.changes
            self._shown_at = self._hub.clock.now()
            self._anchor = self._anchor or (due, message.stamp_ns, self._player.rate)
            self._publish(picture)
        self._report()

    def _publish(self, picture: SourcePicture) -> None:
        place = self._hub.where.last
        if self._shown is not None and place is not None and (
                place.captured == self._shown.captured < picture.captured
                and picture.recorded == self._shown.recorded):
            self._hub.where.put(replace(place, captured=picture.captured))
        self._shown = picture
        self._hub.publish(replace(picture, beside=self._beside()))

    def _beside(self) -> dict[str, Any]:
        """Return what somebody wants to see beside the picture that is shown."""
        wanted, shown = self._hub.wanted.beside, self._shown
        found: dict[str, Any] = {}
        if TRUTH in wanted and self._truth is not None:
            found[TRUTH] = self._truth.at(self._shown_ns, self._pictures.stamp_ns)
        if CAMERAS in wanted and shown is not None:
            found[CAMERAS] = draw_tiles({
                name: companion.at(self._shown_ns, 0) for name, companion in self._tiles.items()})
        return {name: picture for name, picture in found.items() if picture is not None}

    def _make_companions(self) -> None:
        source, shown = self._source, self._pictures.image.name
        truth = source._truth
        self._truth = None if truth is None else Companion(self._reader, truth, True)
        self._tiles = {name: Companion(self._reader, name, False)
                       for name in (source._wide if source.model is None else ())
                       if name != shown}

    def _described(self) -> SourceState:
        return replace(self._pictures.state, playback=self._player.describe())

    def _report(self) -> None:
        self._hub.report(self._described())


def _find_wide(reader: BagReader, name: str | None) -> list[BagTopic]:
    """Return the wide images of this name, or all; compressed ones where there are no raw ones."""
    wide = [topic for topic in reader.topics if topic.msgtype in (IMAGE, COMPRESSED)
            and topic.name.removesuffix('/compressed').endswith(WIDE) and topic.count
            and name in (None, topic.name)]
    raw = {topic.name for topic in wide if topic.msgtype == IMAGE}
    return [topic for topic in wide if topic.msgtype == IMAGE
            or topic.name.removesuffix('/compressed') not in raw]
