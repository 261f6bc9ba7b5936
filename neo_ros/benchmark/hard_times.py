"""
Compare a guided model with its network where the memory could go wrong.

    python -m neo_ros.benchmark.hard_times models/demo_flat.onnx SCENE OTHER

Widens the test frames of SCENE as they are, with a camera that is carried elsewhere every few
images, that leaves the scene (images of OTHER) and comes back, with somebody in the image, in
other light, and blurred. Prints a Markdown table and writes results/hard_times.json.
"""
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
import json
from pathlib import Path
import sys
from typing import NamedTuple

import cv2
from neo_ros.benchmark.out_of_scene import by_walk, lit, seen_by
from neo_ros.errors import ModelError
from neo_ros.evaluation.evaluate import TruthFrames
from neo_ros.evaluation.metrics import psnr
from neo_ros.machine.files import write_bytes
from neo_ros.machine.host import commit, host
from neo_ros.runtime import FovExtrapolator
from neo_ros.scenes.scene import read_scene
import numpy as np

RESULTS = Path('results/hard_times.json')
CARRIED_EVERY = 5  # images
AWAY = 10          # images of elsewhere


class Shot(NamedTuple):
    """
    A camera image, RGB uint8 (h, w, 3), and the wide truth (H, W, 3), None of elsewhere.

    arrived: the first image in the scene after a jump; walk: the number of its walk.
    """

    image: np.ndarray
    truth: np.ndarray | None
    arrived: bool = False
    walk: int = 0


# The shots of one walk after the other.
Walks = Sequence[Sequence[Shot]]


@dataclass(frozen=True)
class CaseScores:
    """
    What became of the images of the scene in one case; PSNR in dB, of the ring.

    known: share that the memory knew; elsewhere_known: that of images from elsewhere.
    network_psnr: of the network alone, same images; worst_walk: by how much the guided model is
    ahead of it on the walk where that is least. search: most images after a jump that passed
    until the memory knew the place.
    """

    case: str
    frames: int
    known: float
    ring_psnr: float
    network_psnr: float
    worst_walk: float
    search: int | None
    elsewhere_known: float | None


def score_cases(model: Path, walks: Walks, elsewhere: Sequence[np.ndarray]) -> list[CaseScores]:
    """Score all cases; raises ModelError for a model without a memory."""
    guided, network = FovExtrapolator.load(model), FovExtrapolator.load(model, guided=False)
    if guided.card.memory is None:
        raise ModelError(f'{model}: expected a model with a scene memory, its card names none')
    return [_score(case, guided, network, spoilt)
            for case, spoilt in cases(walks, elsewhere).items()]


def cases(walks: Walks, elsewhere: Sequence[np.ndarray]) -> dict[str, Walks]:
    """Return the shots of every case by its name."""
    walks = [[shot._replace(walk=number) for shot in walk] for number, walk in enumerate(walks)]
    return {
        'as they are': walks,
        f'carried elsewhere every {CARRIED_EVERY} images': [_carried(walks)],
        'out of the scene and back': [_away(walk, elsewhere) for walk in walks],
        '30 % of the image hidden': _spoilt(walks, lambda at, image: _hidden(at, image, 0.3)),
        '40 % of the image hidden': _spoilt(walks, lambda at, image: _hidden(at, image, 0.4)),
        'a quarter of the light': [
            [shot._replace(image=lit(shot.image, 0.25),
                           truth=None if shot.truth is None else lit(shot.truth, 0.25))
             for shot in walk] for walk in walks],
        'blur, sigma 1.5 pixels': _spoilt(
            walks, lambda at, image: cv2.GaussianBlur(image, (0, 0), 1.5)),
        'motion blur of 7 pixels': _spoilt(walks, lambda at, image: cv2.blur(image, (7, 1))),
    }


def _carried(walks: Walks) -> list[Shot]:
    shots: list[Shot] = []
    for start in range(0, max(map(len, walks)), CARRIED_EVERY):
        for walk in walks:
            part = walk[start:start + CARRIED_EVERY]
            shots += [shot._replace(arrived=not index) for index, shot in enumerate(part)]
    return shots


