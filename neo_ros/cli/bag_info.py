"""`neo bag-info`: what is in a bag, and what to do with it."""
from pathlib import Path
from typing import Annotated, Any, Optional

import typer


def bag_info(
    bag: Annotated[Path, typer.Argument(help='Bag folder (MCAP or sqlite3), .mcap or .db3.')],
    model: Annotated[Optional[Path], typer.Option(
        help='Model file (.onnx) that the bag shall be replayed with.')] = None,
    as_json: Annotated[bool, typer.Option('--json', help='Print JSON.')] = False,
) -> None:
    """
    Show topics, rates, gaps, sizes and cameras of a bag, and what can serve as what.

    The whole bag is read, so losses by damage are exact. Ends with the command to run next.
    """
    from dataclasses import asdict
    import json

    from neo_ros.bags.bag_info import read_bag_info
    from neo_ros.cli.progress import stage_progress
    from neo_ros.runtime import read_model_card

    expansion = None if model is None else read_model_card(model).expansion
    if as_json:
        typer.echo(json.dumps(asdict(read_bag_info(bag, model, expansion)), indent=1))
        return
    with stage_progress() as show:
        info = read_bag_info(bag, model, expansion,
                             lambda done, total: show('messages', done, total))
    _print(info)


def _print(info: Any) -> None:
    from datetime import datetime, UTC

    import rich
    from rich.markup import escape
    from rich.table import Column, Table

    start = datetime.fromtimestamp(info.start_ns / 1e9, UTC)
    rich.print(f'{escape(info.path)}: {info.messages} messages in {info.seconds:.1f} s from '
               f'{start:%Y-%m-%d %H:%M:%S} UTC')
    table = Table(Column('topic', overflow='fold'), 'serves as')
    for column in ('messages', 'Hz', 'max gap s', 'MB'):
        table.add_column(column, justify='right')
    for topic in info.topics:
        lines = [escape(topic.name), f'[dim]{escape(topic.msgtype)}[/dim]', escape(topic.content)]
        table.add_row(
            '\n'.join(filter(None, lines)), ', '.join(topic.roles), str(topic.count),
            '' if topic.rate_hz is None else f'{topic.rate_hz:.1f}',
            '' if topic.longest_gap_s is None else f'{topic.longest_gap_s:.3f}',
            f'{topic.bytes / 1e6:.2f}')
    rich.print(table)
    for line in info.damages:
        rich.print(f'[yellow]{escape(line)}[/yellow]')
    for line in info.notes:
        rich.print(escape(line))
    if info.next:
        typer.echo(f'Next: {info.next}')
