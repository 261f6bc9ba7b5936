// Where the camera is, and looking away from it: the second connection, and what people do.
import { coverOf, Direction, paintLook } from './look.js';
import { Map } from './map.js';

const RETRY_MS = 2000;
const SEND_MS = 50;
// The place is not recognised any more once pictures came for so long without one.
const LOST_MS = 1000;
const MOST_WIDTH = 480;
const FIRST_FIELD = 1.75;
// A pointer that moves less has clicked.
const CLICK_PX = 6;
const KEY_STEP = 0.12;
const ZOOM_STEP = 1.15;
const DISTANCE_MS = 8000;

const find = (id) => document.getElementById(id);

export class Around {
  // `now()`: the server's clock in ms; `delay()`: ms that a message takes; `redraw()`: called
  // when the live picture has another size on the page.
  constructor({ now, delay, redraw }) {
    Object.assign(this, { now, delay, redraw });
    this.way = 'outline';
    this.place = this.direction = this.look = this.map = null;
    this.pictured = 0;
    this.opened = false;
    this.about = { why: 'The map is being drawn.' };
    this.pointers = new globalThis.Map();
    this.asked = 0;
    this.listen();
    document.addEventListener('visibilitychange', () => (document.hidden ? this.drop()
      : this.connect()));
    setInterval(() => this.sendLook(), SEND_MS);
    this.loadMap();
  }

  async loadMap() {
    try {
      const about = await (await fetch('/map')).json();
      if (!about.why) {
        const picture = await createImageBitmap(await (await fetch('/map.webp')).blob());
        this.map = new Map(find('map'), about, picture);
      }
      this.about = about;
    } catch {
      setTimeout(() => this.loadMap(), RETRY_MS);
      return;
    }
    this.showAbout();
  }

  get able() {
    return !this.about.why;
  }

  showAbout() {
    for (const id of ['map', 'turns']) find(id).hidden = !this.able;
    find('no-map').hidden = this.able;
    find('no-map').textContent = this.about.why ?? '';
    find('stage').classList.toggle('turnable', this.able);
    this.tick();
  }

  // The main connection is there, or lost.
  open() { this.opened = true; this.connect(); }

  close() { this.opened = false; this.drop(); }

  connect() {
    if (!this.opened || document.hidden || this.socket) return;
    const scheme = location.protocol === 'https:' ? 'wss' : 'ws';
    const socket = new WebSocket(`${scheme}://${location.host}/around`);
    socket.binaryType = 'arraybuffer';
    this.socket = socket;
    socket.onopen = () => { this.changed = this.direction !== null; };
    socket.onmessage = (event) => (typeof event.data === 'string'
      ? this.hear(JSON.parse(event.data)) : this.receive(event.data));
    socket.onclose = () => {
      if (this.socket !== socket) return;
      this.socket = null;
      setTimeout(() => this.connect(), RETRY_MS);
    };
  }

  drop() {
    const { socket } = this;
    this.socket = null;
    socket?.close();
  }

  send(message) {
    if (this.socket?.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify(message));
  }

  confirm(seq) {
    const delay = this.delay();
    this.send({ got: seq, ahead: Number.isFinite(delay) ? delay / 1000 : 0 });
  }

  hear(message) {
    if (message.type === 'place') {
      this.confirm(message.seq);
      this.move(message);
    } else if (message.type === 'distance') {
      this.showDistance(message);
    } else {
      this.back();
      this.say('As many as possible are looking around already: try again later.');
    }
  }

