// Looking around by gamepad: either stick turns, the shoulder buttons zoom, A asks how far away the
// middle is, B leads back to the camera. Buttons and axes of the "standard" mapping.
const PERIOD_MS = 50;
// Sticks at rest are not quite at 0.
const DEAD = 0.15;
const RADIANS_PER_S = 1.4;
const ZOOM_PER_S = 2;
const [A, B, LEFT_SHOULDER, RIGHT_SHOULDER] = [0, 1, 4, 5];

export class Gamepads {
  constructor(around) {
    this.around = around;
    this.held = new Set();
    window.addEventListener('gamepadconnected', () => this.watch());
    this.watch();
  }

  // Gamepads tell nothing by themselves: they are asked while there is one.
  watch() {
    clearInterval(this.asking);
    if (this.pads().length) this.asking = setInterval(() => this.ask(), PERIOD_MS);
  }

  pads() {
    return [...(navigator.getGamepads?.() ?? [])].filter((pad) => pad?.mapping === 'standard');
  }

  ask() {
    const pads = this.pads();
    if (!pads.length) clearInterval(this.asking);
    if (document.hidden || document.querySelector('dialog[open]')) return;
    for (const pad of pads) {
      const [x, y] = [0, 1].map((axis) => [pad.axes[axis], pad.axes[axis + 2]]
        .map((value) => (Math.abs(value ?? 0) < DEAD ? 0 : value))
        .reduce((most, value) => (Math.abs(value) > Math.abs(most) ? value : most)));
      const turn = RADIANS_PER_S * PERIOD_MS / 1000;
      if (x || y) this.around.turn(-x * turn, -y * turn);
      const zoom = pad.buttons[RIGHT_SHOULDER]?.pressed - pad.buttons[LEFT_SHOULDER]?.pressed;
      if (zoom) this.around.zoom(ZOOM_PER_S ** (zoom * PERIOD_MS / 1000));
      this.once(pad, A, () => this.around.ask(0.5, 0.5));
      this.once(pad, B, () => this.around.back());
    }
  }

  // A button that is held counts once.
  once(pad, button, act) {
    const name = `${pad.index} ${button}`;
    const pressed = Boolean(pad.buttons[button]?.pressed);
    if (pressed && !this.held.has(name)) act();
    if (pressed) this.held.add(name);
    else this.held.delete(name);
  }
}
