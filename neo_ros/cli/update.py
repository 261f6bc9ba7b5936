"""`neo update`: change a trained scene where bags show that it has changed."""
from pathlib import Path
from typing import Annotated, Optional

from neo_ros.cli.options import CameraInfo, ImageTopic, InfoTopic, Rectify
import typer


def update(
    run: Annotated[Path, typer.Argument(
        help='Output folder of neo train, or of an earlier neo update.')],
    bags: Annotated[list[Path], typer.Argument(
        help='Bags of later days, the oldest first.')],
    out: Annotated[Path, typer.Option(
        help='Folder of the updated run; must not exist yet.')],
    scene: Annotated[Optional[Path], typer.Option(
        help='Scene folder that RUN was trained on; default: where it was then.')] = None,
    config: Annotated[Optional[Path], typer.Option(
        help='Experiment file that RUN was trained with, if it was with one.')] = None,
    image_topic: ImageTopic = None,
    info_topic: InfoTopic = None,
    camera_info: CameraInfo = None,
    rectify: Rectify = False,
    minutes: Annotated[Optional[float], typer.Option(
        help='Fit the changed part of the field for so many minutes, for each bag; default: as '
             'many as it takes.',
        min=0.1)] = None,
    network_minutes: Annotated[Optional[float], typer.Option(
        help='Train the network on for so many minutes, with views of what is there now; '
             'default: it stays.',
        min=0.1)] = None,
    cluster: Annotated[bool, typer.Option(
        '--cluster',
        help='Let Ray make the keyframes that have changed: with all cores of this machine, or '
             'with RAY_ADDRESS on a cluster, all of whose machines need the same paths.')] = False,
) -> None:
    """
    Change a trained scene where bags show that it has changed, and nowhere else.

    Places that no photo showed, such as a room whose door was closed, are added.

    Leaves model, scene memory, field, photos and report.html in OUT; RUN stays as it is. Broken
    off? Run the same command again.
    """
    from neo_ros.bags.camera_choice import CameraChoice
    from neo_ros.cli.options import tell_next
    from neo_ros.cli.progress import stage_progress
    from neo_ros.experiment import read_experiment
    from neo_ros.updating.update import update as update_run, UpdateOptions
    import rich
    from rich.markup import escape

    options = UpdateOptions(
        camera=CameraChoice(image_topic, info_topic, camera_info, rectify),
        minutes=minutes, network_minutes=network_minutes, cluster=cluster)
    with stage_progress() as show:
        places = update_run(run, bags, out, options, scene,
                            None if config is None else read_experiment(config), show)
    for bag, count in zip(bags, places):
        what = ('not used' if count is None else 'nothing has changed' if count == 0
                else f'{count} changed or new places')
        rich.print(f'{escape(bag.name)}: {what}')
    if not any(places):
        rich.print('Nothing is written' + (
            '.' if None in places else ': the run is up to date.'))
        return
    model, = out.glob('*.onnx')
    rich.print(f'Written: {escape(str(model))}, its memory and report.html')
    camera = {'--image-topic': image_topic, '--info-topic': info_topic,
              '--camera-info': camera_info}
    tell_next('neo', 'replay', bags[-1], '--model', model, '--out', 'WIDE',
              *(word for name, value in camera.items() if value is not None
                for word in (name, value)), *['--rectify'] * rectify)
