"""The command line `neo`."""
import errno
import logging
import sys

from neo_ros.cli.bag import bag
from neo_ros.cli.bag_info import bag_info
from neo_ros.cli.bench import bench
from neo_ros.cli.benchmark import benchmark
from neo_ros.cli.compare import compare
from neo_ros.cli.demo import demo
from neo_ros.cli.evaluate import evaluate
from neo_ros.cli.export import export
from neo_ros.cli.field_curve import field_curve
from neo_ros.cli.floor import floor
from neo_ros.cli.import_scene import import_scene
from neo_ros.cli.inspect import inspect
from neo_ros.cli.memory import memory
from neo_ros.cli.play import play
from neo_ros.cli.record import record
from neo_ros.cli.replay import replay
from neo_ros.cli.soak import soak
from neo_ros.cli.train import train
from neo_ros.cli.update import update
from neo_ros.cli.view import view
from neo_ros.errors import NeoError
from neo_ros.machine.files import FULL, what_to_do
import typer

HELP = """
Widen a robot's camera view, faithfully: a model of one scene, from photos to a ROS topic.

A first look:  neo demo

Your own scene:  neo import (photos with poses) > neo train (a model file) > neo evaluate
(scores and pictures) > neo replay (a recorded bag) or the node fov_extrapolator (a live robot).
"""
# What the user can mend, wherever in the work it comes.
FORBIDDEN = {errno.EACCES, errno.EPERM, errno.EROFS}
PREPARE, RUN = 'From photos to a model', 'Use a model'

app = typer.Typer(help=HELP, no_args_is_help=True, rich_markup_mode='rich',
                  pretty_exceptions_enable=False, add_completion=False)
app.command()(demo)
app.command('import', rich_help_panel=PREPARE)(import_scene)
app.command(rich_help_panel=PREPARE)(floor)
app.command('bag-info', rich_help_panel=PREPARE)(bag_info)
app.command(rich_help_panel=PREPARE)(train)
app.command(rich_help_panel=PREPARE)(update)
app.command(rich_help_panel=PREPARE)(evaluate)
app.command(rich_help_panel=PREPARE)(export)
app.command(rich_help_panel=PREPARE)(compare)
app.command(rich_help_panel=PREPARE)(benchmark)
app.command('field-curve', rich_help_panel=PREPARE)(field_curve)
app.command(rich_help_panel=RUN)(inspect)
app.add_typer(memory, name='memory', rich_help_panel=RUN)
app.command(rich_help_panel=RUN)(replay)
app.command(rich_help_panel=RUN)(play)
app.command(rich_help_panel=RUN)(record)
app.command(rich_help_panel=RUN)(bag)
app.command(rich_help_panel=RUN)(view)
app.command(rich_help_panel=RUN)(bench)
app.command(rich_help_panel=RUN)(soak)


def main() -> None:
    """Run the command line; an error that the user can mend is one line and exit code 2."""
    logging.basicConfig(format='%(levelname)s: %(message)s')
    try:
        app()
    except NeoError as error:
        sys.exit(_fail(str(error)))
    except OSError as error:
        if error.errno not in FULL | FORBIDDEN:
            raise
        advice = what_to_do(error, 'choose a place where you may read and write')
        sys.exit(_fail(f'{error.filename or "the disk"}: {error.strerror}; {advice}'))
    except ModuleNotFoundError as error:
        if error.name == 'rclpy':
            sys.exit(_fail('rclpy is not installed; this command needs ROS 2 Jazzy: source it, or '
                           'make setup in a checkout'))
        extra = {**dict.fromkeys(('torch', 'scipy', 'onnx', 'onnxscript', 'pycolmap', 'pydantic'),
                                 'train'),
                 'aiohttp': 'viewer', 'yarl': 'viewer', 'av': 'video'}.get(
            (error.name or '').split('.')[0])
        if extra is None:
            raise
        target = 'setup' if extra == 'viewer' else 'train-setup'
        sys.exit(_fail(f'{error.name} is not installed; this command needs the extra {extra}: '
                       f"make {target}, or pip install '.[{extra}]', in a checkout"))


def _fail(message: str) -> int:
    print('neo:', ' '.join(message.split('\n')), file=sys.stderr)
    return 2


if __name__ == '__main__':
    main()
