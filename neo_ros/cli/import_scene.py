"""`neo import`: bring a capture into a scene folder."""
from pathlib import Path
from typing import Annotated, Any, Optional

from neo_ros.errors import ConfigError
import typer

# Photos that are trained on in their full size without --minutes, pixels.
SMALL = 256
SYNTHETIC = 'This scene is synthetic: its photos are computed, nobody took them.'
FORMATS = ('scene, transforms, colmap, scannet, 7scenes, tum, euroc, record3d, polycam, '
           'trajectory, bag, photos or video')


def import_scene(
    source: Annotated[str, typer.Argument(
        help='What was captured: nerfstudio or instant-ngp (transforms.json), COLMAP, ScanNet, '
             '7-Scenes, TUM RGB-D, EuRoC, Record3D, Polycam, images with traj.txt, a ROS 2 bag, '
             'photos or a video without poses; or the word "demo" for the built-in flat.')],
    scene: Annotated[Path, typer.Argument(help='Scene folder to write.')],
    format_name: Annotated[Optional[str], typer.Option(
        '--format', help=f'{FORMATS}; by default told from the files.')] = None,
    image_topic: Annotated[Optional[str], typer.Option(
        help='Bags: the camera, where there are several.')] = None,
    pose_topic: Annotated[Optional[str], typer.Option(
        help='Bags: /tf, another topic of transforms or poses (PoseStamped, '
             'PoseWithCovarianceStamped, Odometry, TransformStamped, Path, PoseArray), or none.',
    )] = None,
    info_topic: Annotated[Optional[str], typer.Option(
        help='Bags: the CameraInfo of the images, where it is not beside them.')] = None,
    camera_info: Annotated[Optional[Path], typer.Option(
        help='Bags, videos and folders without calibration: a file with it, '
             "camera_calibration's YAML or the keys of a transforms.json.")] = None,
    images: Annotated[Optional[Path], typer.Option(
        help='COLMAP: the folder that the names of the images start from.')] = None,
    model: Annotated[Optional[int], typer.Option(
        help='COLMAP: the number of one of several models; default: the largest.')] = None,
    base_to_camera: Annotated[Optional[str], typer.Option(
        help='Bags without /tf_static: where the frame of the images is on the body, "x y z roll '
             'pitch yaw" in metres and radians, as the origin of a URDF joint.')] = None,
    x_forward: Annotated[bool, typer.Option(
        '--x-forward', help='Bags: the frame of the images looks along x, as in Gazebo, not '
                            'along z.')] = False,
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
    fisheye_view: Annotated[Optional[float], typer.Option(
        help='Degrees of the widest view that is cut out of a fisheye; default: 120.')] = None,
    depth_unit: Annotated[Optional[float], typer.Option(
        help='Metres that one step of the depth maps means, where the format says it wrongly; 0: '
             'leave the depth out.')] = None,
    size: Annotated[Optional[int], typer.Option(
        help='Demo only: edge of the training photos in pixels; default: 128.', min=16)] = None,
    camera: Annotated[Optional[str], typer.Option(
        help='Demo only: another camera than a square one of 90 degrees: WIDTHxHEIGHT@DEGREES, as '
             '640x480@69.')] = None,
    depth: Annotated[bool, typer.Option(
        '--depth', help='Demo only: depth maps as well, with the faults of a depth camera.',
    )] = False,
    photos: Annotated[Optional[int], typer.Option(
        help='Demo only: number of photos; default: 1000, of a building all that a mapping robot '
             'takes.', min=1)] = None,
    rooms: Annotated[Optional[int], typer.Option(
        help='Demo only: instead of the flat a building with so many rooms on each floor, 20 m2 '
             'each.')] = None,
    floors: Annotated[Optional[int], typer.Option(
        help='Demo only: floors of the building; default: 1.')] = None,
    twins: Annotated[Optional[int], typer.Option(
        help='Demo only: pairs of rooms of a floor that are equal; default: 0.')] = None,
    own_picture: Annotated[bool, typer.Option(
        '--own-picture', help='Demo only: the rooms of a pair differ in one picture.')] = False,
    seed: Annotated[Optional[int], typer.Option(
        help='Demo only: another building for each number; default: 0.', min=0)] = None,
) -> None:
    """
    Bring photos with poses into a scene folder, check them, and say how good the capture is.

    Distorted photos are made straight. Photos without poses get them by structure from motion.
    The report on the capture is SCENE/capture.html. Run again after an interruption, the import
    goes on where it stopped.
    """
    from neo_ros.captures.importing import finish_scene
    from neo_ros.cli.options import refuse
    from neo_ros.cli.progress import stage_progress

    of_bags: dict[str, Any] = {
        'image_topic': image_topic, 'info_topic': info_topic,
        'pose_topic': pose_topic, 'base_to_camera': base_to_camera, 'x_forward': x_forward}
    of_folders: dict[str, Any] = {'images': images, 'model': model, 'camera_info': camera_info}
    of_captures: dict[str, Any] = {
        'keyframe_distance': keyframe_distance, 'keyframe_angle': keyframe_angle, 'level': level,
        'scale': scale, 'fisheye_view': fisheye_view, 'depth_unit': depth_unit}
    of_views: dict[str, Any] = {'size': size, 'camera': camera, 'photos': photos, 'depth': depth}
    of_buildings: dict[str, Any] = {
        'rooms': rooms, 'floors': floors, 'twins': twins, 'own_picture': own_picture, 'seed': seed}
    with stage_progress() as show:
        notes: list[str] = []
        if source == 'demo':
            refuse('the demo has its own', test_runs=test_runs or None, format=format_name,
                   **of_captures, **of_bags, **of_folders)
            _write_demo(scene, of_views, of_buildings, show)
            notes = [SYNTHETIC]
        else:
            refuse('expected only with "demo"', **of_views, **of_buildings)
            notes = _import_capture(Path(source), scene, format_name, of_bags, of_folders,
                                    of_captures, show)
        found, notes = finish_scene(scene, notes, test_runs, show)
    _tell(scene, found, notes)


