"""`neo import`: bring a capture into a scene folder."""
from pathlib import Path
from typing import Annotated, Any, Optional

from neo_ros.errors import ConfigError, SceneError
import typer

FORMATS = 'scene, transforms, colmap, scannet, 7scenes, trajectory, bag, photos or video'


def import_scene(
    source: Annotated[str, typer.Argument(
        help='What was captured: nerfstudio or instant-ngp (transforms.json), COLMAP, ScanNet, '
             '7-Scenes, images with traj.txt, a ROS 2 bag, photos or a video without poses; or '
             'the word "demo" for the built-in flat.')],
    scene: Annotated[Path, typer.Argument(help='Scene folder to write.')],
    format_name: Annotated[Optional[str], typer.Option(
        '--format', help=f'{FORMATS}; by default told from the files.')] = None,
    image_topic: Annotated[Optional[str], typer.Option(
        help='Bags: the camera, where there are several.')] = None,
    pose_topic: Annotated[Optional[str], typer.Option(
        help='Bags: /tf, a topic of PoseStamped, PoseWithCovarianceStamped or Odometry, or none.',
    )] = None,
    keyframe_distance: Annotated[Optional[float], typer.Option(
        help='Keep the sharpest frame of every so many metres.')] = None,
    keyframe_angle: Annotated[Optional[float], typer.Option(
        help='Keep the sharpest frame of every so many degrees.')] = None,
    test_runs: Annotated[int, typer.Option(
        help='Hold a tenth of the photos back as test frames, in so many runs, to measure how '
             'good a model of this capture is.', min=0)] = 0,
    level: Annotated[bool, typer.Option(
        '--level', help='Turn the world so that z points up, as the photos were held.')] = False,
    scale: Annotated[Optional[float], typer.Option(
        help='Multiply all lengths by this factor; for models that are not in metres.')] = None,
    size: Annotated[Optional[int], typer.Option(
        help='Demo only: edge of the training photos in pixels; default: 128.', min=16)] = None,
    photos: Annotated[Optional[int], typer.Option(
        help='Demo only: number of photos; default: 1000.', min=1)] = None,
) -> None:
    """
    Bring photos with poses into a scene folder, check them, and say how good the capture is.

    Distorted photos are made straight. Photos without poses get them by structure from motion.
    The report on the capture is SCENE/capture.html. Run again after an interruption, the import
    goes on where it stopped.
    """
    from neo_ros.cli.options import refuse, tell_next
    from neo_ros.cli.progress import stage_progress
    from neo_ros.evaluation.capture_report import REPORT_FILE, write_capture_report
    from neo_ros.flat.scene_writing import write_demo_scene
    from neo_ros.scenes.formats import CaptureFormat, detect_format
    from neo_ros.scenes.held_out_runs import hold_out_runs
    from neo_ros.scenes.importing import import_transforms
    from neo_ros.scenes.levelling import read_upright_scene
    import rich
    from rich.markup import escape

    with stage_progress() as show:
        if source == 'demo':
            refuse('the demo has its own', test_runs=test_runs or None, format=format_name,
                   image_topic=image_topic, pose_topic=pose_topic,
                   keyframe_distance=keyframe_distance, keyframe_angle=keyframe_angle,
                   level=level, scale=scale)
            write_demo_scene(scene, image_size=size or 128, n_train=photos or 1000,
                             progress=lambda done, total: show('images', done, total))
            notes: list[str] = []
        else:
            refuse('expected only with "demo"', size=size, photos=photos)
            format_ = (detect_format(Path(source)) if format_name is None
                       else _named_format(format_name))
            if format_ != CaptureFormat.BAG:
                refuse('expected only with a bag', image_topic=image_topic, pose_topic=pose_topic)
            if format_ == CaptureFormat.SCENE:
                refuse(f'for captures, {source} is a scene already and is copied as it is',
                       keyframe_distance=keyframe_distance, keyframe_angle=keyframe_angle,
                       level=level, scale=scale)
                import_transforms(Path(source), scene,
                                  lambda done, total: show('images', done, total))
                notes = []
            else:
                notes = _import_capture(
                    Path(source), scene, format_, image_topic, pose_topic, keyframe_distance,
                    keyframe_angle, level, scale, show)
        if test_runs:
            train, test = hold_out_runs(scene, test_runs)
            notes.append(f'{len(test)} photos in {test_runs} runs are test frames; their middle '
                         f'columns will be widened; {len(train)} photos are left to train with')
        found = read_upright_scene(scene)
        verdict = write_capture_report(scene, found, notes,
                                       lambda done, total: show('capture report', done, total))
    camera = found.train.intrinsics
    tests = 'no test frames' if found.test is None else f'{len(found.test)} test frames'
    for line in [*notes, *verdict]:
        rich.print(escape(line))
    rich.print(f'{escape(str(scene))}: {len(found.train)} photos of '
               f'{camera.width}x{camera.height} pixels, {tests}')
    rich.print(f'Report on the capture: {escape(str(scene / REPORT_FILE))}')
    model = Path('out', found.name)
    if model.resolve() == scene.resolve():  # A training wants a folder of its own.
        model = Path('out', f'{found.name}_model')
    tell_next('neo', 'train', scene, '--out', model)


