"""What the outpainter learns from: the error of its colours, and how true its confidence is."""
from dataclasses import dataclass

import torch


@dataclass(frozen=True)
class LossRules:
    """How error and likelihood are weighed; chosen by measuring."""

    likelihood: float = 0.05        # beside L1
    # Below half a grey level the likelihood has nothing to learn, and its gradient explodes: what
    # is there is drawn back, gently.
    least_log_scale: float = -6.0


def outpaint_loss(colour: torch.Tensor, log_scale: torch.Tensor, truth: torch.Tensor,
                  weight: torch.Tensor, rules: LossRules = LossRules()) -> torch.Tensor:
    """
    Mean L1 over the ring plus the Laplace likelihood of its error.

    colour, truth (B, 3, H, W) and log_scale (B, 1, H, W) as in Outpainter; weight (B, 1, H, W)
    is 0 where the camera sees or nobody saw. The likelihood trains the scale alone: its
    gradient does not reach the colour.
    """
    error = (colour - truth).abs().mean(1, keepdim=True)
    kept = log_scale.clamp(min=rules.least_log_scale)
    likelihood = error.detach() * torch.exp(-kept) + kept + (kept - log_scale)
    return ((error + rules.likelihood * likelihood) * weight).sum() / weight.sum().clamp(min=1)
