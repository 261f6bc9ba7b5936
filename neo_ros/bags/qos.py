"""QoS profiles as bags write them; all that is used of rosbags beyond its documented interface."""
from collections.abc import Sequence
from typing import Any

from rosbags.interfaces import (
    Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime)
from rosbags.rosbag2.metadata import dump_qos_v9, parse_qos
import yaml

_FOREVER = QosTime(2147483647, 4294967295)
# What static transforms are published with: late subscribers still get them.
LATCHED = Qos(QosHistory.KEEP_LAST, 1, QosReliability.RELIABLE, QosDurability.TRANSIENT_LOCAL,
              _FOREVER, _FOREVER, QosLiveliness.AUTOMATIC, _FOREVER, False)


def read_qos(value: Any) -> tuple[Qos, ...]:
    """Return the profiles in a text or in a list of metadata.yaml; none where it is damaged."""
    try:
        return tuple(parse_qos(value))
    except Exception:  # rosbags raises whatever YAML and its enums do.
        return ()


def qos_entries(profiles: Sequence[Qos]) -> list[dict[str, Any]]:
    """Return the profiles as metadata.yaml lists them."""
    return [dict(entry) for entry in dump_qos_v9(list(profiles))]


def qos_text(profiles: Sequence[Qos]) -> str:
    """Return the profiles as a channel's metadata hold them; empty for none."""
    entries = qos_entries(profiles)
    return yaml.safe_dump(entries, sort_keys=False).strip() if entries else ''
