// The map: the scene from above, the camera in it, what it sees, and where it came from.
const TRAIL_MS = 60000;
// Places that are farther apart, in time or space, are not joined by a line.
const GAP_MS = 1000;
const JUMP = 1.0;
const SECTOR_PX = 46;

export class Map {
  // `canvas`: where to paint; `about`: what the server says of the plan; `picture`: its bitmap.
  constructor(canvas, about, picture) {
    Object.assign(this, { canvas, about, picture });
    this.trail = [];
    canvas.style.aspectRatio = `${about.width} / ${about.height}`;
  }

  add({ position, forward, captured }) {
    if (this.trail.length && captured < this.trail.at(-1).captured) this.trail = [];
    this.trail.push({ x: position[0], y: position[1], yaw: Math.atan2(forward[1], forward[0]),
      captured });
    while (this.trail[0].captured < captured - TRAIL_MS) this.trail.shift();
  }

  // Where a place in metres is on the canvas.
  pixel(x, y) {
    const { origin, resolution, width, height } = this.about;
    const [sx, sy] = [this.canvas.width / width, this.canvas.height / height];
    return [(x - origin[0]) / resolution * sx, (height - (y - origin[1]) / resolution) * sy];
  }

  // `look`: { yaw, hfov } while somebody looks away, else null; `lost`: the place is not known.
  paint(look, lost) {
    const { canvas } = this;
    const box = canvas.getBoundingClientRect();
    if (!box.width) return;
    const scale = devicePixelRatio;
    const [w, h] = [Math.round(box.width * scale), Math.round(box.height * scale)];
    if (canvas.width !== w || canvas.height !== h) [canvas.width, canvas.height] = [w, h];
    const context = canvas.getContext('2d');
    context.clearRect(0, 0, w, h);
    context.imageSmoothingQuality = 'high';
    context.globalAlpha = lost ? 0.35 : 1;
    context.drawImage(this.picture, 0, 0, w, h);
    this.paintOutlines(context, scale);
    this.paintScale(context, scale);
    this.paintTrail(context, scale);
    const here = this.trail.at(-1);
    if (here) this.paintCamera(context, here, look, scale);
    context.globalAlpha = 1;
  }

  paintOutlines(context, scale) {
    for (const line of this.about.outlines) {
      context.beginPath();
      for (const [x, y] of line) context.lineTo(...this.pixel(x, y));
      context.closePath();
      stroke(context, 1.2 * scale, 'rgb(255 255 255 / 0.85)', 'rgb(0 0 0 / 0.55)');
    }
  }

  paintScale(context, scale) {
    if (!this.about.metric) return;
    const metre = this.canvas.width / this.about.width / this.about.resolution;
    const [x, y] = [8 * scale, this.canvas.height - 8 * scale];
    context.beginPath();
    context.moveTo(x, y);
    context.lineTo(x + metre, y);
    stroke(context, 2 * scale, '#fff', 'rgb(0 0 0 / 0.8)');
    context.font = `600 ${11 * scale}px system-ui, sans-serif`;
    context.lineWidth = 3 * scale;
    context.strokeStyle = 'rgb(0 0 0 / 0.8)';
    context.strokeText('1 m', x, y - 5 * scale);
    context.fillStyle = '#fff';
    context.fillText('1 m', x, y - 5 * scale);
  }

  paintTrail(context, scale) {
    const newest = this.trail.at(-1)?.captured;
    for (let i = 1; i < this.trail.length; i += 1) {
      const [from, to] = [this.trail[i - 1], this.trail[i]];
      if (to.captured - from.captured > GAP_MS
          || Math.hypot(to.x - from.x, to.y - from.y) > JUMP) continue;
      context.beginPath();
      context.moveTo(...this.pixel(from.x, from.y));
      context.lineTo(...this.pixel(to.x, to.y));
      const share = 1 - (newest - to.captured) / TRAIL_MS;
      stroke(context, 2 * scale, `rgb(255 214 0 / ${0.15 + 0.85 * share})`,
        `rgb(0 0 0 / ${0.5 * share})`);
    }
  }

  paintCamera(context, here, look, scale) {
    const at = this.pixel(here.x, here.y);
    const { camera, wide } = this.about;
    sector(context, at, here.yaw, wide, SECTOR_PX * scale, 'rgb(255 255 255 / 0.35)', scale);
    sector(context, at, here.yaw, camera, SECTOR_PX * scale, 'rgb(255 214 0 / 0.6)', scale);
    if (look) {
      sector(context, at, look.yaw, [look.hfov / 2, look.hfov / 2], 1.35 * SECTOR_PX * scale,
        'rgb(64 160 255 / 0.55)', scale);
    }
    context.beginPath();
    context.arc(...at, 5 * scale, 0, 2 * Math.PI);
    context.fillStyle = '#ffd600';
    context.fill();
    context.lineWidth = 2 * scale;
    context.strokeStyle = '#000';
    context.stroke();
  }
}

// Fill the part of a circle that a view reaches to, [left, right] of its axis in radians.
function sector(context, at, yaw, [left, right], radius, colour, scale) {
  context.beginPath();
  context.moveTo(...at);
  // The canvas turns clockwise.
  context.arc(...at, radius, -yaw - left, -yaw + right);
  context.closePath();
  context.fillStyle = colour;
  context.fill();
  context.lineWidth = scale;
  context.strokeStyle = 'rgb(0 0 0 / 0.6)';
  context.stroke();
}

// A dark line below a light one: one of them shows on any floor.
function stroke(context, width, light, dark) {
  context.lineJoin = context.lineCap = 'round';
  context.lineWidth = 2 * width;
  context.strokeStyle = dark;
  context.stroke();
  context.lineWidth = width;
  context.strokeStyle = light;
  context.stroke();
}
