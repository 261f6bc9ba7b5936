"""A short soak finds what a long one would: growth, silence, slowness; a hog makes no queue."""
import json

from neo_ros.cli.soak import soak as soak_command
from neo_ros.speed import soak as soak_module
from neo_ros.speed.soak import soak
import numpy as np
import pytest
from tiny_model import write_tiny_model
import typer
from typer.testing import CliRunner

pytestmark = pytest.mark.slow

APP = typer.Typer()
APP.command()(soak_command)
SECONDS, RATE = 60.0, 30.0


def recorded(growth=0.0, filled=0.0, slower=0.0, silent_s=0.0, lost=0, seen=(0, 61),
             heard=(0, 61)):
    """Return what the probe would print of a minute; seen and heard: from when to when."""
    stamps = (np.arange(SECONDS * RATE) / RATE * 1e9).astype(np.int64)
    share = stamps / stamps[-1]
    times = stamps + (20e6 * (1 + slower * share)).astype(np.int64)
    beats = np.arange(SECONDS)
    beats[30:] += silent_s
    arrived = (stamps >= seen[0] * 1e9) & (stamps < seen[1] * 1e9)
    beats = beats[(beats >= heard[0]) & (beats < heard[1])]
    # The clock of the beats starts anywhere.
    return {'sent': len(stamps), 'cpu_percent': 50.0, 'first_sent': 0, 'ended': 7 + SECONDS,
            'arrivals': np.stack([stamps, times], 1)[arrived][lost:].tolist(),
            'heard': {'wide/image': int(arrived.sum())},
            'beats': np.stack([7 + beats, 100 * (
                1 + growth * beats / SECONDS + filled * np.minimum(beats / 20, 1))],
                1).tolist()}


@pytest.mark.parametrize('trouble, steady', [
    ({}, True), ({'lost': 5}, True), ({'growth': 0.01, 'slower': 0.05}, True),
    ({'filled': 0.2}, True), ({'growth': 0.05}, False), ({'slower': 0.3}, False),
    ({'silent_s': 1.5}, False),
    ({'heard': (0, 40)}, False), ({'heard': (5, 61)}, False), ({'seen': (0, 45)}, False),
    ({'seen': (12, 61)}, False), ({'seen': (0, 45), 'heard': (0, 45)}, False),
], ids=['none', 'lost images', 'a little', 'fills its caches', 'grows', 'slows down',
        'falls silent', 'silent for good', 'silent at first', 'no more images',
        'no image at first', 'hangs'])
def test_trouble_is_found(tmp_path, monkeypatch, trouble, steady):
    recording = recorded(**trouble)
    monkeypatch.setattr(soak_module, 'run_graph', lambda *_, **__: recording)
    result = soak(write_tiny_model(tmp_path / 'tiny.onnx'), SECONDS)
    assert result['steady'] is steady
    assert result['missed'] == recording['sent'] - len(recording['arrivals'])
    assert (result['missed_beats'] > 0) is ('heard' in trouble or 'silent_s' in trouble)
    assert result['mean_rate_hz'] == pytest.approx(RATE, rel=0.01)
    assert result['latency_ms']['whole']['median'] == pytest.approx(20, rel=0.2)
    start, end = trouble.get('seen', (0, 61))
    assert (bool(result['latency_ms']['first']), bool(result['latency_ms']['last'])) == (
        start < SECONDS / 6, end > SECONDS * 5 / 6)
    json.dumps(result, allow_nan=False)


def test_the_result_of_a_node_that_hangs_is_kept(tmp_path, monkeypatch):
    recording = recorded(seen=(0, 45), heard=(0, 45))
    monkeypatch.setattr(soak_module, 'run_graph', lambda *_, **__: recording)
    out = tmp_path / 'soak.json'
    result = CliRunner().invoke(APP, [
        '--minutes', '1', '--out', str(out), '--model',
        str(write_tiny_model(tmp_path / 'tiny.onnx'))])
    assert result.exit_code == 1, result.output
    assert 'no image at last' in ' '.join(result.output.split())
    assert json.loads(out.read_text())['steady'] is False


def test_a_hog_beside_it_lets_nothing_queue(tmp_path):
    out = tmp_path / 'results' / 'soak.json'
    result = CliRunner().invoke(APP, [
        '--minutes', '0.07', '--hogs', '3', '--out', str(out), '--model',
        str(write_tiny_model(tmp_path / 'tiny.onnx'))])
    assert result.exit_code in (0, 1), result.output
    found = json.loads(out.read_text())
    assert found['hogs'] == 3 and found['beats'] >= 3 and found['heard']['wide/mask'] > 0
    assert 0 < found['mean_rate_hz'] <= 1.2 * RATE and found['missed'] < found['sent']
    # A queue of one second would show in the last images; what is published stays fresh.
    assert found['latency_ms']['last']['median'] < 500
