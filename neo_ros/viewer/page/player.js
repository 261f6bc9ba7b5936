// Plays a bag: pause, step, seek, speed, what is beside the picture, and links to a moment.
import { find, set, write } from './elements.js';
import { paint } from './picture.js';
import { Timeline } from './timeline.js';
import { clockTime } from './words.js';

const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 4, 8];
const SKIP_S = 5;
const MOST_STEPS = 1000;
// A position that was asked for stands until the picture comes, so long at most.
const ASKED_MS = 1500;
// The slider moves with every frame of the screen: it is sent this often at most.
const SEEK_MS = 50;

export class Player {
  // `ask(wanted)`: says it to the server; `redraw()`: the picture has another place.
  constructor({ ask, redraw, say }) {
    Object.assign(this, { ask, redraw, say });
    this.status = null;
    this.followed = this.stood = false;
    this.sought = this.sending = null;
    this.asked = { at: 0, until: 0 };
    this.beside = 'none';
    this.camera = null;
    this.timeline = new Timeline(find('timeline'), () => this.showMoment());
    this.hands();
    // The address may have been marked anew meanwhile.
    window.addEventListener('hashchange', (event) => this.follow(new URL(event.newURL).hash));
  }

  get able() { return Boolean(this.status?.playback); }

  get standing() { return this.able && !this.status.playback.playing; }

  // Seconds from the start of the bag: of what is shown, or asked for.
  get position() {
    if (performance.now() < this.asked.until) return this.asked.at;
    return this.recorded === undefined ? 0 : this.recorded - this.status.span[0];
  }

  get length() { return this.status.span[1] - this.status.span[0]; }

  hands() {
    const buttons = {
      play: () => this.toggle(), before: () => this.step(-1), after: () => this.step(1),
      link: () => this.copyLink(),
    };
    for (const [id, act] of Object.entries(buttons)) find(id).addEventListener('click', act);
    find('seek').addEventListener('input', () => this.seek(
      this.length * find('seek').value / MOST_STEPS));
    find('speed').addEventListener('change', () => this.command({ rate: +find('speed').value }));
    find('beside-choice').addEventListener('change', () => this.choose(
      find('beside-choice').value));
    // Before those who look around: arrows lead through time here.
    document.addEventListener('keydown', (event) => this.pressKey(event), true);
  }

  command(player) { this.ask({ player }); }

  toggle() { this.command({ play: !this.status.playback.playing }); }

  step(step) {
    this.asked.until = 0;
    this.command({ step });
  }

  seek(seconds) {
    const at = Math.max(0, Math.min(this.length, seconds));
    this.asked = { at, until: performance.now() + ASKED_MS };
    this.sought = at;
    if (!this.sending) this.sendSeek();
    this.showMoment();
  }

  sendSeek() {
    this.command({ seek: this.sought });
    this.sought = null;
    this.sending = setTimeout(() => {
      this.sending = null;
      if (this.sought !== null) this.sendSeek();
    }, SEEK_MS);
  }

  faster(by) {
    const { rate } = this.status.playback;
    const next = by > 0 ? SPEEDS.find((speed) => speed > rate)
      : SPEEDS.findLast((speed) => speed < rate);
    if (next) {
      this.command({ rate: next });
      this.say(`Speed ${next}.`);
    }
  }

  pressKey(event) {
    if (!this.able || event.ctrlKey || event.altKey || event.metaKey || event.defaultPrevented
        || document.querySelector('dialog[open]') || !find('keys-on').checked) return;
    const { target } = event;
    const arrows = !event.shiftKey && event.key.startsWith('Arrow');
    if (target !== find('seek') && target.closest('input, select, textarea')) return;
    if (event.key === ' ' && target.closest('button, a, summary')) return;
    const actions = {
      ' ': () => this.toggle(), ',': () => this.step(-1), '.': () => this.step(1),
      '<': () => this.faster(-1), '>': () => this.faster(1), Home: () => this.seek(0),
      End: () => this.seek(this.length), l: () => this.copyLink(),
    };
    if (arrows) {
      actions.ArrowLeft = () => this.seek(this.position - SKIP_S);
      actions.ArrowRight = () => this.seek(this.position + SKIP_S);
    }
    const action = actions[event.key.length === 1 ? event.key.toLowerCase() : event.key];
    if (!action || (event.repeat && event.key === ' ')) return;
    event.preventDefault();
    action();
  }

