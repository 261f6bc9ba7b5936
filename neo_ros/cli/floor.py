"""`neo floor`: say where the robot can be, by a floor map."""
from pathlib import Path
from typing import Annotated, Any, Optional

import typer


def floor(
    scene: Annotated[Path, typer.Argument(help='Scene folder, made by neo import.')],
    floor_map: Annotated[Path, typer.Argument(
        metavar='MAP', help='YAML file of a map_server map, or an image whose bright pixels are '
                            'free floor.')],
    camera_height: Annotated[Optional[float], typer.Option(
        help="z of the robot's camera, metres; default: the median of its storey's photos.",
    )] = None,
    resolution: Annotated[Optional[float], typer.Option(
        help='Images only: metres per pixel.')] = None,
    origin: Annotated[Optional[tuple[float, float, float]], typer.Option(
        help='Images only: x, y (metres) and yaw (radians) of the lower left corner; default: '
             '0 0 0.')] = None,
    storey: Annotated[int, typer.Option(
        help='Of a building: the map is that of so many storeys above the first map.', min=0)] = 0,
) -> None:
    """
    Write SCENE/walkable.json from a floor map, and show it on the map of the capture report.

    The map must be in the world of the photos. neo train then draws its positions on free floor,
    `sampling.robot_radius` off everything else. A building has a map for each storey:
    walkable_1.json is that of --storey 1.
    """
    from neo_ros.captures.report import REPORT_FILE, write_capture_report
    from neo_ros.cli.progress import stage_progress
    from neo_ros.scenes.scene import floor_file, read_scene
    from neo_ros.scenes.walkable import write_walkable
    import numpy as np
    import rich
    from rich.markup import escape

    found = read_scene(scene)
    _check_upright(scene, found)
    own = _photos_of_storey(found, storey)
    height = float(np.median(own[:, 2])) if camera_height is None else camera_height
    walkable = _read_floor(floor_map, resolution, origin, height)
    target = floor_file(scene, storey)
    write_walkable(target, walkable)
    with stage_progress() as show:
        write_capture_report(scene, read_scene(scene), (),
                             lambda done, total: show('capture report', done, total))
    share = float(walkable.contains(own[:, :2]).mean())
    rich.print(f'{walkable.area:.1f} m2 of free floor; {share:.0%} of the photos stand on it; '
               f'camera at {height:.2f} m')
    if share < 0.5:
        rich.print("[yellow]Most photos do not: is the map in the photos' world?[/yellow]")
    rich.print(f'Written: {escape(str(target))} and {REPORT_FILE}')


def _photos_of_storey(found: Any, storey: int) -> Any:
    """Return where the photos of a storey were taken, (N, 3); refuse one that comes too early."""
    from neo_ros.errors import ConfigError
    from neo_ros.scenes.storeys import storey_borders
    import numpy as np

    positions = found.train.T_world_cam[:, :3, 3]
    storeys = np.searchsorted(storey_borders(positions[:, 2]), positions[:, 2])
    if storey > storeys.max():
        raise ConfigError(f'--storey: expected 0 to {storeys.max()}, for the photos are of '
                          f'{storeys.max() + 1} storeys, got {storey}')
    if storey > len(found.upper) + (found.walkable is not None):
        raise ConfigError(f'--storey: expected the maps of the storeys below {storey} first')
    return positions[storeys == storey]


def _check_upright(scene: Path, found: Any) -> None:
    """Refuse a world that lies: with a floor map it counts as upright, and the map as a wall's."""
    from neo_ros.errors import ConfigError
    from neo_ros.scenes.upright import axis_name, axis_up

    up = axis_up(found)
    if up[2] != 1:
        raise ConfigError(
            f'{scene}: expected a world whose z axis points up, but its photos were held with '
            f'{axis_name(up)} up; import it again with --level, or write "z_up": true into '
            'transforms_train.json if z does point up')


def _read_floor(floor_map: Path, resolution: float | None,
                origin: tuple[float, float, float] | None, height: float) -> Any:
    """Read where the robot can be, from a map_server map or from an image."""
    from neo_ros.cli.options import refuse
    from neo_ros.errors import ConfigError
    from neo_ros.scenes.floor_map import read_floor_mask, read_map_server

    if floor_map.suffix in ('.yaml', '.yml'):
        refuse('expected with an image only, a map says its own', resolution=resolution,
               origin=origin)
        return read_map_server(floor_map, height)
    if resolution is None:
        raise ConfigError(f'--resolution: expected metres per pixel with an image, '
                          f'{floor_map.name}')
    return read_floor_mask(floor_map, resolution, origin or (0.0, 0.0, 0.0), height)
