"""`neo demo`: see it work, on a real ROS graph, in the built-in flat."""
from pathlib import Path
from typing import Annotated, Any, Optional

import typer


def demo(
    out: Annotated[Path, typer.Option(
        help='Folder for the bags, the report and the pictures.')] = Path('out/demo'),
    model: Annotated[Optional[Path], typer.Option(
        help='A model of the demo flat; default: the one that comes with the package.')] = None,
    camera: Annotated[Optional[str], typer.Option(
        help='Another camera, WIDTHxHEIGHT@DEGREES, as 640x480@69: a model is trained for it '
        'first, once.')] = None,
    minutes: Annotated[Optional[float], typer.Option(
        help='How long that training takes; default: 30.', min=0)] = None,
    frames: Annotated[int, typer.Option(help='Length of the walk.', min=2)] = 100,
    rate: Annotated[float, typer.Option(help='Frames per second.', min=0.1)] = 10.0,
    watch: Annotated[Optional[bool], typer.Option(
        help='Show the stream in a browser and play on until Ctrl-C; default: on a terminal.',
    )] = None,
) -> None:
    """
    Walk a robot through the built-in flat and widen its camera, live.

    Renders the walk once, plays it to the node on a ROS graph of its own, records what comes
    out, scores it against the truth and shows it in report.html and strip.png. The page of the
    remote assistant shows the stream meanwhile. With --camera it photographs the flat and trains
    a model first, in OUT; given again, the command goes on where it was broken off.
    """
    import os
    import sys
    import webbrowser

    from neo_ros.cli.options import camera_of, refuse
    from neo_ros.cli.progress import stage_progress
    from neo_ros.demo import run_demo, train_demo
    from neo_ros.machine.files import share_dir
    import rich

    if camera is not None:
        refuse('--camera trains one', model=model)
        seen = camera_of(camera)
    else:
        refuse('expected only with --camera', minutes=minutes)
    watching = sys.stdout.isatty() if watch is None else watch
    rounds = 0

    def shown_at(address: str) -> None:
        rich.print(f'The stream is shown at {address}')
        # Without a desktop a text browser might take the terminal.
        if watching and {'DISPLAY', 'WAYLAND_DISPLAY'} & os.environ.keys():
            webbrowser.open(address)

    def go_on(result: Any) -> bool:
        nonlocal rounds
        rounds += 1
        if rounds == 1:
            _print_result(result, out)
            if watching:
                rich.print('The robot walks on, until you press Ctrl-C.')
        return watching

    with stage_progress() as show:
        if camera is not None:
            model = train_demo(seen, out / camera, 30.0 if minutes is None else minutes, show)
        try:
            run_demo(model or share_dir() / 'models' / 'demo_flat.onnx', out, frames, rate, show,
                     shown_at, go_on)
        except KeyboardInterrupt:
            if rounds == 0:  # Nothing has been shown yet.
                raise


def _print_result(result: Any, out: Path) -> None:
    import rich
    from rich.markup import escape

    latency, scores = result.latency_ms, result.scores
    rich.print(f'{result.frames_out} of {result.frames_in} frames widened at '
               f'{result.rate:.1f} Hz; camera image to wide image: median '
               f'{latency["median"]:.1f} ms, p95 {latency["p95"]:.1f} ms')
    rich.print(f'ring (what the camera does not see): {scores["ring_psnr"]:.2f} dB, SSIM '
               f'{scores["ring_ssim"]:.3f}; whole image: {scores["whole_psnr"]:.2f} dB')
    rich.print(f'Look at {escape(str(out))}/report.html and {escape(str(out))}/strip.png')