def _write_demo(scene: Path, of_views: dict[str, Any], of_buildings: dict[str, Any], show: Any
                ) -> None:
    from neo_ros.cli.options import camera_of, refuse
    from neo_ros.flat.building_plan import BuildingPlan
    from neo_ros.flat.scene_writing import write_building_scene, write_demo_scene

    size, camera, photos = of_views['size'], None, of_views['photos']
    if of_views['camera'] is not None:
        camera = camera_of(of_views['camera'])
        refuse('--camera says it', size=size)
    rooms, floors, twins, own_picture, seed = of_buildings.values()
    if rooms is None:
        refuse('expected only with --rooms', **of_buildings)
        write_demo_scene(scene, image_size=size or 128, camera=camera, n_train=photos or 1000,
                         depth=of_views['depth'],
                         progress=lambda done, total: show('images', done, total))
    else:
        plan = BuildingPlan(1 if floors is None else floors, rooms, seed or 0, twins or 0,
                            own_picture)
        write_building_scene(scene, plan, image_size=size or 128, camera=camera, n_train=photos,
                             depth=of_views['depth'], progress=show)


def _import_capture(source: Path, scene: Path, format_name: str | None, of_bags: dict[str, Any],
                    of_folders: dict[str, Any], of_captures: dict[str, Any], show: Any
                    ) -> list[str]:
    """Import a capture with the options that its format has; return what the user should know."""
    from neo_ros.captures.bag import BagOptions
    from neo_ros.captures.formats import CaptureFormat, detect_format, FOLDER_OPTIONS
    from neo_ros.captures.importing import import_capture, ImportOptions
    from neo_ros.cli.options import refuse

    format_ = detect_format(source) if format_name is None else _named_format(format_name)
    if format_ != CaptureFormat.BAG:
        refuse('expected only with a bag', **of_bags)
    for name, value in of_folders.items():
        if format_ not in FOLDER_OPTIONS[name]:
            refuse('expected only with ' + ', '.join(
                one.value for one in FOLDER_OPTIONS[name]), **{name: value})
    if format_ == CaptureFormat.SCENE:
        refuse(f'for captures, {source} is a scene already and is copied as it is', **of_captures)
    folder = {} if format_ == CaptureFormat.BAG else {
        name: value for name, value in of_folders.items() if value is not None}
    return import_capture(source, scene, format_, ImportOptions(
        BagOptions(**of_bags, camera_info=of_folders['camera_info']), folder, **of_captures),
        show)


def _tell(scene: Path, found: Any, notes: list[str]) -> None:
    """Print what was imported, and what comes next."""
    from neo_ros.captures.report import REPORT_FILE
    from neo_ros.cli.options import tell_next
    import rich
    from rich.markup import escape

    photo = found.train.intrinsics
    tests = 'no test frames' if found.test is None else f'{len(found.test)} test frames'
    for line in notes:
        rich.print(escape(line))
    rich.print(f'{escape(str(scene))}: {len(found.train)} photos of '
               f'{photo.width}x{photo.height} pixels, {tests}')
    rich.print(f'Report on the capture: {escape(str(scene / REPORT_FILE))}')
    out = Path('out', found.name)
    if out.resolve() == scene.resolve():  # A training wants a folder of its own.
        out = Path('out', f'{found.name}_model')
    large = ['--minutes', 30] if max(photo.width, photo.height) > SMALL else []
    tell_next('neo', 'train', scene, '--out', out, *large)


def _named_format(name: str) -> Any:
    from neo_ros.captures.formats import CaptureFormat
    try:
        return CaptureFormat(name)
    except ValueError:
        raise ConfigError(f'--format: expected {FORMATS}, got {name!r}') from None
