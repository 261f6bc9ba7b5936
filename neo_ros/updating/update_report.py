"""What an update found: places, a map, and views before and after."""
import cv2
from neo_ros.geometry import CameraPose, ViewExpansion
from neo_ros.memory.rendering import MemoryRenderer
from neo_ros.memory.scene_memory import SceneMemory
from neo_ros.reports.plan_view import FLOOR, PlanView
from neo_ros.reports.report import Picture, Section, Strip, Table, Text
from neo_ros.scenes.scene import Scene
from neo_ros.updating.changed_space import ChangedPlace
from neo_ros.updating.compared_photos import ComparedPhotos
from neo_ros.updating.driven_photos import Drive
from neo_ros.updating.growth import Growth
from neo_ros.updating.what_happened import Event
import numpy as np

STRIPS, MOST_PLACES = 4, 20
# Views that are shown are so far apart, metres, or look another way.
APART, COSINE = 0.5, 0.8
_PHOTO, _CHANGED = (150, 155, 165), (200, 40, 40)


def update_sections(bag: str, scene: Scene, expansion: ViewExpansion, drive: Drive,
                    compared: ComparedPhotos, places: list[ChangedPlace],
                    events: list[list[Event]], before: SceneMemory, after: SceneMemory,
                    seconds: float, growth: Growth | None, turned: int) -> list[Section]:
    """
    Return the part of a report that tells of one bag.

    events: of each place; turned: so many, the last ones, are as they were before an update.
    """
    what = 'changed places' if growth is None else 'changed or new places, the first is new'
    intro = (f'{len(drive.poses)} photos out of {drive.seen} images show {len(places)} '
             f'{what}; the update took {seconds / 60:.1f} minutes.')
    if drive.lost and growth is None:
        intro += (f' Of {len(drive.lost)} more nobody knows where they were taken, or they show '
                  'no place that is new.')
    told = [[event.value for event in happened] for happened in events]
    for happened in told[len(told) - turned:]:
        happened.append('as it was once')
    words = list(map(', '.join, told))
    if growth is not None:
        words[0] = 'new'
    rows = [(str(number), event, *(f'{low:.2f} to {high:.2f}' for low, high in zip(
        place.low, place.high)), str(place.photos))
            for number, (place, event) in enumerate(zip(places[:MOST_PLACES], words), 1)]
    return [Text(intro, f'Bag {bag}'),
            Table(('place', 'what happened', 'x, m', 'y, m', 'z, m', 'photos'), rows, note=(
                'Boxes around what may have changed; they are larger than the things in them. '
                'Something came where photos see a surface nearer than before, and left where '
                'they see farther. As it was once: as before an earlier update. Photos: how many '
                'say so.')),
            Picture('Changed places from above', _plan(scene, drive, places), (
                'Red, with the numbers of the table: what may have changed. Grey: where photos '
                'were taken, and where they looked. Pale green: free floor.')),
            *_strips(expansion, drive, compared, before, after),
            *([] if growth is None else _new_place(expansion, drive, growth, before, after))]


def _plan(scene: Scene, drive: Drive, places: list[ChangedPlace]) -> np.ndarray:
    floor = np.empty((0, 2)) if scene.walkable is None else scene.walkable.centres()
    corners = [corner[:2] for place in places[:MOST_PLACES] for corner in (place.low, place.high)]
    everything = np.concatenate([floor, scene.train.T_world_cam[:, :2, 3], np.stack(corners)])
    plan = PlanView(everything.min(0), everything.max(0))
    for centre in floor:
        assert scene.walkable is not None
        plan.shade(centre, scene.walkable.resolution, FLOOR)
    plan.draw_grid()
    for pose in drive.poses:
        plan.draw_look(pose.position[:2], pose.forward, _PHOTO, 10)
    for number, place in enumerate(places[:MOST_PLACES], 1):
        low, high = plan.place(place.low[:2]), plan.place(place.high[:2])
        cv2.rectangle(plan.image, low, high, _CHANGED, 2)
        cv2.putText(plan.image, str(number), (low[0] + 3, low[1] - 4), cv2.FONT_HERSHEY_SIMPLEX,
                    0.5, _CHANGED, 1, cv2.LINE_AA)
    return plan.image


def _strips(expansion: ViewExpansion, drive: Drive, compared: ComparedPhotos,
            before: SceneMemory, after: SceneMemory) -> list[Section]:
    strips: list[Section] = []
    chosen: list[CameraPose] = []
    renderers = {'before': MemoryRenderer(before), 'now': MemoryRenderer(after)}
    assert compared.photos.usable is not None
    shares = [float(contradicts[usable].mean()) if usable.any() else 0.0 for contradicts, usable
              in zip(compared.contradicts[compared.old:], compared.photos.usable[compared.old:])]
    for index in sorted(range(len(shares)), key=lambda index: -shares[index]):
        pose = drive.poses[index]
        if len(chosen) == STRIPS or not all(_apart(pose, other) for other in chosen):
            continue
        chosen.append(pose)
        strips.append(Strip(f'{shares[index]:.0%} of the image was not as before',
                            [('camera', _in_place(drive.images[index], expansion)), *(
                                (name, renderer.render(pose, expansion.target).image.astype(
                                    np.uint8)) for name, renderer in renderers.items())]))
    return [Text('Views of the bag that showed most of it, and what the memory shows there.',
                 'Before and after'), *strips]


def _new_place(expansion: ViewExpansion, drive: Drive, growth: Growth, before: SceneMemory,
               after: SceneMemory) -> list[Section]:
    """Return what was added; growth.T are among the drive's last poses."""
    tied, first = len(growth.tied.poses), len(drive.poses) - len(growth.tied.poses)
    intro = (f'Of {len(drive.lost)} images whose pose the memory did not know {tied} were placed '
             f'by what they have in common with others, {len(drive.lost) - tied} could not be; '
             f'{len(growth.T)} were taken where no photo was before. '
             f'{len(after.positions) - len(before.positions)} keyframes are new, '
             f'{_landmarks(after) - _landmarks(before)} landmarks more than before.')
    strips: list[Section] = []
    chosen: list[CameraPose] = []
    renderer = MemoryRenderer(after)
    for image, pose in zip(drive.images[first:], drive.poses[first:]):
        if len(chosen) == STRIPS:
            break
        if (growth.T == pose.T_world_cam).all((1, 2)).any() and all(
                _apart(pose, other) for other in chosen):
            chosen.append(pose)
            strips.append(Strip('The memory did not know where the camera was', [
                ('before', _in_place(image, expansion)),
                ('now', renderer.render(pose, expansion.target).image.astype(np.uint8))]))
    return [Text(intro, 'The new place'), *strips]


def _landmarks(memory: SceneMemory) -> int:
    return 0 if memory.landmarks is None else len(memory.landmarks.points)


def _apart(one: CameraPose, other: CameraPose) -> bool:
    return bool(np.linalg.norm(one.position - other.position) > APART
                or one.forward @ other.forward < COSINE)


def _in_place(image: np.ndarray, expansion: ViewExpansion) -> np.ndarray:
    target = expansion.target
    return expansion.paste(image, np.zeros((target.height, target.width, 3), np.uint8))
