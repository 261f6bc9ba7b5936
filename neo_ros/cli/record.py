"""`neo record`: write topics of a real ROS graph to a bag."""
from pathlib import Path
from typing import Annotated, Optional

import typer


def record(
    topics: Annotated[list[str], typer.Argument(help='Topics to record.')],
    out: Annotated[Path, typer.Option(help='Bag folder to make.')],
    seconds: Annotated[Optional[float], typer.Option(
        '--for', help='Stop after so many seconds.', min=0)] = None,
    frames: Annotated[Optional[int], typer.Option(
        help='Stop when every topic has so many messages.', min=1)] = None,
    idle_timeout: Annotated[Optional[float], typer.Option(
        help='Stop when nothing came for so many seconds after the first message.',
        min=0)] = None,
) -> None:
    """Record topics of a running ROS 2 graph into an MCAP bag; Ctrl-C ends it cleanly."""
    from neo_ros.bags import BagWriter
    from neo_ros.node.bag_recorder import BagRecorder
    from neo_ros.node.stopping import ros_node_with_stop

    with BagWriter(out) as writer, ros_node_with_stop('bag_recorder') as (node, stop):
        recorder = BagRecorder(node, writer, topics, report=typer.echo)
        typer.echo(f'recording {", ".join(topics)} to {out}')
        recorder.record(stop, seconds, frames, idle_timeout)
    for name, count in sorted(recorder.counts.items()):
        typer.echo(f'{count:6d} messages  {name}')
