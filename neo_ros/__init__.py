"""neo_ros widens a robot's camera view to what the scene really shows outside the frame."""

__version__ = '0.1.0'
