"""Run a trained model: card, checks, inference. Needs ONNX Runtime, neither torch nor ROS."""
from neo_ros.runtime.fov_extrapolator import FovExtrapolator, WideView
from neo_ros.runtime.model_card import ModelCard, read_model_card, write_model_card

__all__ = ['FovExtrapolator', 'ModelCard', 'WideView', 'read_model_card', 'write_model_card']
