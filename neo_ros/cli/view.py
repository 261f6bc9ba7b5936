"""`neo view`: the wide stream in a browser."""
from functools import partial
from pathlib import Path
from typing import Annotated, Optional

from neo_ros.cli.options import CameraInfo, InfoTopic, Rectify
import typer


def view(
    topic: Annotated[Optional[str], typer.Option(
        help='Wide image topic; default: /camera/wide/image, or the one of the bag.')] = None,
    bag: Annotated[Optional[Path], typer.Option(
        help='Show this bag instead of a ROS graph.')] = None,
    model: Annotated[Optional[Path], typer.Option(
        help='Model whose memory shows a map and lets one look around; it also widens a bag '
        'without wide images, for which demo_flat.onnx is the default.')] = None,
    floor: Annotated[Optional[Path], typer.Option(
        help='A walkable.json, or the YAML of a map_server map, whose outlines lie under the '
        'map.')] = None,
    rate: Annotated[Optional[float], typer.Option(
        help='How many times as fast as the bag was recorded; default: 1.', min=0.001)] = None,
    info_topic: InfoTopic = None,
    camera_info: CameraInfo = None,
    rectify: Rectify = False,
    sim_time: Annotated[bool, typer.Option(
        '--sim-time', help='Take the time from /clock, as for a bag that is played.')] = False,
    host: Annotated[str, typer.Option(
        help='Address to listen on; other than loopback, viewers need a token.')] = '127.0.0.1',
    port: Annotated[int, typer.Option(help='Port, 0 = any free one.')] = 8600,
    token_file: Annotated[Optional[Path], typer.Option(
        help='File with the token; default: the variable NEO_VIEWER_TOKEN, or a fresh one.',
    )] = None,
    cert: Annotated[Optional[Path], typer.Option(help='Certificate for TLS (PEM).')] = None,
    key: Annotated[Optional[Path], typer.Option(help='Its key (PEM).')] = None,
    max_viewers: Annotated[int, typer.Option(help='How many may watch at a time.')] = 20,
    max_mbit: Annotated[float, typer.Option(
        help='Most megabit per second for each viewer, 0 = no limit.')] = 20.0,
    quality: Annotated[int, typer.Option(help='JPEG quality, 1 to 100.')] = 80,
    stale_after: Annotated[float, typer.Option(
        help='Seconds until a picture counts as stale.')] = 0.8,
    public_origin: Annotated[str, typer.Option(
        help='What viewers open where a proxy stands before the server, such as '
             'https://robot.example.')] = '',
) -> None:
    """Show the widened stream in a browser, from a ROS graph or from a bag; view only."""
    from neo_ros.cli.options import refuse
    from neo_ros.machine.files import share_dir
    from neo_ros.machine.processes import end_if_busy
    from neo_ros.viewer.settings import read_token, ViewerSettings

    settings = partial(
        ViewerSettings, host=host, port=port, token=read_token(token_file), cert=cert, key=key,
        max_viewers=max_viewers, max_mbit=max_mbit, quality=quality, stale_after=stale_after,
        public_origin=public_origin, floor=floor)
    if bag is not None:
        from neo_ros.bags.camera_choice import CameraChoice
        from neo_ros.viewer.bag_source import BagSource
        from neo_ros.viewer.server import serve

        refuse('expected only without --bag, whose time is its own', sim_time=sim_time)
        source = BagSource(bag, model or share_dir() / 'models' / 'demo_flat.onnx',
                           1.0 if rate is None else rate,
                           CameraChoice(topic, info_topic, camera_info, rectify))
        serve(source, settings(model=model or source.model), typer.echo)
        end_if_busy()
        return
    refuse('expected only with --bag', rate=rate, rectify=rectify, info_topic=info_topic,
           camera_info=camera_info)
    from neo_ros.viewer.main import serve_topic
    import rclpy
    from rclpy.parameter import Parameter
    from rclpy.signals import SignalHandlerOptions

    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node('viewer', parameter_overrides=[
        Parameter('use_sim_time', value=sim_time)])
    try:
        serve_topic(node, topic or '/camera/wide/image', settings(model=model))
    finally:
        rclpy.try_shutdown()
    end_if_busy()