def _named_format(name: str) -> Any:
    from neo_ros.scenes.formats import CaptureFormat
    try:
        return CaptureFormat(name)
    except ValueError:
        raise ConfigError(f'--format: expected {FORMATS}, got {name!r}') from None


def _import_capture(source: Path, scene: Path, format_: Any, image_topic: Optional[str],
                    pose_topic: Optional[str], keyframe_distance: Optional[float],
                    keyframe_angle: Optional[float], level: bool, scale: Optional[float],
                    show: Any) -> list[str]:
    """Read, place, choose and write; returns what the user should know."""
    import math

    from neo_ros.scenes.capture_writing import write_capture
    from neo_ros.scenes.formats import CaptureFormat, FOLDER_READERS
    from neo_ros.scenes.keyframes import keyframes
    from neo_ros.scenes.levelling import CLEARLY_TILTED, level as level_world, scaled, tilt

    for option, value in (('--scale', scale), ('--keyframe-distance', keyframe_distance),
                          ('--keyframe-angle', keyframe_angle)):
        if value is not None and not (math.isfinite(value) and value > 0):
            raise ConfigError(f'{option}: expected a number > 0, got {value:g}')
    if source.resolve() == scene.resolve():
        raise SceneError(f'{scene}: expected another folder than the source')
    notes = []
    if format_ == CaptureFormat.BAG:
        from neo_ros.bags.capture import read_bag_capture
        capture = read_bag_capture(source, image_topic, pose_topic,
                                   lambda done, total: show('messages', done, total))
    elif format_ == CaptureFormat.VIDEO:
        from neo_ros.scenes.video import read_video
        capture = read_video(source, lambda done, total: show('video frames', done, total))
    else:
        capture = FOLDER_READERS[format_](source)
    if not capture.posed:
        from neo_ros.scenes.structure_from_motion import reconstruct
        capture, verdict = reconstruct(capture, scene / 'sfm', show)
        notes.append(str(verdict))
    elif level:
        capture = level_world(capture)
    else:
        angle = tilt([frame.pose for frame in capture.frames if frame.pose is not None])
        if angle > CLEARLY_TILTED:
            which = (', which points up in this format; if it does not' if capture.z_up
                     else '; if z shall point up')
            notes.append(f'the photos were held {math.degrees(angle):.0f} degrees from the '
                         f"world's z axis{which}, import with --level")
    if scale is not None:
        capture = scaled(capture, scale)
        notes.append(f'all lengths are multiplied by {scale:g}')
    if keyframe_distance is not None or keyframe_angle is not None:
        capture = keyframes(
            capture, keyframe_distance,
            None if keyframe_angle is None else math.radians(keyframe_angle),
            lambda done, total: show('sharpness', done, total))
    written = write_capture(capture, scene, lambda done, total: show('photos', done, total))
    return [*written, *notes]
