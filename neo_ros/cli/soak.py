"""`neo soak`: the node under load for a long time."""
from pathlib import Path
from typing import Annotated, Optional

import typer


def soak(
    minutes: Annotated[float, typer.Option(help='How long.', min=0.05)] = 60.0,
    hogs: Annotated[int, typer.Option(
        help='Processes beside it that burn a core each.', min=0)] = 0,
    rate: Annotated[float, typer.Option(help='Images per second.', min=0.1)] = 30.0,
    model: Annotated[Optional[Path], typer.Option(
        help='Model file (.onnx); default: the shipped demo_flat.onnx.')] = None,
    out: Annotated[Path, typer.Option(help='JSON file of the results.')] = Path(
        'out/soak.json'),
) -> None:
    """
    Run the node for a long time, to see if it grows, falls silent, or falls behind.

    Exit code 1 where it does: memory grown by 2 % since the third sixth, a second without a
    diagnosis, no image in the first or the last sixth, or latency (p99) of the last sixth 10 %
    above that of the first.
    """
    import json

    from neo_ros.machine.files import make_output_folder, share_dir, write_bytes
    from neo_ros.speed.soak import soak as run_soak
    import rich
    from rich.markup import escape

    make_output_folder(out.parent)
    result = run_soak(model or share_dir() / 'models' / 'demo_flat.onnx', 60 * minutes, hogs, rate)
    write_bytes(out, (json.dumps(result, indent=1) + '\n').encode())
    latency, rss = result['latency_ms'], result['rss_mb']
    rich.print(
        f'{result["mean_rate_hz"]:.1f} of {rate:.1f} Hz, missed {result["missed"]} of '
        f'{result["sent"]}; latency median {latency["whole"]["median"]:.1f} ms, max '
        f'{latency["whole"]["max"]:.1f} ms, p99 {_p99(latency["first"])} at first and '
        f'{_p99(latency["last"])} at last; {rss["first"]:.0f} MB, {rss["third"]:.0f} MB once its '
        f'caches are full, {rss["last"]:.0f} MB at last; {result["beats"]} diagnoses, '
        f'{result["missed_beats"]} gaps')
    rich.print(f'Written: {escape(str(out))}')
    if not result['steady']:
        raise typer.Exit(1)


def _p99(latency: dict[str, float]) -> str:
    return f'{latency["p99"]:.1f} ms' if latency else 'no image'
