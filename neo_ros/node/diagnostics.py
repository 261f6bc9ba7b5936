"""What `/diagnostics` says about the node."""
from collections.abc import Mapping
from dataclasses import dataclass

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from neo_ros.messages.camera_fit import assumed_camera
from neo_ros.messages.scene_outputs import WIDENING
from neo_ros.node.frame_statistics import Snapshot
from neo_ros.node.stamp_watch import judge_stamps, StampReport

# Share of the widened images: a memory that knows the place guides nearly all of them.
LEAST_GUIDED = 0.1
# What the lines of the status say.
KEYS = {
    'state': 'of the lifecycle',
    'enabled': 'false: stopped by `~/enable`',
    'image topic': 'full name after remapping',
    'image publishers': 'how many it has',
    'model path': 'what runs; so do the next three',
    'model scene': '',
    'model config': '',
    'model network': '',
    'model knows its scene': 'whether it can tell other scenes apart',
    'model has a scene memory': 'whether it is guided',
    'model widens': "sizes of the camera's and the wide image",
    'model runs on': 'providers of ONNX Runtime',
    'model not here': 'providers that were asked for and are not there',
    'rate in [Hz]': 'images received',
    'rate out [Hz]': 'images published',
    'received': 'count, as the next four',
    'published': '',
    'dropped for a newer image': '',
    'rejected': '',
    'rejected: REASON': 'of a reason, below',
    'last rejection': 'what was expected and what came',
    'camera': 'what is done to its images for the model: nothing, cropped, resampled, rectified',
    'guided by the scene memory': 'share of the frames that the memory knew',
    'last warning of the memory': 'of learning, its journal or its lights',
    'out of the scene': '0 as trained, 1 nothing like it',
    'in the trained scene': 'false while the mean score was above 0.5, until it is below 0.35',
    'latency STAGE median/p95/max [ms]': 'queue, decode, infer, check, publish, total',
}
CAMERA_KEYS = {
    'images': 'how many came in the last five seconds',
    'camera_infos': 'of how many stamps they came',
    'age of the stamps [ms]': 'median, at arrival',
    'images of the newest stamp': 'more than one: the driver repeats its stamps',
    'rate by the stamps [Hz]': "the camera's",
    'images sent': 'by the stamps of images and camera_infos',
    'images lost before the node': 'of those',
}


@dataclass(frozen=True)
class Health:
    """
    Everything the verdict depends on.

    state: lifecycle state. fault: why the last transition failed, or empty. topic: the image
    topic's full name, publishers: how many it has. missing: what keeps images away, in
    words. conflict: which publisher does not fit, transform: which one tf has not, twin: who
    publishes what this node does, warning: of the memory; in words, or empty. camera: the images'
    frame_id, or empty.
    subscribed: whether anybody reads an output. unlike_scene: the verdict of the SceneWatch.
    memory: the model has a scene memory. loading: a model is being loaded; the old one goes on.
    """

    state: str
    fault: str
    loading: bool
    enabled: bool
    topic: str
    publishers: int
    missing: str
    conflict: str
    transform: str
    twin: str
    warning: str
    camera: str
    subscribed: bool
    unlike_scene: bool
    memory: bool
    counts: Snapshot


def judge(health: Health) -> tuple[bytes, str]:
    """Return the level and the one line that tells an operator what to do."""
    level, message = _judge_frames(health)
    transform = health.transform if health.subscribed else ''
    assumed = assumed_camera(health.counts.camera_note) if health.subscribed else ''
    notes = [note for note in (health.conflict, transform, health.twin, assumed, health.warning)
             if note]
    if notes:
        return max(level, DiagnosticStatus.WARN), '; '.join([message, *notes])
    return level, message


