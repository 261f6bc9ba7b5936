"""`neo play`: publish a bag on a real ROS graph."""
from pathlib import Path
from typing import Annotated, Optional

import typer


def play(
    bag: Annotated[Path, typer.Argument(help='Bag folder, .mcap or .db3 file.')],
    rate: Annotated[float, typer.Option(
        help='How many times as fast as recorded.', min=0.001)] = 1.0,
    loop: Annotated[bool, typer.Option('--loop', help='Start again at the end.')] = False,
    clock: Annotated[bool, typer.Option(help='Publish the recorded time on /clock.')] = True,
    topics: Annotated[Optional[list[str]], typer.Option(
        help='Play this topic only; may be given several times.')] = None,
    wait_for_subscribers: Annotated[int, typer.Option(
        help='Wait until the topics have so many subscriptions in total.', min=0)] = 0,
    delay: Annotated[float, typer.Option(
        help='Wait so many seconds more before playing: for subscribers of subscribers.', min=0,
    )] = 0.0,
) -> None:
    """
    Publish a bag over ROS 2 with its timing.

    Topics whose message type is not installed are named and left out: with ROS from PyPI that is
    /tf.
    """
    from neo_ros.bags import BagReader
    from neo_ros.node.bag_player import BagPlayer
    from neo_ros.node.fastdds_profile import use_large_image_profile
    from neo_ros.node.stopping import ros_node_with_stop

    use_large_image_profile()
    with BagReader(bag) as reader, ros_node_with_stop('bag_player') as (node, stop):
        player = BagPlayer(node, reader, topics or None, clock, report=typer.echo)
        if wait_for_subscribers:
            typer.echo(f'waiting for {wait_for_subscribers} subscriptions')
            player.wait_for_subscribers(wait_for_subscribers, stop)
        stop.wait(delay)
        while not stop.is_set():
            played = player.play(stop, rate)
            typer.echo(f'played {played.messages} messages in {played.seconds:.1f} s')
            if not loop:
                break
