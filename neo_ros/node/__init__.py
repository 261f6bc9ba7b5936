"""The lifecycle node, its diagnostics, and bags on a real graph; the only room with rclpy."""
