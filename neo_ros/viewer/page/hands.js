// What people do to look around: drag, wheel, two fingers, click, keys and buttons.
import { contentOf, find } from './elements.js';

// A pointer that moves less has clicked.
const CLICK_PX = 6;
const KEY_STEP = 0.12;
const ZOOM_STEP = 1.15;
const ACTIONS = {
  left: (around) => around.turn(KEY_STEP, 0),
  right: (around) => around.turn(-KEY_STEP, 0),
  up: (around) => around.turn(0, KEY_STEP),
  down: (around) => around.turn(0, -KEY_STEP),
  closer: (around) => around.zoom(ZOOM_STEP),
  wider: (around) => around.zoom(1 / ZOOM_STEP),
  back: (around) => around.back(),
  distance: (around) => around.ask(0.5, 0.5),
};
const KEYS = {
  // Shift with arrows looks around in recordings, too, where arrows alone lead through time.
  ArrowLeft: 'left', ArrowRight: 'right', ArrowUp: 'up', ArrowDown: 'down', '+': 'closer',
  '-': 'wider', 0: 'back', d: 'distance',
};

export class Hands {
  constructor(around) {
    this.around = around;
    this.pointers = new Map();
    for (const canvas of [find('picture'), find('look')]) {
      canvas.addEventListener('pointerdown', (event) => this.press(event));
      canvas.addEventListener('pointermove', (event) => this.drag(event));
      canvas.addEventListener('pointerup', (event) => this.release(event));
      canvas.addEventListener('pointercancel', (event) => this.pointers.delete(event.pointerId));
      canvas.addEventListener('wheel', (event) => this.roll(event), { passive: false });
    }
    document.addEventListener('keydown', (event) => this.pressKey(event));
    for (const button of document.querySelectorAll('#turns button, #look-bar button')) {
      button.addEventListener('click', () => ACTIONS[button.dataset.turn](around));
    }
  }

  press(event) {
    if (event.button !== 0 || !this.around.able) return;
    event.target.setPointerCapture(event.pointerId);
    this.pointers.set(event.pointerId, { x: event.clientX, y: event.clientY, far: 0 });
  }

  drag(event) {
    const held = this.pointers.get(event.pointerId);
    if (!held) return;
    const others = [...this.pointers.values()].filter((other) => other !== held);
    const [dx, dy] = [event.clientX - held.x, event.clientY - held.y];
    const before = others.length && Math.hypot(held.x - others[0].x, held.y - others[0].y);
    held.far += Math.hypot(dx, dy);
    [held.x, held.y] = [event.clientX, event.clientY];
    if (held.far < CLICK_PX) return;
    if (others.length) {
      const now = Math.hypot(held.x - others[0].x, held.y - others[0].y);
      others[0].far = CLICK_PX;
      if (before > 10 && now > 10) this.around.zoom(now / before);
    } else if (this.around.begin()) {
      const box = find('look').getBoundingClientRect();
      const radians = this.around.direction.hfov / (box.width || event.target.clientWidth);
      this.around.turn(dx * radians, dy * radians);
    }
  }

  release(event) {
    const held = this.pointers.get(event.pointerId);
    this.pointers.delete(event.pointerId);
    // A look is asked for where it is; the live picture beside it leads back to it.
    if (!held || held.far >= CLICK_PX) return;
    if (this.around.direction && event.target.id === 'picture') {
      this.around.back();
      return;
    }
    const [left, top, width, height] = contentOf(event.target);
    const [x, y] = [(event.clientX - left) / width, (event.clientY - top) / height];
    if (x >= 0 && x <= 1 && y >= 0 && y <= 1) this.around.ask(x, y);
  }

  roll(event) {
    if (!this.around.able || !this.around.place || event.ctrlKey) return;
    event.preventDefault();
    this.around.zoom(ZOOM_STEP ** (-event.deltaY / 100));
  }

  pressKey(event) {
    const name = event.key === '=' ? '+' : event.key;
    if (event.ctrlKey || event.altKey || event.metaKey || event.defaultPrevented
        || document.querySelector('dialog[open]') || !find('keys-on').checked
        || !(name in KEYS) || event.target.closest('input, select, textarea')) return;
    event.preventDefault();
    ACTIONS[KEYS[name]](this.around);
  }
}
