"""
How well the out-of-scene score tells images of the trained scene from all others.

    python -m neo_ros.benchmark.out_of_scene models/demo_flat.onnx SCENE OTHER...

Runs the model, guided by its memory and the network alone, over the test frames of SCENE, of
other scene folders, and of SCENE spoilt. Prints a Markdown table and writes
results/out_of_scene.json.
"""
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
import json
from pathlib import Path
import sys
from types import SimpleNamespace
from typing import TypeVar

import cv2
from neo_ros.errors import ModelError, SceneError
from neo_ros.evaluation.evaluate import TruthFrames
from neo_ros.evaluation.metrics import auroc
from neo_ros.geometry import Intrinsics
from neo_ros.machine.files import write_bytes
from neo_ros.machine.host import commit, host
from neo_ros.messages import FrameProcessor, image_fields
from neo_ros.runtime import FovExtrapolator
from neo_ros.scenes.posed_images import PosedImages
from neo_ros.scenes.scene import read_scene
import numpy as np

RESULTS = Path('results/out_of_scene.json')
FINGER = (96, 34, 24)  # dark red: light through skin
# The images of one walk after the other, uint8 RGB (h, w, 3).
Walks = Sequence[Sequence[np.ndarray]]
Spoil = Callable[[np.ndarray], np.ndarray]
_Read = TypeVar('_Read')


@dataclass(frozen=True)
class SceneScores:
    """
    What the model made of some frames; AUROC is against the scene's own test frames.

    known: share that the memory knew. score, auroc: guided by the memory, None without one;
    network_score, network_auroc: of the network alone. score and network_score are means.
    """

    frames: str
    count: int
    known: float | None
    score: float | None
    auroc: float | None
    network_score: float
    network_auroc: float


def score_scenes(model: Path, scene: Path, others: Sequence[Path]) -> list[SceneScores]:
    """
    Score the test frames of a scene, first as they are, and everything that is not they.

    Raises ModelError where the card holds no reference of the scene, SceneError for scenes
    without test frames, and what `FovExtrapolator.load` and `TruthFrames` raise.
    """
    network = FovExtrapolator.load(model, guided=False)
    if network.scene_check is None:
        raise ModelError(f'{model}: its card says nothing of how the scene looks; train it again')
    models = [network]
    if network.card.memory is not None:
        models.append(FovExtrapolator.load(model))
    frames = TruthFrames(read_scene(scene).test, network.expansion)
    own = by_walk(frames.images, lambda index: frames.read(index)[0])
    usual = [_scores(one, own) for one in models]

    def row(name: str, found: list[tuple[np.ndarray, float]]) -> SceneScores:
        (_, *network_alone), *with_memory = [
            (known, float(score.mean()), auroc(score, before))
            for (score, known), (before, _) in zip(found, usual)]
        known, mean, area = with_memory[0] if with_memory else (None, None, None)
        return SceneScores(name, len(found[0][0]), known, mean, area, *network_alone)

    def judge(name: str, walks: Walks) -> SceneScores:
        return row(name, [_scores(one, walks) for one in models])

    rows = [row(f'{scene.name}, its test frames', usual)]
    for folder in others:
        images = read_scene(folder).test
        if images is None:
            raise SceneError(f'{folder}: expected test frames (transforms_test.json), got none')
        rows.append(judge(folder.name, seen_by(network.expansion.source, images)))
    return rows + [judge(name, [[spoil(image) for image in walk] for walk in own])
                   for name, spoil in spoils().items()]


def spoils() -> dict[str, Spoil]:
    """Return by name what may happen to an image, uint8 RGB (h, w, 3); light is in grey levels."""
    random = np.random.default_rng(0)
    return {
        'lens cap': np.zeros_like,
        'finger over the lens': _finger,
        'a tenth of the light': lambda image: lit(image, 0.1),
        'a quarter of the light': lambda image: lit(image, 0.25),
        'blur, sigma 1.5 pixels': lambda image: cv2.GaussianBlur(image, (0, 0), 1.5),
        'motion blur of 7 pixels': lambda image: cv2.blur(image, (7, 1)),
        'half of the lens covered': _half_covered,
        'harmless: a fifth more light': lambda image: lit(image, 1.2),
        'harmless: a fifth less light': lambda image: lit(image, 0.8),
        'harmless: noise of 3 grey levels':
            lambda image: _rounded(image + random.normal(0, 3, image.shape)),
        'harmless: JPEG at quality 80': _jpeg,
    }