def _away(walk: Sequence[Shot], elsewhere: Sequence[np.ndarray]) -> list[Shot]:
    half = len(walk) // 2
    return [*walk[:half], *(Shot(image, None) for image in elsewhere[:AWAY]),
            *(shot._replace(arrived=not index) for index, shot in enumerate(walk[half:]))]


def _spoilt(walks: Walks, spoil: Callable[[int, np.ndarray], np.ndarray]) -> Walks:
    return [[shot._replace(image=spoil(at, shot.image)) for at, shot in enumerate(walk)]
            for walk in walks]


def _hidden(at: int, image: np.ndarray, share: float) -> np.ndarray:
    """Let somebody with a coarse pattern walk through the image from the third one on."""
    if at < 2:
        return image
    height, width = image.shape[:2]
    wide = round(share * width)
    pattern = np.random.default_rng(0).integers(0, 256, (6, 3, 3)).astype(np.uint8)
    left = at * wide // 6 % (width - wide + 1)
    result = image.copy()
    result[:, left:left + wide] = cv2.resize(pattern, (wide, height),
                                             interpolation=cv2.INTER_CUBIC)
    return result


def _score(case: str, guided: FovExtrapolator, network: FovExtrapolator, walks: Walks
           ) -> CaseScores:
    ring = guided.expansion.extrapolated_mask
    known, away, searched = [], [], []
    scores: dict[int, list[tuple[float, float]]] = {}
    guided.forget_light()
    for walk in walks:
        guided.reset()
        waiting: int | None = None
        for shot in walk:
            wide = guided.expand(shot.image)
            if shot.truth is None:
                away.append(wide.guided)
                continue
            waiting = 0 if shot.arrived else waiting
            if waiting is not None:
                searched.append(waiting)
                waiting = None if wide.guided else waiting + 1
            known.append(wide.guided)
            alone = network.expand(shot.image).wide_image
            truth = shot.truth[ring]
            scores.setdefault(shot.walk, []).append(
                (psnr(truth, wide.wide_image[ring]), psnr(truth, alone[ring])))
    ours, alone = np.concatenate(list(scores.values())).mean(0).tolist()
    worst = min(float(np.mean([ahead - behind for ahead, behind in walk]))
                for walk in scores.values())
    return CaseScores(case, len(known), float(np.mean(known)), ours, alone, worst,
                      max(searched, default=None), float(np.mean(away)) if away else None)


def markdown(rows: Sequence[CaseScores]) -> str:
    """Return the table of the scores."""
    lines = ['| images | number | known by the memory | ring, dB | network alone, dB | ahead on '
             'the worst walk, dB | images until found |', '|---|---|---|---|---|---|---|']
    for row in rows:
        known = f'{row.known:.1%}' + ('' if row.elsewhere_known is None else (
            f' (of elsewhere {row.elsewhere_known:.1%})'))
        lines.append(f'| {row.case} | {row.frames} | {known} | {row.ring_psnr:.2f} | '
                     f'{row.network_psnr:.2f} | {row.worst_walk:.2f} | '
                     f'{"" if row.search is None else row.search} |')
    return '\n'.join(lines)


def main() -> None:
    """Score the model and the scenes of the command line, print the table and keep the figures."""
    if len(sys.argv) != 4:
        sys.exit('usage: python -m neo_ros.benchmark.hard_times MODEL.onnx SCENE OTHER')
    model, scene, other = (Path(argument) for argument in sys.argv[1:])
    view = FovExtrapolator.load(model, guided=False).expansion
    frames = TruthFrames(read_scene(scene).test, view)
    walks = by_walk(frames.images, lambda index: Shot(*frames.read(index)))
    photos = read_scene(other).train
    photos = photos.subset(range(min(AWAY, len(photos))))
    elsewhere = [image for walk in seen_by(view.source, photos) for image in walk]
    rows = score_cases(model, walks, elsewhere)
    write_bytes(RESULTS, (json.dumps({
        'model': model.name, 'scene': scene.name, 'elsewhere': other.name, 'commit': commit(),
        'host': host(), 'rows': [asdict(row) for row in rows]}, indent=1) + '\n').encode())
    print(markdown(rows))


if __name__ == '__main__':
    main()
