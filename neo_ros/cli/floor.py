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
        help="z of the robot's camera, metres; default: the photos' median.")] = None,
    resolution: Annotated[Optional[float], typer.Option(
        help='Images only: metres per pixel.')] = None,
    origin: Annotated[Optional[tuple[float, float, float]], typer.Option(
        help='Images only: x, y (metres) and yaw (radians) of the lower left corner; default: '
             '0 0 0.')] = None,
) -> None:
    """
    Write SCENE/walkable.json from a floor map, and show it on the map of the capture report.

    The map must be in the world of the photos. neo train then draws its positions on free floor,
    `sampling.robot_radius` off everything else.
    """
    from neo_ros.captures.report import REPORT_FILE, write_capture_report
    from neo_ros.cli.progress import stage_progress
    from neo_ros.scenes.scene import read_scene
    from neo_ros.scenes.walkable import write_walkable
    import numpy as np
    import rich
    from rich.markup import escape

    found = read_scene(scene)
    _check_upright(scene, found)
    positions = found.train.T_world_cam[:, :3, 3]
    height = float(np.median(positions[:, 2])) if camera_height is None else camera_height
    walkable = _read_floor(floor_map, resolution, origin, height)
    write_walkable(scene / 'walkable.json', walkable)
    with stage_progress() as show:
        write_capture_report(scene, read_scene(scene), (),
                             lambda done, total: show('capture report', done, total))
    share = float(walkable.contains(positions[:, :2]).mean())
    rich.print(f'{walkable.area:.1f} m2 of free floor; {share:.0%} of the photos stand on it; '
               f'camera at {height:.2f} m')
    if share < 0.5:
        rich.print("[yellow]Most photos do not: is the map in the photos' world?[/yellow]")
    rich.print(f'Written: {escape(str(scene / "walkable.json"))} and {REPORT_FILE}')


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