def markdown(rows: Sequence[SceneScores]) -> str:
    """Return the table of the scores."""
    lines = ['| frames | number | known by the memory | mean score | AUROC | mean score, '
             'network alone | AUROC, network alone |', '|---|---|---|---|---|---|---|']
    for row in rows:
        values = (row.score, row.auroc, row.network_score, row.network_auroc)
        cells = [row.frames, str(row.count), '' if row.known is None else f'{row.known:.1%}',
                 *('' if value is None else f'{value:.3f}' for value in values)]
        lines.append('| ' + ' | '.join(cells) + ' |')
    return '\n'.join(lines)


def _scores(extrapolator: FovExtrapolator, walks: Walks) -> tuple[np.ndarray, float]:
    """Return the score of every frame as the node gives it, and the share that is guided."""
    processor = FrameProcessor(extrapolator)
    scores, guided = [], []
    for walk in walks:
        extrapolator.reset()
        for image in walk:
            frame = processor.process(SimpleNamespace(**image_fields(image)), None)
            scores.append(frame.out_of_scene)
            guided.append(frame.guided)
    return np.array(scores, np.float64), float(np.mean(guided))


def by_walk(images: PosedImages, read: Callable[[int], _Read]) -> list[list[_Read]]:
    """Read all images, a list for each walk; a new one begins where the path's number changes."""
    walks: list[list[_Read]] = []
    for index, path_id in enumerate(images.path_ids):
        if not index or path_id != images.path_ids[index - 1]:
            walks.append([])
        walks[-1].append(read(index))
    return walks


def seen_by(camera: Intrinsics, images: PosedImages) -> Walks:
    """
    Cut the view of a camera out of the middle of images, and resample it to the camera's size.

    Where the images are narrower, the largest window of that shape.
    """
    taken = images.intrinsics
    width, height = (camera.width / camera.fx * taken.fx, camera.height / camera.fy * taken.fy)
    shrink = min(1.0, taken.width / width, taken.height / height)
    size = (round(width * shrink), round(height * shrink))
    left, top = ((full - part) // 2 for full, part in zip((taken.width, taken.height), size))
    method = cv2.INTER_AREA if size[0] > camera.width else cv2.INTER_LINEAR
    return by_walk(images, lambda index: cv2.resize(
        images.read_image(index)[top:top + size[1], left:left + size[0]],
        (camera.width, camera.height), interpolation=method))


def lit(image: np.ndarray, gain: float) -> np.ndarray:
    """Return an image, RGB uint8, with more or less light."""
    return _rounded(image * gain)


def _rounded(image: np.ndarray) -> np.ndarray:
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def _finger(image: np.ndarray) -> np.ndarray:
    """Return a dark reddish picture, twice as bright at one side as at the other."""
    light = np.linspace(0.5, 1, image.shape[1])[:, None] * np.array(FINGER)
    return _rounded(np.broadcast_to(light, image.shape))


def _half_covered(image: np.ndarray) -> np.ndarray:
    covered = image.copy()
    covered[:, :image.shape[1] // 2] = 0
    return covered


def _jpeg(image: np.ndarray) -> np.ndarray:
    encoded = cv2.imencode('.jpg', cv2.cvtColor(image, cv2.COLOR_RGB2BGR),
                           [cv2.IMWRITE_JPEG_QUALITY, 80])[1]
    decoded = cv2.imdecode(encoded, cv2.IMREAD_COLOR)
    assert decoded is not None
    return cv2.cvtColor(decoded, cv2.COLOR_BGR2RGB)


def main() -> None:
    """Score the model and the scenes of the command line, print the table and keep the figures."""
    if len(sys.argv) < 3:
        sys.exit('usage: python -m neo_ros.benchmark.out_of_scene MODEL.onnx SCENE [OTHER...]')
    model, scene, *others = (Path(argument) for argument in sys.argv[1:])
    rows = score_scenes(model, scene, others)
    write_bytes(RESULTS, (json.dumps({
        'model': model.name, 'scene': scene.name, 'commit': commit(), 'host': host(),
        'rows': [asdict(row) for row in rows]}, indent=1) + '\n').encode())
    print(markdown(rows))


if __name__ == '__main__':
    main()
