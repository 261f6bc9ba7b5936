"""From what was recorded to a scene folder: read, place, level, scale, choose, write, report."""
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
import math
from pathlib import Path
from types import MappingProxyType
from typing import Any

from neo_ros.captures.bag import BagOptions, read_bag_capture
from neo_ros.captures.capture import Capture
from neo_ros.captures.formats import CaptureFormat, FOLDER_READERS
from neo_ros.captures.frame_selection import select_frames
from neo_ros.captures.held_out_runs import hold_out_runs
from neo_ros.captures.levelling import CLEARLY_TILTED, held_poses, level_world, scaled
from neo_ros.captures.masks import find_masks
from neo_ros.captures.photos import find_photos, read_photos
from neo_ros.captures.picture_steps import select_by_picture
from neo_ros.captures.report import write_capture_report
from neo_ros.captures.scene_copying import import_transforms
from neo_ros.captures.scene_writing import check_apart, write_capture
from neo_ros.captures.sfm_stages import EXHAUSTIVE_UP_TO
from neo_ros.captures.structure_from_motion import reconstruct
from neo_ros.captures.video import read_video
from neo_ros.errors import ConfigError, SceneError
from neo_ros.geometry.lens import LEAST_VIEW, MOST_VIEW
from neo_ros.machine.progress import of_stage, StageProgress
from neo_ros.scenes.scene import Scene
from neo_ros.scenes.upright import read_upright_scene, tilt
import numpy as np


@dataclass(frozen=True)
class ImportOptions:
    """
    What the user says of a capture; each is an option of `neo import`.

    bag                                 of bags
    folder                              of folders, those of FOLDER_OPTIONS that were given
    keyframe_distance, keyframe_angle   metres, degrees: keep the sharpest frame of every step
    level                               turn the world so that z points up
    scale                               multiply all lengths by this
    fisheye_view                        degrees: the widest view that is cut out of a fisheye
    depth_unit                          metres of one step of the depth's numbers; 0: no depth
    """

    bag: BagOptions = BagOptions()
    folder: Mapping[str, Any] = MappingProxyType({})
    keyframe_distance: float | None = None
    keyframe_angle: float | None = None
    level: bool = False
    scale: float | None = None
    fisheye_view: float | None = None
    depth_unit: float | None = None

    def __post_init__(self) -> None:
        for name in ('scale', 'keyframe_distance', 'keyframe_angle'):
            value = getattr(self, name)
            if value is not None and not (math.isfinite(value) and value > 0):
                raise ConfigError(
                    f'--{name.replace("_", "-")}: expected a number > 0, got {value:g}')
        unit = self.depth_unit
        if unit is not None and not (math.isfinite(unit) and unit >= 0):
            raise ConfigError(f'--depth-unit: expected metres > 0, or 0 for no depth, got '
                              f'{unit:g}')
        view = self.fisheye_view
        if view is not None and not LEAST_VIEW <= view <= MOST_VIEW:
            raise ConfigError(f'--fisheye-view: expected {LEAST_VIEW:g} to {MOST_VIEW:g} degrees, '
                              f'got {view:g}')


def import_capture(source: Path, scene: Path, format_: CaptureFormat, options: ImportOptions,
                   progress: StageProgress) -> list[str]:
    """
    Bring a capture of any format into a scene folder.

    Returns what the user should know, in sentences. Raises NeoError that names what is wrong.
    """
    if source.resolve() == scene.resolve():
        raise SceneError(f'{scene}: expected another folder than the source')
    # Of photos that are shown upright no frame names the file.
    check_apart(scene, [source, *(
        find_photos(source) if format_ == CaptureFormat.PHOTOS else [])])
    if format_ == CaptureFormat.SCENE:
        import_transforms(source, scene, of_stage(progress, 'images'))
        return []
    capture, notes = _read(source, format_, options, progress), []
    check_apart(scene, [frame.file for frame in capture.frames if frame.file is not None])
    if options.depth_unit is not None:
        capture = _with_depth_unit(capture, options.depth_unit)
    if options.fisheye_view is not None:
        capture = _with_fisheye_view(capture, options.fisheye_view)
    if not capture.posed:
        try:
            # Of a video they are chosen while it is read.
            if format_ == CaptureFormat.BAG and len(capture) > EXHAUSTIVE_UP_TO:
                capture = select_by_picture(capture, of_stage(progress, 'frames'))
            capture, verdict = reconstruct(capture, scene / 'sfm', progress)
        except SceneError as error:
            # What was left out may be why it failed.
            raise SceneError('; '.join([str(error), *capture.notes])) from error
        notes.append(str(verdict))
    elif options.level:
        capture = level_world(capture)
    else:
        frames_may_differ = format_ == CaptureFormat.BAG and not options.bag.x_forward
        notes += _tilt_note(capture, frames_may_differ)
    if options.scale is not None:
        capture = scaled(capture, options.scale)
        notes.append(f'all lengths are multiplied by {options.scale:g}')
    if options.keyframe_distance is not None or options.keyframe_angle is not None:
        angle = options.keyframe_angle
        capture = select_frames(
            capture, options.keyframe_distance, None if angle is None else math.radians(angle),
            of_stage(progress, 'sharpness'))
    return [*notes, *write_capture(capture, scene, of_stage(progress, 'photos'),
                                   of_stage(progress, 'depth'))]