  // What the server says; `first`: of this connection.
  update(status, first) {
    this.status = status;
    set(find('player'), 'hidden', !this.able);
    document.body.classList.toggle('recorded', this.able);
    if (!this.able) return;
    const { playing, ended, rate, camera, cameras, beside } = status.playback;
    // It plays on: to load the page again must not lead back to where it stood.
    if (this.stood && playing) history.replaceState(null, '', location.pathname);
    this.stood = this.standing;
    write('play', playing ? 'Pause' : ended ? 'Again' : 'Play');
    const speed = find('speed');
    if (![...speed.options].some((option) => +option.value === rate)) {
      speed.add(new Option(`${rate} ×`, rate));
    }
    if (+speed.value !== rate) speed.value = rate;
    for (const option of find('beside-choice').options) {
      set(option, 'hidden', !['none', 'camera', ...beside].includes(option.value));
    }
    this.showCameras(camera, cameras);
    if (camera !== this.camera) {
      this.camera = camera;
      this.timeline.load();
    }
    if (first) {
      if (!this.followed) this.follow();  // Once: a link that was lost must not turn time back.
      this.followed = true;
      this.choose(this.beside);
    }
    this.showMoment();
  }

  showCameras(camera, cameras) {
    const list = find('cameras');
    set(list, 'hidden', cameras.length < 2);
    if (list.children.length !== cameras.length) {
      list.replaceChildren(...cameras.map((name) => {
        const button = document.createElement('button');
        button.type = 'button';
        button.textContent = name;
        button.addEventListener('click', () => this.command({ camera: name }));
        return button;
      }));
    }
    [...list.children].forEach((button, i) => button.setAttribute(
      'aria-pressed', String(cameras[i] === camera)));
  }

  // A picture is shown, recorded at this UNIX time.
  onPicture(picture) {
    if (picture.recorded === null) return;
    this.recorded = picture.recorded;
    if (Math.abs(this.recorded - this.status.span[0] - this.asked.at) < 1) this.asked.until = 0;
    this.picture = picture;
    this.showMoment();
    this.paintBeside();
  }

  showMoment() {
    if (!this.able) return;
    const share = this.length ? this.position / this.length : 0;
    const seek = find('seek');
    const value = String(Math.round(share * MOST_STEPS));
    if (seek.value !== value) seek.value = value;
    const time = `${clockTime(this.position)} of ${clockTime(this.length)}`;
    const words = this.timeline.show(share);
    seek.setAttribute('aria-valuetext', words ? `${time}, ${words}` : time);
    write('moment', time);
    if (this.standing) this.mark();
  }

  // The address of this page leads to the moment at which the bag stands.
  mark() {
    const hash = `#t=${this.position.toFixed(2)}`;
    if (location.hash !== hash) history.replaceState(null, '', hash);
  }

  // Go to the moment of the address, see W3C's Media Fragments.
  follow(hash = location.hash) {
    const found = /^#t=(\d+(?:\.\d+)?)$/.exec(hash);
    if (!found || !this.able || found[1] === this.position.toFixed(2)) return;
    this.command({ play: false });
    this.seek(+found[1]);
  }

  async copyLink() {
    history.replaceState(null, '', `#t=${this.position.toFixed(2)}`);
    try {
      await navigator.clipboard.writeText(location.href);
      this.say('Link copied.');
    } catch {
      this.say('The address of this page leads here.');
    }
  }

  choose(beside) {
    this.beside = beside;
    find('beside-choice').value = beside;
    this.ask({ beside: ['truth', 'cameras'].includes(beside) ? beside : '' });
    find('stage').classList.toggle('with-beside', beside !== 'none');
    set(find('beside'), 'hidden', beside === 'none');
    find('beside').setAttribute('aria-label', { truth: 'The truth at the same moment',
      cameras: 'The other cameras', camera: 'What the camera sees', none: 'Beside the picture' }[beside]);
    this.redraw();
    this.paintBeside();
  }

  paintBeside() {
    const { picture } = this;
    if (this.beside === 'none' || !picture) return;
    const canvas = find('beside');
    const { width, height } = this.beside === 'camera' || !picture.other ? picture.bitmap
      : picture.other;
    if (canvas.width !== width || canvas.height !== height) {
      [canvas.width, canvas.height] = [width, height];
    }
    const context = canvas.getContext('2d', { alpha: false });
    if (this.beside === 'camera') {
      paint(context, picture, 'camera', 1, 'known');
    } else if (picture.other && picture.beside === this.beside) {
      context.drawImage(picture.other, 0, 0);
      for (const { name, x, y, height: share } of picture.tiles ?? []) {
        const size = Math.max(11, Math.round(share * height / 14));
        context.font = `600 ${size}px system-ui, sans-serif`;
        context.lineWidth = 3;
        const at = [x * width + 6, y * height + size + 4];
        context.strokeText(name, ...at);
        context.fillStyle = '#fff';
        context.fillText(name, ...at);
      }
    } else {
      context.fillStyle = '#07090b';
      context.fillRect(0, 0, width, height);
      context.fillStyle = '#fff';
      context.font = `${Math.max(11, Math.round(height / 18))}px system-ui, sans-serif`;
      context.textAlign = 'center';
      context.fillText('none at this moment', width / 2, height / 2);
      context.textAlign = 'start';
    }
  }
}