def _judge_frames(health: Health) -> tuple[bytes, str]:
    counts = health.counts
    if health.loading:
        return DiagnosticStatus.OK, f'{health.state}: the model is being loaded'
    if health.fault:
        return DiagnosticStatus.ERROR, health.fault
    if health.state != 'active':
        return DiagnosticStatus.OK, f'{health.state}: waiting for a lifecycle transition'
    if not health.enabled:
        return DiagnosticStatus.OK, 'disabled by the enable service'
    if not health.subscribed:
        return DiagnosticStatus.OK, f'nobody subscribes to wide/*: {health.missing}'
    if counts.recent_received == 0:
        return DiagnosticStatus.WARN, health.missing
    if counts.recent_rejected and not counts.recent_published:
        return DiagnosticStatus.ERROR, f'every image is rejected: {counts.last_rejection}'
    if counts.recent_rejected:
        return DiagnosticStatus.WARN, f'some images are rejected: {counts.last_rejection}'
    if not counts.recent_published:
        return DiagnosticStatus.WARN, (
            'an image is being widened, none was lately: the network is slow, or max_fps is low'
            if counts.published else 'the first image is being widened')
    if health.unlike_scene:
        return DiagnosticStatus.WARN, (
            'the images are unlike the trained scene: another place, or a camera that is covered, '
            'in the dark or out of focus')
    message = f'widening {counts.rate_out:.1f} images per second'
    if health.memory and counts.guided is not None and counts.guided < LEAST_GUIDED:
        message += ', the network alone: the memory does not know this place'
    return DiagnosticStatus.OK, message


def build_status(name: str, health: Health, model: Mapping[str, str]) -> DiagnosticStatus:
    """Return the full status of a node; `model` are extra lines about the loaded model."""
    counts = health.counts
    lines = {
        'state': health.state,
        'enabled': str(health.enabled).lower(),
        'image topic': health.topic,
        'image publishers': str(health.publishers),
        **{f'model {key}': value for key, value in model.items()},
        'rate in [Hz]': f'{counts.rate_in:.2f}',
        'rate out [Hz]': f'{counts.rate_out:.2f}',
        'received': str(counts.received),
        'published': str(counts.published),
        'dropped for a newer image': str(counts.dropped),
        'rejected': str(sum(counts.rejected.values())),
        **{f'rejected: {reason}': str(count)
           for reason, count in sorted(counts.rejected.items())},
        'last rejection': counts.last_rejection,
        'camera': counts.camera_note,
        'guided by the scene memory': (f'{counts.guided:.0%}'
                                       if health.memory and counts.guided is not None
                                       else 'unknown'),
        'last warning of the memory': health.warning,
        'out of the scene': ('unknown' if counts.out_of_scene is None
                             else f'{counts.out_of_scene:.2f}'),
        'in the trained scene': ('unknown' if counts.out_of_scene is None
                                 else str(not health.unlike_scene).lower()),
        **{f'latency {stage} median/p95/max [ms]': '/'.join(f'{value:.2f}' for value in spread)
           for stage, spread in counts.latency_ms.items()},
    }
    level, message = judge(health)
    return _status(level, f'{name}: {WIDENING}', message, health.camera or health.topic, lines)


def build_camera_status(name: str, hardware_id: str, report: StampReport, remedy: str
                        ) -> DiagnosticStatus:
    """Return what a node's camera does; `remedy` says what to do about lost images."""
    rate = report.rate
    wrong = judge_stamps(report, remedy)
    message = wrong or (f'{report.images} images in five seconds' if report.images
                        else 'no image lately')
    return _status(DiagnosticStatus.WARN if wrong else DiagnosticStatus.OK, f'{name}: camera',
                   message, hardware_id, {
        'images': str(report.images),
        'camera_infos': str(report.infos),
        'age of the stamps [ms]': _number(report.age_ms),
        'images of the newest stamp': str(report.same),
        'rate by the stamps [Hz]': _number(rate),
        'images sent': 'unknown' if rate is None else str(report.sent),
        'images lost before the node': 'unknown' if rate is None else str(report.lost)})


def _number(value: float | None) -> str:
    return 'unknown' if value is None else f'{value:.1f}'


def _status(level: bytes, name: str, message: str, hardware_id: str, lines: Mapping[str, str]
            ) -> DiagnosticStatus:
    return DiagnosticStatus(
        level=level, name=name, message=message, hardware_id=hardware_id,
        values=[KeyValue(key=key, value=value) for key, value in lines.items()])
