// The time line of a bag: what is known of its pictures over its time, painted and in words.
import { find, set, write } from './elements.js';

const AGAIN_MS = 2000;
// What lies farther apart than this part of the bag is not joined.
const JOINED = 20;
const NAMES = { guided: 'guided', agreement: 'agreement', psnr: 'truth',
  unlike: 'unlike the scene', rejects: 'rejected' };
// From the bottom to the top of a lane.
const PSNR = [15, 35];
export const LANES = {
  agreement: { colour: '#5ed394', low: 0, high: 1 },
  psnr: { colour: '#62aef7', low: PSNR[0], high: PSNR[1] },
  unlike: { colour: '#d59bff', low: 0, high: 1 },
};

export class Timeline {
  // `canvas`: where to paint; `changed()`: called when more is known.
  constructor(canvas, changed) {
    Object.assign(this, { canvas, changed });
    this.known = null;
    this.loads = 0;
    new ResizeObserver(() => this.paint()).observe(canvas);
  }

  // Ask the server; again and again while it still reads the bag.
  async load() {
    clearTimeout(this.again);
    this.loads += 1;
    const load = this.loads;
    let { known } = this;
    try {
      const answer = await fetch('/timeline');
      known = answer.ok ? await answer.json() : null;
    } catch { /* The server is away: again, later. */ }
    if (load !== this.loads) return;  // Another has begun meanwhile, perhaps for another camera.
    this.known = known;
    this.paint();
    this.changed();
    if (!this.known?.done) this.again = setTimeout(() => this.load(), AGAIN_MS);
  }

  // What is known at a share of the bag's time.
  at(share) {
    const { known } = this;
    const found = {};
    if (!known) return found;
    const [guided, psnr] = [known.guided, known.psnr].map((values) => lastKnown(values, share));
    if (guided !== undefined) {
      for (const name of ['guided', 'agreement', 'unlike']) {
        if (known[name] && known[name][guided] !== null) found[name] = known[name][guided];
      }
    }
    if (psnr !== undefined) found.psnr = known.psnr[psnr];
    return found;
  }

  // Write what is known beside the names of the lines, and return it in words.
  show(share) {
    const found = this.at(share);
    const rejects = this.known?.rejects.reduce((sum, count) => sum + count, 0) ?? 0;
    const words = {
      guided: found.guided !== undefined && `guided ${Math.round(100 * found.guided)} %`,
      agreement: found.agreement !== undefined && `agreement ${found.agreement.toFixed(2)}`,
      psnr: found.psnr !== undefined && `truth ${found.psnr.toFixed(1)} dB`,
      unlike: found.unlike !== undefined && `unlike the scene ${found.unlike.toFixed(2)}`,
      rejects: rejects > 0 && `rejected in all ${rejects}`,
    };
    for (const [name, text] of Object.entries(words)) {
      const known = name === 'rejects' ? rejects > 0 : Boolean(this.known?.[name]);
      set(find(`lane-${name}`).parentElement, 'hidden', !known);
      write(`lane-${name}`, text || NAMES[name]);
    }
    return Object.values(words).filter(Boolean).join(', ');
  }

  paint() {
    const { canvas, known } = this;
    const box = canvas.getBoundingClientRect();
    if (!box.width) return;
    const [w, h] = [box.width, box.height].map((side) => Math.round(side * devicePixelRatio));
    if (canvas.width !== w || canvas.height !== h) [canvas.width, canvas.height] = [w, h];
    const context = canvas.getContext('2d');
    context.clearRect(0, 0, w, h);
    if (!known) return;
    const count = known.rejects.length;
    const step = w / count;
    if (known.guided) {
      known.guided.forEach((share, i) => {
        if (share === null) return;
        const next = known.guided.findIndex((other, j) => j > i && other !== null);
        const pieces = next < 0 || next - i > count / JOINED ? 1 : next - i;
        context.fillStyle = share >= 0.5 ? '#255c3f' : '#c58a00';
        context.fillRect(i * step, 0, Math.ceil(pieces * step), h);
      });
    }
    for (const [name, lane] of Object.entries(LANES)) {
      if (known[name]) this.paintLane(context, known[name], lane, step, h);
    }
    context.fillStyle = '#ff5449';
    known.rejects.forEach((rejected, i) => {
      if (rejected) context.fillRect(i * step - 1, 0, Math.max(step, 3 * devicePixelRatio), h / 2);
    });
  }

  paintLane(context, values, { colour, low, high }, step, h) {
    context.strokeStyle = colour;
    context.lineWidth = 1.6 * devicePixelRatio;
    context.lineJoin = 'round';
    context.beginPath();
    let last = null;
    values.forEach((value, i) => {
      if (value === null) return;
      const share = Math.max(0, Math.min(1, (value - low) / (high - low)));
      const y = h - 2 - share * (h - 4);
      if (last === null || i - last > values.length / JOINED) context.moveTo((i + 0.5) * step, y);
      else context.lineTo((i + 0.5) * step, y);
      last = i;
    });
    context.stroke();
  }
}

// The number of the last piece up to a share of the bag of which something is known.
function lastKnown(values, share) {
  if (!values) return undefined;
  const piece = Math.min(values.length - 1, Math.max(0, Math.floor(share * values.length)));
  for (let i = piece; i >= Math.max(0, piece - values.length / JOINED); i -= 1) {
    if (values[i] !== null) return i;
  }
  return undefined;
}