  async receive(buffer) {
    const view = new DataView(buffer);
    const [first, second] = [view.getUint32(0, true), view.getUint32(4, true)];
    const meta = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 8, first)));
    const part = (start, end) => createImageBitmap(new Blob([new Uint8Array(buffer, start,
      end - start)]));
    try {
      const [bitmap, kinds] = await Promise.all([part(8 + first, 8 + first + second),
        part(8 + first + second, buffer.byteLength)]);
      if (this.direction && meta.seq > (this.look?.seq ?? 0)) {
        this.look?.bitmap.close();
        this.look?.kinds.close();
        this.look = { ...meta, bitmap, kinds };
        this.cover = coverOf(kinds, this.way);
        this.showLook();
      }
    } catch {
      // What the browser cannot decode; without its confirmation no other would come.
    }
    this.confirm(meta.seq);
    this.move(meta);
  }

  move(place) {
    this.place = place;
    this.map?.add(place);
    this.tick();
  }

  // A picture was shown that the camera took at this time of the server's clock.
  onPicture(captured) {
    this.pictured = captured;
  }

  setWay(way) {
    this.way = way;
    if (this.look) this.cover = coverOf(this.look.kinds, way);
    this.paint();
  }

  // Begin to look where the camera does, if nobody looks yet; return whether one can.
  begin() {
    if (!this.able || !this.place) return false;
    if (!this.direction) {
      const [left, right] = this.about.wide;
      this.direction = new Direction(this.place.forward, Math.min(left + right, FIRST_FIELD));
      find('stage').classList.add('looking');
      for (const id of ['look', 'look-bar', 'look-legend']) find(id).hidden = false;
      this.redraw();
    }
    this.changed = true;
    this.hideDistance();
    return true;
  }

  turn(left, up) {
    if (!this.begin()) return;
    this.direction.turn(left, up);
    this.paint();
  }

  zoom(times) {
    if (!this.begin()) return;
    this.direction.zoom(this.direction.hfov / times);
    this.paint();
  }

  // Back to the camera.
  back() {
    if (!this.direction) return;
    this.direction = this.look = null;
    this.send({ look: null });
    find('stage').classList.remove('looking');
    for (const id of ['look', 'look-bar', 'look-legend', 'look-sign']) find(id).hidden = true;
    this.hideDistance();
    this.redraw();
    this.say('Back to the camera.');
  }

  sendLook() {
    if (!this.changed || !this.direction) return;
    this.changed = false;
    const box = find('look').getBoundingClientRect();
    const width = Math.min(MOST_WIDTH, Math.round(box.width)) || MOST_WIDTH;
    const { yaw, pitch, hfov } = this.direction;
    this.send({ look: { yaw, pitch, hfov, width,
      height: Math.round(width * box.height / box.width) || width } });
  }

  showLook() {
    const { look } = this;
    const sign = find('look-sign');
    sign.hidden = !look.predicted;
    sign.classList.toggle('old', look.stale);
    const late = `${(look.age).toFixed(1)} s`;
    sign.textContent = look.stale ? `Stale: nothing has come for ${late}.`
      : `Predicted: ${late} late, drawn where the last motion leads.`;
    find('look').classList.toggle('old', look.stale);
    this.paint();
  }

  paint() {
    if (!this.direction) return;
    find('look-where').textContent = `Looking ${this.direction.words(this.place.forward)}`;
    const canvas = find('look');
    const box = canvas.getBoundingClientRect();
    const [w, h] = [box.width, box.height].map((side) => Math.round(side * devicePixelRatio));
    if (w && (canvas.width !== w || canvas.height !== h)) [canvas.width, canvas.height] = [w, h];
    if (this.look) {
      paintLook(canvas.getContext('2d', { alpha: false }), this.look, this.cover, this.direction,
        devicePixelRatio);
    }
    this.map?.paint(this.direction, this.lost);
  }

  get lost() {
    return !this.place || this.pictured - this.place.captured > LOST_MS;
  }

  tick() {
    if (!this.able) return;
    const { place, lost } = this;
    const ago = place ? Math.max(this.now() - place.captured, 0) / 1000 : 0;
    const unit = this.about.metric ? ' m' : '';
    find('where').classList.toggle('lost', lost);
    find('place').textContent = !place ? 'The place has not been recognised yet.'
      : lost ? `Place not recognised for ${ago.toFixed(0)} s; this was the last one.`
        : `x ${place.position[0].toFixed(1)}${unit}, y ${place.position[1].toFixed(1)}${unit}, `
          + `${ago.toFixed(1)} s ago`;
    this.map?.paint(this.direction, lost);
  }

  // Ask how far away a point is, in shares of the picture on the screen.
  ask(x, y) {
    if (!this.able || !this.place) return;
    this.asked += 1;
    this.point = [x, y];
    this.send({ ask: { x, y, id: this.asked } });
  }

  showDistance({ id, metres, plus_minus: plusMinus, contradicted }) {
    if (id !== this.asked) return;
    const label = find('distance');
    const canvas = this.direction ? find('look') : find('picture');
    const [left, top, width, height] = contentOf(canvas);
    const stage = find('stage').getBoundingClientRect();
    label.style.left = `${left - stage.left + this.point[0] * width}px`;
    label.style.top = `${top - stage.top + this.point[1] * height}px`;
    const flip = this.point[0] > 0.5;
    label.classList.toggle('left', flip);
    label.style.maxWidth = `${(flip ? this.point[0] : 1 - this.point[0]) * width - 24}px`;
    const digits = plusMinus < 0.095 ? 2 : 1;
    const unit = this.about.metric ? ' m' : '';
    label.textContent = metres === undefined ? 'Distance not known'
      : `${metres.toFixed(digits)} ± ${plusMinus.toFixed(digits)}${unit}, as remembered`
        + (contradicted ? '. Something else may stand there now.' : '');
    label.hidden = false;
    clearTimeout(this.hiding);
    this.hiding = setTimeout(() => this.hideDistance(), DISTANCE_MS);
  }

  hideDistance() {
    find('distance').hidden = true;
  }

  say(words) {
    find('announcer').textContent = words;
  }

  listen() {
    for (const canvas of [find('picture'), find('look')]) {
      canvas.addEventListener('pointerdown', (event) => this.press(event));
      canvas.addEventListener('pointermove', (event) => this.drag(event));
      canvas.addEventListener('pointerup', (event) => this.release(event));
      canvas.addEventListener('pointercancel', (event) => this.pointers.delete(event.pointerId));
      canvas.addEventListener('wheel', (event) => {
        if (!this.able || !this.place || event.ctrlKey) return;
        event.preventDefault();
        this.zoom(ZOOM_STEP ** (-event.deltaY / 100));
      }, { passive: false });
    }
    document.addEventListener('keydown', (event) => this.press_key(event));
    for (const button of document.querySelectorAll('#turns button, #look-bar button')) {
      button.addEventListener('click', () => ACTIONS[button.dataset.turn](this));
    }
    document.addEventListener('fullscreenchange', () => {
      (document.fullscreenElement ? find('stage') : find('where-home')).append(find('where'));
      this.paint();
    });
    new ResizeObserver(() => { this.changed = true; this.paint(); }).observe(find('stage'));
  }

  press(event) {
    if (event.button !== 0 || !this.able) return;
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
      if (before > 10 && now > 10) this.zoom(now / before);
    } else if (this.begin()) {
      const box = find('look').getBoundingClientRect();
      const radians = this.direction.hfov / (box.width || event.target.clientWidth);
      this.turn(dx * radians, dy * radians);
    }
  }

  release(event) {
    const held = this.pointers.get(event.pointerId);
    this.pointers.delete(event.pointerId);
    // A look is asked for where it is; the live picture beside it leads back to it.
    if (!held || held.far >= CLICK_PX) return;
    if (this.direction && event.target.id === 'picture') {
      this.back();
      return;
    }
    const [left, top, width, height] = contentOf(event.target);
    const [x, y] = [(event.clientX - left) / width, (event.clientY - top) / height];
    if (x >= 0 && x <= 1 && y >= 0 && y <= 1) this.ask(x, y);
  }

  press_key(event) {
    const name = event.key === '=' ? '+' : event.key;
    if (event.ctrlKey || event.altKey || event.metaKey || event.defaultPrevented
        || document.querySelector('dialog[open]') || !find('keys-on').checked
        || !(name in KEYS) || event.target.closest('input, select, textarea')) return;
    event.preventDefault();
    ACTIONS[KEYS[name]](this);
  }
}

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
  ArrowLeft: 'left', ArrowRight: 'right', ArrowUp: 'up', ArrowDown: 'down', '+': 'closer',
  '-': 'wider', 0: 'back', Home: 'back', d: 'distance',
};

// Left, top, width and height on the page of what a canvas shows; the rest of its box is empty.
function contentOf(canvas) {
  const box = canvas.getBoundingClientRect();
  const fit = Math.min(box.width / canvas.width, box.height / canvas.height);
  const [width, height] = [canvas.width * fit, canvas.height * fit];
  return [box.left + (box.width - width) / 2, box.top + (box.height - height) / 2, width, height];
}
