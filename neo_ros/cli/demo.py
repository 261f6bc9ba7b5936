"""`neo demo`: see it work, on a real ROS graph, in the built-in flat."""
from pathlib import Path
from typing import Annotated, Optional

import typer


def demo(
    out: Annotated[Path, typer.Option(
        help='Folder for the bags, the report and the pictures.')] = Path('out/demo'),
    model: Annotated[Optional[Path], typer.Option(
        help='A model of the demo flat; default: the one that comes with the package.')] = None,
    frames: Annotated[int, typer.Option(help='Length of the walk.', min=2)] = 100,
    rate: Annotated[float, typer.Option(help='Frames per second.', min=0.1)] = 10.0,
) -> None:
    """
    Walk a robot through the built-in flat and widen its camera, live.

    Renders the walk once, plays it to the node on a ROS graph of its own, records what comes
    out, scores it against the truth and shows it in report.html and strip.png.
    """
    from neo_ros.cli.progress import stage_progress
    from neo_ros.demo import run_demo
    from neo_ros.paths import share_dir
    import rich
    from rich.markup import escape

    with stage_progress() as show:
        result = run_demo(
            model or share_dir() / 'models' / 'demo_flat.onnx', out, frames, rate, show)
    latency, scores = result.latency_ms, result.scores
    rich.print(f'{result.frames_out} of {result.frames_in} frames widened at '
               f'{result.rate:.1f} Hz; camera image to wide image: median '
               f'{latency["median"]:.1f} ms, p95 {latency["p95"]:.1f} ms')
    rich.print(f'ring (what the camera does not see): {scores["ring_psnr"]:.2f} dB, SSIM '
               f'{scores["ring_ssim"]:.3f}; whole image: {scores["whole_psnr"]:.2f} dB')
    rich.print(f'Look at {escape(str(out))}/report.html and {escape(str(out))}/strip.png')
