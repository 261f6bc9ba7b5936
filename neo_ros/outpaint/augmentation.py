"""
What a camera does to a picture and a stream of renderings does not. Seeded by the caller.

Exposure and white balance are the whole camera's: they change the wide view, so that the ring is
learnt in the light of its middle. Faults and things in the way are put into the input alone: the
truth stays as it is, and the network learns to look through them.
"""
import cv2
import numpy as np
import torch


def expose_views(views: torch.Tensor, strength: float,
                 random: np.random.Generator) -> torch.Tensor:
    """Return copies of wide views, RGBA uint8 (B, H, W, 4), as other exposures show them."""
    exposed = views.clone()
    for view in exposed:
        # By up to about a stop, and colours by some per cent.
        exposure = 2 ** (0.35 * strength * random.standard_normal())
        gain = exposure * (1 + 0.06 * strength * random.standard_normal(3))
        shown = view[..., :3] * torch.tensor(gain, dtype=torch.float32, device=view.device)
        view[..., :3] = (shown + 0.5).clamp(0, 255).to(torch.uint8)
    return exposed


def augment_inputs(images: np.ndarray, photometric: float, occluders: float,
                   random: np.random.Generator) -> np.ndarray:
    """
    Return altered copies of narrow images, RGB uint8 (B, h, w, 3).

    photometric  strength of blur, noise and JPEG: 0 none, 1 a poor camera
    occluders    share of the images into which somebody or something is put that was not there
    """
    altered = []
    for image in images:
        # As in a camera: things stand in the scene, the lens blurs, the sensor adds its noise.
        if random.random() < occluders:
            image = _occluded(image, images[random.integers(len(images))], random)
        if photometric > 0:
            image = _photographed(image, photometric, random)
        altered.append(image)
    return np.stack(altered)


def _photographed(image: np.ndarray, strength: float, random: np.random.Generator) -> np.ndarray:
    """Add the faults of lens, sensor and compression."""
    blur = strength * max(random.uniform(-1, 1), 0) * image.shape[1] / 100
    noise = 5 * strength * max(random.uniform(-0.5, 1), 0)
    quality = 100 - 70 * min(strength, 1) * max(random.uniform(-1, 1), 0)
    pixels = image.astype(np.float32)
    if blur > 0.2:
        pixels = _blurred(pixels, blur, random)
    if noise > 0:
        pixels += noise * random.standard_normal(pixels.shape, np.float32)
    result = np.clip(pixels + 0.5, 0, 255).astype(np.uint8)
    if quality < 98:
        encoded = cv2.imencode('.jpg', result, [cv2.IMWRITE_JPEG_QUALITY, int(quality)])[1]
        result = cv2.imdecode(encoded, cv2.IMREAD_COLOR)
    return result


def _blurred(pixels: np.ndarray, sigma: float, random: np.random.Generator) -> np.ndarray:
    """Blur as a lens out of focus does, or as a moving camera does, in one direction."""
    if random.random() < 0.5:
        return cv2.GaussianBlur(pixels, (0, 0), sigma, borderType=cv2.BORDER_REFLECT)
    length = max(int(4 * sigma), 2)
    kernel = np.zeros((2 * length + 1, 2 * length + 1), np.float32)
    angle = random.uniform(0, np.pi)
    reach = np.array([np.cos(angle), np.sin(angle)]) * length / 2
    start, stop = np.rint(length - reach).astype(int), np.rint(length + reach).astype(int)
    cv2.line(kernel, start.tolist(), stop.tolist(), 1.0)
    return cv2.filter2D(pixels, -1, kernel / kernel.sum(), borderType=cv2.BORDER_REFLECT)


def _occluded(image: np.ndarray, other: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """
    Put a person's silhouette or a box into the image, coloured by its own or another picture.

    It covers a tenth to a half of the width and stands on the lower border or near it.
    """
    height, width = image.shape[:2]
    shape = np.zeros((height, width), np.uint8)
    wide = random.uniform(0.1, 0.5) * width
    tall = min(wide * random.uniform(1, 4), 0.95 * height)
    x = random.uniform(-0.2, 1.2) * width
    foot = height + random.uniform(-0.2, 0.3) * tall
    if random.random() < 0.5:
        _draw_person(shape, x, foot, wide, tall)
    else:
        box = cv2.boxPoints(((x, foot - tall / 2), (wide, tall), random.uniform(-10, 10)))
        cv2.fillConvexPoly(shape, np.rint(box).astype(np.int32), 255)
    colour = random.uniform(0, 255, 3)
    # A few colours of another view, enlarged, make clothes or a surface with a pattern.
    cells = random.integers(2, 12)
    rows, columns = random.integers(height), random.integers(width)
    patch = np.roll(other, (rows, columns), (0, 1))[:cells, :cells]
    pattern = cv2.resize(patch, (width, height), interpolation=cv2.INTER_LINEAR)
    mixed = random.uniform(0.3, 1) * (colour - pattern) + pattern
    return np.where(shape[..., None] > 0, mixed.astype(np.uint8), image)


def _draw_person(shape: np.ndarray, x: float, foot: float, wide: float, tall: float) -> None:
    """Draw a head, a body and legs, as wide and as tall as said, into a mask (h, w) uint8."""
    centre = np.array([x, foot - tall])
    parts = [((0, 0.09), (0.28, 0.09)), ((0, 0.38), (0.5, 0.23)), ((-0.2, 0.78), (0.18, 0.25)),
             ((0.2, 0.78), (0.18, 0.25))]
    for (right, down), (half_width, half_height) in parts:
        place = centre + [right * wide, down * tall]
        axes = np.maximum([half_width * wide, half_height * tall], 1)
        cv2.ellipse(shape, np.rint(place).astype(int).tolist(), np.rint(axes).astype(int).tolist(),
                    0, 0, 360, 255, -1)
