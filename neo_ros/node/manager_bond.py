"""The bond by which Nav2's lifecycle manager sees that the node is alive; needs bondpy."""
from typing import Any

from rclpy.lifecycle import LifecycleNode

# As Nav2's own nodes; the manager expects one of them within its bond_timeout.
TOPIC, PERIOD_S = 'bond', 0.1
# Nothing hangs on the manager's life here; and while a model loads, nobody is heard for minutes.
PATIENCE_S = 86_400.0


def form_bond(node: LifecycleNode) -> Any | None:
    """Begin a bond under the node's name; None where there is no bondpy (for ROS 2)."""
    try:
        from bondpy.bondpy import Bond
    except ImportError:
        return None

    class NodeBond(Bond):  # type: ignore[misc]

        def _publish(self, active: bool) -> None:
            try:
                super()._publish(active)
            except Exception:
                # Its thread does not hear that the node ends.
                if self.node.context.ok():
                    raise

    bond = NodeBond(node, TOPIC, node.get_name())
    bond.heartbeat_period, bond.heartbeat_timeout = PERIOD_S, PATIENCE_S
    bond.start()
    return bond
