"""A model that has passed its checks, ready to take the place of another one."""
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from neo_ros.messages import FrameProcessor
from neo_ros.messages.frame_processor import Extrapolator
from neo_ros.node.parameters import NodeParameters
from neo_ros.runtime import FovExtrapolator, ModelCard
from neo_ros.runtime.providers import choose_providers, PROVIDERS

# Makes an extrapolator of a path, a number of threads and ONNX Runtime's providers, and of
# `learn` where it is to learn.
Load = Callable[..., Any]


@dataclass(frozen=True, eq=False)
class LoadedModel:
    """The frame processor of a model, its card, and lines that describe it."""

    processor: FrameProcessor
    card: ModelCard
    description: dict[str, str]
    stop_learning: Callable[[], None] = lambda: None
    forget_light: Callable[[], None] = lambda: None

    @property
    def memory(self) -> bool:
        """Whether it has a scene memory."""
        return self.card.memory is not None

    @property
    def arbitrary_scale(self) -> bool:
        """Whether nobody knows how large its scene is."""
        return self.card.arbitrary_scale


def load_model(values: NodeParameters, load: Load = FovExtrapolator.load) -> LoadedModel:
    """Load, check and warm up the model that the parameters name; raises ModelError."""
    learning: dict[str, Any] = {'learn': 'beside'} if values.learn else {}
    extrapolator = load(values.model, values.threads, choose_providers(values.providers),
                        **learning)
    description = {'path': values.model, **_describe_card(extrapolator.card),
                   **_describe_size(extrapolator), 'runs on': ', '.join(extrapolator.providers)}
    # Also those that ONNX Runtime has, but cannot start: a GPU whose libraries are not there.
    if missing := [name for name in values.providers
                   if PROVIDERS[name] not in extrapolator.providers]:
        description['not here'] = ', '.join(missing)
    return LoadedModel(FrameProcessor(extrapolator, values.rectify), extrapolator.card,
                       description, *((extrapolator.stop_learning, extrapolator.forget_light)
                                      if values.learn else ()))


def _describe_size(extrapolator: Extrapolator) -> dict[str, str]:
    source, target = extrapolator.expansion.source, extrapolator.expansion.target
    return {'widens': f'{source.width}x{source.height} to {target.width}x{target.height}'}


def _describe_card(card: ModelCard) -> dict[str, str]:
    return {'scene': card.scene_id, 'config': card.config_hash, 'network': card.network,
            'knows its scene': 'yes' if card.scene_reference else 'no',
            'has a scene memory': 'yes' if card.memory else 'no'}
