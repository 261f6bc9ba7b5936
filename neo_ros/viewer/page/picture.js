// Paints a picture: the camera's frame, and what lies outside of it in one of four ways.
const TINT = [255, 64, 129];
const DIM = 'rgb(0 0 0 / 0.62)';
const MOST_TINT = 0.8;

// Return the camera's frame in pixels of a canvas; an empty one while it is not known.
function frameOf(picture, width, height) {
  const [left, top, w, h] = picture.seen ?? [0, 0, 0, 0];
  return [left * width, top * height, w * width, h * height];
}

// Fill everything outside the frame.
function fillRing(context, [x, y, w, h], width, height, style) {
  context.fillStyle = style;
  context.beginPath();
  context.rect(0, 0, width, height);
  context.rect(x, y, w, h);
  context.fill('evenodd');
}

// A dark and a light line: one of them shows on any background.
function outline(context, [x, y, w, h], thickness, trust) {
  if (!w || !h) return;
  context.setLineDash(trust === 'rough' ? [6 * thickness, 4 * thickness] : []);
  context.lineJoin = 'miter';
  context.strokeStyle = 'rgb(0 0 0 / 0.75)';
  context.lineWidth = 3 * thickness;
  context.strokeRect(x, y, w, h);
  context.strokeStyle = trust === 'none' ? '#ffb300' : '#ffffff';
  context.lineWidth = thickness;
  context.strokeRect(x, y, w, h);
  context.setLineDash([]);
}

// Turn the grey picture of the confidence into a tint: the less sure, the stronger.
export function tintOf(sureness) {
  const canvas = new OffscreenCanvas(sureness.width, sureness.height);
  const context = canvas.getContext('2d', { willReadFrequently: true });
  context.drawImage(sureness, 0, 0);
  const pixels = context.getImageData(0, 0, canvas.width, canvas.height);
  const data = pixels.data;
  for (let i = 0; i < data.length; i += 4) {
    data[i + 3] = MOST_TINT * (255 - data[i]);
    [data[i], data[i + 1], data[i + 2]] = TINT;
  }
  context.putImageData(pixels, 0, 0);
  return canvas;
}

// Paint into the whole canvas of `context`. `scale`: canvas pixels per line pixel. `trust` in what
// lies outside the frame: 'known', 'rough' (place not recognised), 'none' (not in the scene).
export function paint(context, picture, way, scale, trust) {
  const { width, height } = context.canvas;
  const frame = frameOf(picture, width, height);
  context.imageSmoothingQuality = 'high';
  context.drawImage(picture.bitmap, 0, 0, width, height);
  if (way === 'confidence' && picture.tint) {
    context.save();
    context.beginPath();
    context.rect(0, 0, width, height);
    context.rect(...frame);
    context.clip('evenodd');
    context.drawImage(picture.tint, 0, 0, width, height);
    context.restore();
  }
  if (way === 'dim') fillRing(context, frame, width, height, DIM);
  if (way === 'camera') fillRing(context, frame, width, height, '#000');
  outline(context, frame, 1.5 * scale, trust);
}

// Return a PNG blob of the picture as it is shown, with a line that says what it is.
export function snapshot(picture, way, lines, trust) {
  const scale = Math.max(1, Math.ceil(640 / picture.bitmap.width));
  const [width, height] = [picture.bitmap.width * scale, picture.bitmap.height * scale];
  const painted = new OffscreenCanvas(width, height);
  paint(painted.getContext('2d'), picture, way, 1, trust);
  const line = 20;
  const canvas = new OffscreenCanvas(width, height + line * lines.length + 8);
  const context = canvas.getContext('2d');
  context.fillStyle = '#000';
  context.fillRect(0, 0, canvas.width, canvas.height);
  context.drawImage(painted, 0, 0);
  context.fillStyle = '#fff';
  context.font = '13px system-ui, sans-serif';
  lines.forEach((text, i) => context.fillText(text, 8, height + line * (i + 1) - 3, width - 16));
  return canvas.convertToBlob({ type: 'image/png' });
}
