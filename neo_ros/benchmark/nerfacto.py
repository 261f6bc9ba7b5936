"""
The public field that ours is measured against: nerfstudio's nerfacto, its torch implementation.

Put together from nerfstudio's own parts (Tancik et al., 2023; its NerfactoModel would download
weights for a measure that is not needed here). What is not as its defaults (in brackets) say:

- 1024 rays a step (4096), on the CPU, in float32 with the torch implementation (mixed precision
  and tiny-cuda-nn on a GPU);
- no appearance embedding (32 numbers a photo) and no camera optimiser (SO3xR3): the photos share
  their light, and their poses are the ones that are scored;
- the learning rate falls from 1e-2 to 1e-4 within the minutes given (over 200,000 steps, of which
  30,000 are taken), and the proposals are annealed within at most half of them (1000 steps);
- an average initial density of 1 (0.01);
- the world is centred and scaled by the photos' positions, but not turned (up is estimated).

nerfstudio asks for hundreds of packages; these are what its nerfacto needs beside neo_ros:

    pip install --no-deps nerfstudio==1.1.5 nerfacc jaxtyping wadler-lindig tyro docstring-parser \
        typeguard torchmetrics lightning-utilities gsplat viser splines msgspec websockets
"""
from collections.abc import Callable
from dataclasses import dataclass
import time
from typing import Any

from neo_ros.geometry import CameraPose, Intrinsics
from neo_ros.pictures.usable import draw_usable
from neo_ros.training.run import TrainingRun
from nerfstudio.cameras.rays import RayBundle
from nerfstudio.field_components.field_heads import FieldHeadNames
from nerfstudio.field_components.spatial_distortions import SceneContraction
from nerfstudio.fields.density_fields import HashMLPDensityField
from nerfstudio.fields.nerfacto_field import NerfactoField
from nerfstudio.model_components.losses import distortion_loss, interlevel_loss
from nerfstudio.model_components.ray_samplers import ProposalNetworkSampler
from nerfstudio.model_components.renderers import RGBRenderer
import numpy as np
import torch
from torch import nn


@dataclass(frozen=True)
class NerfactoRules:
    """How nerfacto is trained; nerfstudio's defaults, but for the rays of a step."""

    rays: int = 1024             # 4096 are for a GPU: on two cores a minute would be 10 steps
    near: float = 0.05           # in units of the scene, whose cameras lie within [-1, 1]
    far: float = 1000.0
    proposals: tuple[int, int] = (128, 256)  # their finest grids
    learning_rate: float = 1e-2
    last_rate: float = 1e-4
    distortion: float = 0.002
    anneal_steps: int = 1000     # or half of a training that has fewer
    slope: float = 10.0          # of the annealing
    eval_rays: int = 8192        # at a time, which bounds the memory


class Nerfacto(nn.Module):
    """Field, proposal networks and sampler; poses are scaled as nerfstudio scales them."""

    def __init__(self, T_world_cam: np.ndarray, rules: NerfactoRules = NerfactoRules()) -> None:
        super().__init__()
        self.rules = rules
        positions = T_world_cam[:, :3, 3]
        self.middle = positions.mean(0)
        self.scale = 1 / float(np.abs(positions - self.middle).max())
        box = torch.tensor([[-1.0] * 3, [1.0] * 3])
        contraction = SceneContraction(order=float('inf'))
        self.field = NerfactoField(
            box, num_images=len(T_world_cam), appearance_embedding_dim=0,
            spatial_distortion=contraction, implementation='torch')
        self.proposals = nn.ModuleList(HashMLPDensityField(
            box, spatial_distortion=contraction, hidden_dim=16, log2_hashmap_size=17,
            num_levels=5, implementation='torch', max_res=size) for size in rules.proposals)
        self.sampler = ProposalNetworkSampler(
            num_nerf_samples_per_ray=48, num_proposal_samples_per_ray=(256, 96),
            num_proposal_network_iterations=2, single_jitter=True,
            update_sched=lambda step: int(np.clip(step / 1000, 1, 5)))
        self.colour = RGBRenderer(background_color='last_sample')

    def forward(self, origins: np.ndarray, directions: np.ndarray) -> dict[str, Any]:
        """Render rays (N, 3), float32, metres; returns rgb (N, 3) and what the losses need."""
        count = len(origins)
        rays = RayBundle(
            origins=torch.from_numpy((origins - self.middle) * self.scale).float(),
            directions=torch.from_numpy(directions).float(),
            pixel_area=torch.ones(count, 1), camera_indices=torch.zeros(count, 1).long(),
            nears=torch.full((count, 1), self.rules.near),
            fars=torch.full((count, 1), self.rules.far))
        samples, weights, levels = self.sampler(
            rays, density_fns=[network.density_fn for network in self.proposals])
        shown = self.field.forward(samples)
        weights = [*weights, samples.get_weights(shown[FieldHeadNames.DENSITY])]
        return {'rgb': self.colour(rgb=shown[FieldHeadNames.RGB], weights=weights[-1]),
                'weights': weights, 'levels': [*levels, samples]}


