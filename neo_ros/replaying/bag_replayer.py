"""One bag: widened, and scored if asked."""
from dataclasses import dataclass
from pathlib import Path
import shutil
from typing import Any

from neo_ros.bags import BagReader, replay, ReplayResult, Section
from neo_ros.bags.camera_choice import CameraChoice, find_camera
from neo_ros.bags.camera_topics import find_truth_topic
from neo_ros.bags.replay import OnImages
from neo_ros.bags.replay_outputs import DEFAULT_OUTPUTS
from neo_ros.errors import BagError
from neo_ros.evaluation.bag_scores import BagScores
from neo_ros.machine.progress import no_progress, Progress
from neo_ros.runtime import FovExtrapolator
import numpy as np


@dataclass(frozen=True)
class ReplayOptions:
    """
    What is wanted of a replay, see `bags.replay`.

    camera       which one is widened
    score        against the wide images of the bag, or, if it has none, the camera's own border
    truth_topic  wide images to score against, whether `score` is set or not
    """

    camera: CameraChoice = CameraChoice()
    section: Section = Section()
    score: bool = False
    truth_topic: str | None = None
    outputs: tuple[str, ...] = tuple(DEFAULT_OUTPUTS)
    copy: bool = True


@dataclass(frozen=True)
class ScoredReplay:
    """
    What a replay did, and its scores.

    guided       share of the frames that the scene memory knew; None without memory
    scores       None where nothing was or could be scored
    truth_topic  the wide images that were looked for to score against
    about        what was scored, for `BagScores.write`
    """

    result: ReplayResult
    guided: float | None
    scores: BagScores | None
    truth_topic: str | None
    about: dict[str, Any]


class BagReplayer:
    """
    Replays bags with one model.

    A bag gives the same bytes whichever were replayed before it, unless the model learns.
    `threads` = 0 takes all cores; the bytes do not depend on it. `extrapolator` is loaded as by
    `FovExtrapolator.load`, whose ModelError passes through.
    """

    def __init__(self, model: Path, threads: int = 0, learn: bool = False) -> None:
        self.model = model
        self.extrapolator = FovExtrapolator.load(
            model, threads, learn='at once' if learn else 'never')
        self._threads, self._learns = threads, learn
        self._scored: FovExtrapolator | None = None

    def replay(self, bag: Path, out: Path, options: ReplayOptions,
               on_frame: OnImages | None = None, on_progress: Progress = no_progress
               ) -> ScoredReplay:
        """
        Write the new bag `out`; its scores are the caller's to write.

        on_frame  as in `bags.replay`
        Raises BagError as `bags.replay` does, and where no image could be widened; of that nothing
        is left.
        """
        self.extrapolator.reset()
        if not self._learns:  # Else a bag would depend on those before it.
            self.extrapolator.forget_light()
        scores, truth_topic = self._scores(bag, options)
        takers = [] if on_frame is None else [on_frame]
        if scores is not None and truth_topic is None:
            takers.append(scores.add_frame)

        def take(stamp_ns: int, image: np.ndarray, wide_image: np.ndarray) -> None:
            for taker in takers:
                taker(stamp_ns, image, wide_image)

        result = replay(
            bag, self.extrapolator, out, options.camera, truth_topic, options.copy,
            options.section, take if takers else None,
            None if scores is None else scores.add_pair, on_progress, options.outputs)
        if not result.frames:
            shutil.rmtree(out, ignore_errors=True)  # It would stand in the way of the next try.
            raise BagError(f'{bag}: no image could be widened{_why(result)}')
        card, guided = self.extrapolator.card, None
        if card.memory is not None:
            guided = round(result.guided / result.frames, 4)
        about = {'bag': bag.name, 'image_topic': result.image_topic, 'truth_topic': truth_topic,
                 'model': self.model.name, 'scene_id': card.scene_id,
                 'config_hash': card.config_hash,
                 # What the camera scores against itself are other frames than these.
                 'guided': guided if truth_topic is not None else None}
        return ScoredReplay(result, guided, scores if scores is not None and scores.rows else None,
                            truth_topic, about)

    def _scores(self, bag: Path, options: ReplayOptions) -> tuple[BagScores | None, str | None]:
        """Return what scores the frames, and the topic of the truth; None for none."""
        truth_topic = options.truth_topic
        if not options.score and truth_topic is None:
            return None, None
        expansion = self.extrapolator.expansion
        if truth_topic is None:
            with BagReader(bag) as reader:
                camera = find_camera(reader, expansion.source, options.camera).image
                found = find_truth_topic(reader, camera,
                                         (expansion.target.width, expansion.target.height))
            truth_topic = None if found is None else found.name
        if truth_topic is not None:
            return BagScores(expansion), truth_topic
        # An extrapolator of its own: the one that widens the bag may remember what it saw.
        if self._scored is None:
            self._scored = FovExtrapolator.load(self.model, self._threads)
        self._scored.reset()
        self._scored.forget_light()
        expand = self._scored.expand
        return BagScores(expansion, lambda image: expand(image).wide_image), None


def _why(result: ReplayResult) -> str:
    """Say why no image was widened; empty where there was none."""
    rejected = [f'rejected: {count} x {reason}, the first: {result.words[reason]}'
                for reason, count in result.rejected.most_common(1)]
    return ''.join(f'; {words}' for words in (*rejected, *result.damages))
