"""Cut views out of panoramas on a torch device: what `Panorama.cut_view` does on a CPU."""
from collections.abc import Callable
import math

from neo_ros.field.panorama import Panorama
from neo_ros.field.radiance_field import RadianceField
from neo_ros.field.torch_field import TorchField
from neo_ros.geometry import Intrinsics
import numpy as np
import torch

# Of a GPU's memory, what panoramas may take; one that is asked for again comes once more.
KEPT_SHARE = 0.25


class ViewCutter:
    """
    Cuts views of one kind, so that a network that is trained on a GPU does not wait for a CPU.

    The same pixels as `Panorama.cut_view`, up to the 32nds of a pixel that OpenCV counts in.
    """

    def __init__(self, view: Intrinsics, device: torch.device) -> None:
        self.device = device
        self.rays = torch.tensor(view.pixel_rays(), dtype=torch.float32, device=device)
        self.kept_bytes = math.inf if device.type == 'cpu' else (
            KEPT_SHARE * torch.cuda.get_device_properties(device).total_memory)
        self._images: dict[Panorama, torch.Tensor] = {}

    @torch.no_grad()
    def cut(self, panorama: Panorama, R_world_cam: np.ndarray) -> torch.Tensor:
        """Return RGBA uint8 (H, W, 4) on the device; see `Panorama.cut_view`."""
        image, band = self._on_device(panorama), panorama.band
        height, width = image.shape[:2]
        turned = torch.tensor(R_world_cam.T, dtype=torch.float32, device=self.device)
        x, y, z = (self.rays @ turned).unbind(-1)
        # As `Band.pixels`.
        azimuth = torch.remainder(torch.atan2(y, x) - band.low, 2 * math.pi)
        rise = torch.atan2(z, torch.hypot(x, y))
        columns = (1 - azimuth / band.width) * width - 0.5
        rows = (band.top - rise) / (band.top - band.bottom) * height - 0.5
        outside = (rows < -1) | (rows > height) | (columns < -1)
        rows = rows.clamp(0, height - 1)
        top, left = rows.floor(), columns.floor()
        above, before = top.long(), left.long() % width
        below, after = (above + 1).clamp(max=height - 1), (before + 1) % width
        across, down = (columns - left)[..., None], (rows - top)[..., None]

        def between(row: torch.Tensor) -> torch.Tensor:
            return torch.lerp(image[row, before].float(), image[row, after].float(), across)

        cut = torch.lerp(between(above), between(below), down).round().to(torch.uint8)
        cut[..., 3].masked_fill_(outside, 0)
        return cut

    def _on_device(self, panorama: Panorama) -> torch.Tensor:
        image = self._images.pop(panorama, None)
        if image is None:
            image = torch.tensor(panorama.image, device=self.device)
        self._images[panorama] = image
        if len(self._images) * image.nbytes > self.kept_bytes:
            del self._images[next(iter(self._images))]
        return image


def view_cutter(field: RadianceField, view: Intrinsics
                ) -> Callable[[Panorama, np.ndarray], torch.Tensor]:
    """Return what cuts views as `ViewCutter.cut` does, where the field is: OpenCV on a CPU."""
    if isinstance(field, TorchField):
        return ViewCutter(view, field.device).cut
    return lambda panorama, R_world_cam: torch.from_numpy(panorama.cut_view(view, R_world_cam))
