"""
Looks around on a bad link: predicted, and as they came, against those without delay.

    python -m neo_ros.speed.predicted_looks BAG --model MODEL

BAG: camera, poses and truth, as `neo demo` and `neo bag` make them. Rows go to
results/predicted_looks.json.
"""
from argparse import ArgumentParser
from collections.abc import Sequence
import math
from pathlib import Path
from typing import Any

from neo_ros.bags import BagReader
from neo_ros.bags.demo_bag import TRUTH_TOPIC
from neo_ros.evaluation.metrics import psnr
from neo_ros.geometry import CameraPose
from neo_ros.machine.result_rows import ResultRows
from neo_ros.memory.look_around import Direction, LookAround, SeenImage
from neo_ros.memory.scene_memory import SceneMemory
from neo_ros.messages import read_image
from neo_ros.messages.hints import read_pose
from neo_ros.messages.stamps import NS_PER_S
from neo_ros.runtime import read_model_card
from neo_ros.runtime.fov_extrapolator import memory_path
from neo_ros.viewer.whereabouts import Place, Whereabouts
import numpy as np

DELAYS_S = (0.3, 0.5, 1.0, 2.0)
# From where the camera looks; held while the robot turns.
TURNS_DEG = (60.0, 180.0, -60.0)
EVERY, SIDE, HFOV = 10, 256, math.radians(90)


def measure(walk: Sequence[tuple[float, CameraPose, np.ndarray]], looks: LookAround,
            delays_s: Sequence[float] = DELAYS_S) -> list[dict[str, Any]]:
    """
    Score looks that come late; return a row a delay.

    walk: seconds, pose and wide image, uint8 RGB (H, W, 3), of each frame. `as_came`: drawn at
    the last place that has come; `predicted`: where the motion leads, as the viewer does.
    """
    rows = []
    for delay in delays_s:
        errors: dict[str, list[float]] = {'as_came': [], 'predicted': []}
        scores: dict[str, list[float]] = {'as_came': [], 'predicted': []}
        for number in range(EVERY, len(walk), EVERY):
            now, pose, wide = walk[number]
            came = [frame for frame in walk[:number] if frame[0] <= now - delay]
            if not came or now - came[0][0] < 1 + delay:
                continue
            where = Whereabouts()
            for at, known, _ in came:
                where.put(Place(known, at))
            predicted = where.predicted(now)
            assert predicted is not None
            last = SeenImage(_seen(looks, came[-1][2]), came[-1][1])
            live = SeenImage(_seen(looks, wide), pose)
            places = {'as_came': came[-1][1].position, 'predicted': predicted}
            for name, place in places.items():
                errors[name].append(float(np.linalg.norm(place - pose.position)))
            for turn in TURNS_DEG:
                forward = pose.forward
                yaw = math.atan2(forward[1], forward[0]) + math.radians(turn)
                direction = Direction(yaw, 0.0, HFOV, SIDE, SIDE)
                truth = looks.draw(pose.position, direction, live).image
                for name, place in places.items():
                    shown = looks.draw(place, direction, None, [last]).image
                    scores[name].append(psnr(truth, shown))
        rows.append({'delay_s': delay, 'looks': len(scores['as_came']), **{
            f'{name}_{key}': float(np.median(values)) * factor
            for key, found, factor in (('position_cm', errors, 100), ('psnr', scores, 1))
            for name, values in found.items()}})
    return rows


def read_walk(bag: Path, images_of: str = TRUTH_TOPIC
              ) -> list[tuple[float, CameraPose, np.ndarray]]:
    """Return seconds, pose and wide image of a replay's frames whose pose is known."""
    poses, images = {}, {}
    with BagReader(bag) as reader:
        for message in reader.messages([images_of, '/camera/wide/pose']):
            content = message.read()
            if message.topic.name == images_of:
                images[message.stamp_ns] = read_image(content)
            else:
                poses[message.stamp_ns] = read_pose(content.pose.pose)
    return [(stamp / NS_PER_S, pose, images[stamp]) for stamp, pose in sorted(poses.items())]


def _seen(looks: LookAround, wide: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(looks.expansion.crop(wide))


def main() -> None:
    """Measure and write the rows."""
    parser = ArgumentParser(description=__doc__)
    parser.add_argument('bag', type=Path)
    parser.add_argument('--model', type=Path, required=True)
    parser.add_argument('--out', type=Path, default=Path('results/predicted_looks.json'))
    given = parser.parse_args()
    card = read_model_card(given.model)
    assert card.memory is not None
    memory = SceneMemory.read(memory_path(given.model, card.memory), card.memory.sha256)
    rows = ResultRows(given.out)
    for row in measure(read_walk(given.bag), LookAround(memory, card.expansion)):
        rows.add({'scene': card.scene_id, **row})


if __name__ == '__main__':
    main()
