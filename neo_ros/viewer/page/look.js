// A look away from the camera: which way, and how it is painted.
const SEEN = 255;
const RECENT = 192;
const REMEMBERED = 128;
const TINT = [255, 64, 129];
const UNKNOWN_COLOUR = [52, 58, 66];
const MOST_PITCH = 1.4;
const FIELDS = [0.3, 2.2];
// Opacity of what covers the picture, by way and kind.
const COVERS = {
  outline: { [RECENT]: 0, [REMEMBERED]: 0 },
  dim: { [RECENT]: 0.3, [REMEMBERED]: 0.55 },
  confidence: { [RECENT]: 0.15, [REMEMBERED]: 0.35 },
  camera: { [RECENT]: 1, [REMEMBERED]: 1 },
};

// The direction that somebody wants, held in the axes of the scene.
export class Direction {
  // `forward`: where the camera looks; `hfov`: radians.
  constructor(forward, hfov) {
    this.yaw = Math.atan2(forward[1], forward[0]);
    this.pitch = Math.asin(Math.max(-1, Math.min(1, forward[2])));
    this.hfov = 0;
    this.zoom(hfov);
  }

  turn(left, up) {
    this.yaw = Math.atan2(Math.sin(this.yaw + left), Math.cos(this.yaw + left));
    this.pitch = Math.max(-MOST_PITCH, Math.min(MOST_PITCH, this.pitch + up));
  }

  zoom(hfov) {
    this.hfov = Math.max(FIELDS[0], Math.min(FIELDS[1], hfov));
  }

  // In words, from the camera's own direction.
  words(forward) {
    const yaw = this.yaw - Math.atan2(forward[1], forward[0]);
    const turned = Math.round(Math.atan2(Math.sin(yaw), Math.cos(yaw)) * 180 / Math.PI);
    const side = Math.abs(turned) > 165 ? 'behind the camera'
      : Math.abs(turned) < 5 ? 'straight ahead'
        : `${Math.abs(turned)}° to the ${turned > 0 ? 'left' : 'right'}`;
    const up = Math.round(this.pitch * 180 / Math.PI);
    return Math.abs(up) < 5 ? side : `${side}, ${Math.abs(up)}° ${up > 0 ? 'up' : 'down'}`;
  }
}

// Cover what is not seen now, by way; the unknown is striped in every way.
export function coverOf(kinds, way) {
  const canvas = new OffscreenCanvas(kinds.width, kinds.height);
  const context = canvas.getContext('2d', { willReadFrequently: true });
  context.drawImage(kinds, 0, 0);
  const pixels = context.getImageData(0, 0, canvas.width, canvas.height);
  const { data } = pixels;
  const { width } = canvas;
  const read = Uint8Array.from({ length: data.length / 4 }, (_, i) => data[4 * i]);
  const covers = COVERS[way];
  for (let i = 0; i < read.length; i += 1) {
    const kind = read[i];
    let colour = way === 'confidence' ? TINT : [0, 0, 0];
    let share = kind === SEEN ? 0 : covers[kind] ?? 1;
    if (covers[kind] === undefined && kind !== SEEN) {
      const [x, y] = [i % width, Math.floor(i / width)];
      colour = way === 'camera' ? [0, 0, 0]
        : UNKNOWN_COLOUR.map((value) => value + ((x + y) % 8 < 2 ? 40 : 0));
    } else if (way === 'outline' && kind === REMEMBERED
        && [1, -1, width, -width].some((step) => read[i + step] === RECENT)) {
      // A dotted line around what was seen in the last seconds.
      const [x, y] = [i % width, Math.floor(i / width)];
      [colour, share] = [[255, 255, 255], (x + y) % 4 < 2 ? 0.7 : 0];
    }
    data.set(colour, 4 * i);
    data[4 * i + 3] = 255 * share;
  }
  context.putImageData(pixels, 0, 0);
  return canvas;
}

// Paint a look; until the next one comes, shifted to where somebody has turned meanwhile.
export function paintLook(context, look, cover, direction, scale) {
  const { width, height } = context.canvas;
  const zoom = Math.tan(look.hfov / 2) / Math.tan(direction.hfov / 2);
  const pixels = width / (2 * Math.tan(direction.hfov / 2));
  const turn = Math.atan2(Math.sin(direction.yaw - look.yaw), Math.cos(direction.yaw - look.yaw));
  context.setTransform(1, 0, 0, 1, 0, 0);
  context.fillStyle = '#07090b';
  context.fillRect(0, 0, width, height);
  context.translate(width / 2 + turn * pixels, height / 2 + (direction.pitch - look.pitch) * pixels);
  context.scale(zoom, zoom);
  context.translate(-width / 2, -height / 2);
  context.imageSmoothingQuality = 'high';
  context.drawImage(look.bitmap, 0, 0, width, height);
  context.drawImage(cover, 0, 0, width, height);
  for (const [colour, thick] of [['rgb(0 0 0 / 0.75)', 4.5], ['#ffffff', 1.5]]) {
    context.strokeStyle = colour;
    context.lineWidth = thick * scale / zoom;
    for (const line of look.frame) {
      context.beginPath();
      for (const [x, y] of line) context.lineTo(x * width, y * height);
      context.stroke();
    }
  }
  context.setTransform(1, 0, 0, 1, 0, 0);
}
