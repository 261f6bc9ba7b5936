// Where the camera is, and looking away from it: what is known of both, and how it is shown.
import { AroundLink } from './around_link.js';
import { contentOf, find } from './elements.js';
import { Gamepads } from './gamepad.js';
import { Hands } from './hands.js';
import { coverOf, Direction, paintLook } from './look.js';
import { Map } from './map.js';

const RETRY_MS = 2000;
const SEND_MS = 50;
// The place is not recognised any more once pictures came for so long without one.
const LOST_MS = 1000;
const MOST_WIDTH = 480;
const FIRST_FIELD = 1.75;
const DISTANCE_MS = 8000;

export class Around {
  // `now()`: the server's clock in ms; `delay()`: ms that a message takes; `redraw()`: called
  // when the live picture has another size on the page; `standing()`: a recording is paused.
  constructor({ now, delay, redraw, standing }) {
    Object.assign(this, { now, redraw, standing });
    this.way = 'outline';
    this.place = this.direction = this.look = this.map = null;
    this.pictured = 0;
    this.about = { why: 'The map is being drawn.' };
    this.asked = this.loads = 0;
    this.link = new AroundLink({
      onOpen: () => { this.changed = this.direction !== null; },
      onPlace: (place) => this.move(place),
      onLook: (look) => this.take(look),
      onDistance: (distance) => this.showDistance(distance),
      onFull: () => {
        this.back();
        this.say('As many as possible are looking around already: try again later.');
      },
    }, delay);
    this.hands = new Hands(this);
    this.gamepads = new Gamepads(this);
    document.addEventListener('fullscreenchange', () => {
      (document.fullscreenElement ? find('stage') : find('where-home')).append(find('where'));
      this.paint();
    });
    new ResizeObserver(() => { this.changed = true; this.paint(); }).observe(find('stage'));
    setInterval(() => this.sendLook(), SEND_MS);
  }

  // With each connection: the server may have been started anew, with another model.
  async loadMap() {
    this.loads += 1;
    const load = this.loads;
    try {
      const about = await (await fetch('/map')).json();
      const picture = about.why ? null
        : await createImageBitmap(await (await fetch('/map.webp')).blob());
      if (load !== this.loads) return;
      if (JSON.stringify(about) === JSON.stringify(this.about)) return;
      this.about = about;
      this.map = picture && new Map(find('map'), about, picture);
      // A bag may stand still, and tell its place no more.
      if (this.place) this.map?.add(this.place);
    } catch {
      if (load === this.loads) setTimeout(() => this.loadMap(), RETRY_MS);
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
  open() {
    this.place = null;  // It may be of another model's map; the new connection tells it anew.
    this.link.open();
    this.loadMap();
  }

  close() { this.link.close(); }

  take(look) {
    if (!this.direction) {
      release(look);
      return;
    }
    release(this.look);
    this.look = look;
    this.cover = coverOf(look.kinds, this.way);
    this.showLook();
  }

  move(place) {
    this.place = place;
    this.map?.add(place);
    if (place.why && this.direction) this.sign(`Cannot be drawn: ${place.why}`, true);
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
    release(this.look);
    this.direction = this.look = null;
    this.link.send({ look: null });
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
    this.link.send({ look: { yaw, pitch, hfov, width,
      height: Math.round(width * box.height / box.width) || width } });
  }

  showLook() {
    const { look } = this;
    const late = `${(look.age).toFixed(1)} s`;
    this.sign(!look.predicted ? '' : look.stale ? `Stale: nothing has come for ${late}.`
      : `Predicted: ${late} late, drawn where the last motion leads.`, look.stale);
    this.paint();
  }

  // Say something about the look, or nothing; `old`: it does not show what is there now.
  sign(words, old) {
    const sign = find('look-sign');
    sign.hidden = !words;
    sign.textContent = words;
    sign.classList.toggle('old', old);
    find('look').classList.toggle('old', old);
  }

  paint() {
    if (!this.direction) return;
    if (this.place) {
      find('look-where').textContent = `Looking ${this.direction.words(this.place.forward)}`;
    }
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
          + (this.standing() ? 'paused' : `${ago.toFixed(1)} s ago`);
    this.map?.paint(this.direction, lost);
  }

  // Ask how far away a point is, in shares of the picture on the screen.
  ask(x, y) {
    if (!this.able || !this.place) return;
    this.asked += 1;
    this.point = [x, y];
    this.link.send({ ask: { x, y, id: this.asked } });
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
}

function release(look) {
  look?.bitmap.close();
  look?.kinds.close();
}