def finish_scene(scene: Path, notes: Sequence[str], test_runs: int,
                 progress: StageProgress) -> tuple[Scene, list[str]]:
    """
    Hold test frames back and write the report on the capture into a scene folder.

    Returns the scene as trainings read it, and what the user should know: the notes of the
    import, and how good the capture is.
    """
    notes = list(notes)
    if test_runs:
        train, test = hold_out_runs(scene, test_runs)
        notes.append(f'{len(test)} photos in {test_runs} runs are test frames; their middle '
                     f'columns will be widened; {len(train)} photos are left to train with')
    found = read_upright_scene(scene)
    verdict = write_capture_report(scene, found, notes, of_stage(progress, 'capture report'))
    return found, [*notes, *verdict]


def _read(source: Path, format_: CaptureFormat, options: ImportOptions,
          progress: StageProgress) -> Capture:
    if format_ == CaptureFormat.BAG:
        return read_bag_capture(source, options.bag, of_stage(progress, 'messages'))
    if format_ == CaptureFormat.VIDEO:
        return read_video(source, of_stage(progress, 'video frames'), **options.folder)
    if format_ == CaptureFormat.PHOTOS:
        capture = read_photos(
            source, progress=of_stage(progress, 'photo files'), **options.folder)
    else:
        capture = FOLDER_READERS[format_](source, **options.folder)
    return find_masks(capture, source)


def _with_depth_unit(capture: Capture, unit: float) -> Capture:
    if not any(frame.depth for frame in capture.frames):
        raise SceneError('--depth-unit: expected a capture with depth that can be read, this one '
                         'has none; leave the option out')
    return replace(capture, frames=tuple(
        replace(frame, depth=replace(frame.depth, unit=unit) if frame.depth and unit else None)
        for frame in capture.frames))


def _with_fisheye_view(capture: Capture, degrees: float) -> Capture:
    lenses = {frame.lens for frame in capture.frames if frame.lens is not None}
    if not any(lens.fisheye for lens in lenses):
        raise SceneError('--fisheye-view: expected a fisheye, the cameras are none; '
                         'leave the option out')
    changed = {lens: replace(lens, fisheye_view=degrees) for lens in lenses}
    return replace(capture, frames=tuple(
        frame if frame.lens is None else replace(frame, lens=changed[frame.lens])
        for frame in capture.frames))


def _tilt_note(capture: Capture, frames_may_differ: bool) -> list[str]:
    """Say that the photos were not held upright, and which option may mend that."""
    poses = held_poses(capture)
    angle = tilt(poses)
    if angle <= CLEARLY_TILTED:
        return []
    # A frame that looks along x has its z axis up; that of a camera on its side lies level.
    z_axis = np.mean([pose.T_world_cam[:3, 2] for pose in poses], axis=0)
    upright = z_axis[2] >= math.cos(CLEARLY_TILTED) * np.linalg.norm(z_axis)
    if frames_may_differ and upright:
        return [f'the photos were held {math.degrees(angle):.0f} degrees from the '
                "world's z axis, but upright if the frame of the images looks along x, as in "
                'Gazebo: then import with --x-forward']
    which = (', which points up in this format; if it does not' if capture.z_up
             else '; if z shall point up')
    return [f'the photos were held {math.degrees(angle):.0f} degrees from the '
            f"world's z axis{which}, import with --level"]