def fit_nerfacto(run: TrainingRun, seconds: float, stage: str,
                 rules: NerfactoRules = NerfactoRules(),
                 ) -> tuple[Callable[[Intrinsics, CameraPose], np.ndarray], dict[str, Any]]:
    """Train for so many seconds; returns what renders it, with its steps and minutes."""
    torch.manual_seed(run.experiment.seed)
    scale = run.experiment.scale
    images, usable = run.fitted.read_images(scale), run.fitted.read_all_usable(scale)
    camera, poses = run.fitted.intrinsics.scaled(scale), run.fitted.T_world_cam
    model = Nerfacto(poses, rules)
    optimiser = torch.optim.Adam(model.parameters(), rules.learning_rate, eps=1e-15)
    random = np.random.default_rng(run.experiment.seed)
    started, step, share = time.monotonic(), 0, 0.0
    while share < 1:
        for group in optimiser.param_groups:
            group['lr'] = rules.learning_rate * (rules.last_rate / rules.learning_rate) ** share
        # Mip-NeRF 360, equation 18: the proposals' weights are sharpened slowly.
        part = min(step / rules.anneal_steps, 2 * share, 1.0)
        model.sampler.set_anneal(rules.slope * part / ((rules.slope - 1) * part + 1))
        target, origins, directions = _draw(images, usable, camera, poses, random, rules.rays)
        shown = model(origins, directions)
        error = ((shown['rgb'] - target) ** 2).mean()
        loss = (error + interlevel_loss(shown['weights'], shown['levels'])
                + rules.distortion * distortion_loss(shown['weights'], shown['levels']))
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        model.sampler.step_cb(step)
        step += 1
        share = (time.monotonic() - started) / seconds
        run.progress(stage, min(int(1000 * share), 1000), 1000,
                     f'step {step}, {-10 * np.log10(float(error.detach())):.2f} dB')
    minutes = (time.monotonic() - started) / 60
    model.eval()
    return (lambda view, pose: _render(model, view, pose)), {'steps': step, 'minutes': minutes}


def _draw(images: np.ndarray, usable: np.ndarray | None, camera: Intrinsics,
          T_world_cam: np.ndarray, random: np.random.Generator, rays: int,
          ) -> tuple[torch.Tensor, np.ndarray, np.ndarray]:
    """Draw pixels that show the scene: colours (N, 3) in [0, 1], origins, directions (N, 3)."""
    photo, row, column = draw_usable(random, rays, images.shape[:3], usable)
    directions = camera.pixel_rays()[row, column]
    directions = np.einsum('nij,nj->ni', T_world_cam[photo, :3, :3], directions)
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    target = torch.from_numpy(images[photo, row, column].astype(np.float32) / 255)
    return target, T_world_cam[photo, :3, 3], directions


@torch.no_grad()
def _render(model: Nerfacto, view: Intrinsics, pose: CameraPose) -> np.ndarray:
    directions = view.pixel_rays().reshape(-1, 3) @ pose.T_world_cam[:3, :3].T
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    parts = [model(np.broadcast_to(pose.position, part.shape), part)['rgb'].numpy()
             for part in np.array_split(directions, -(-len(directions) // model.rules.eval_rays))]
    return np.concatenate(parts).reshape(view.height, view.width, 3)
