// The page: shows the pictures, and says plainly how much they can be trusted.
import { Around } from './around.js';
import { find, set, write } from './elements.js';
import { Link } from './link.js';
import { Player } from './player.js';
import { paint, snapshot, tintOf } from './picture.js';
import { bagTime, complaint, EXPLANATIONS, explanation, judge, plays, seconds } from './words.js';

const RATE_WINDOW_MS = 2000;
const TICK_MS = 100;
const READINGS_EVERY_MS = 500;
// A state that lasts shorter is not worth a screen reader's interruption.
const ANNOUNCE_AFTER_MS = 1500;
// What is said of single images would flicker: a place counts as recognised after so long.
const RECOGNISED_AFTER_MS = 500;

const stage = find('stage');
const canvas = find('picture');
const context = canvas.getContext('2d', { alpha: false });
const state = {
  picture: null, newest: 0, status: {}, connected: false, closed: 'lost', staleMs: 800,
  way: 'outline', shown: [], latencies: [], nextReadings: 0, pending: '', since: 0, announced: '',
  verdict: '', unknownUntil: 0,
};

const link = new Link({
  onOpen() { state.connected = true; around.open(); },
  onClosed(reason) { around.close(); state.connected = false; state.closed = reason; tick(); },
  onHello(hello) { state.staleMs = hello.stale_ms; state.newest = 0; state.fresh = true; },
  onStatus(status) {
    state.status = status;
    player.update(status, state.fresh);
    if (player.able) state.fresh = false;  // The source may not have opened its bag yet.
    showStatus();
  },
  onPicture(picture) { showPicture(picture); },
});

const around = new Around({
  now: () => link.now(), delay: () => link.roundTrip / 2, redraw: () => draw(),
  standing: () => player.standing,
});

const player = new Player({
  ask: (wanted) => (wanted.player ? link.send(wanted) : link.ask(wanted)), redraw: () => draw(),
  say: (words) => write('announcer', words),
});

function showPicture(picture) {
  if (picture.seq < state.newest) {  // Decoding may overtake.
    picture.bitmap.close();
    picture.sureness?.close();
    picture.other?.close();
    return;
  }
  state.newest = picture.seq;
  state.picture?.bitmap.close();
  state.picture?.other?.close();
  state.picture = picture;
  picture.tint = picture.sureness && tintOf(picture.sureness);
  picture.sureness?.close();
  draw();
  around.onPicture(picture.captured);
  player.onPicture(picture);
  const now = performance.now();
  state.shown.push(now);
  state.latencies.push(link.now() - picture.captured);
  if (state.latencies.length > 20) state.latencies.shift();
  tick();
}

function draw() {
  const { picture } = state;
  if (!picture) return;
  const { width, height } = picture.bitmap;
  stage.style.setProperty('--ratio', `${width} / ${height}`);
  // As many pixels as the screen shows, so that the lines are crisp.
  const box = canvas.getBoundingClientRect();
  const fit = Math.min(box.width / width, box.height / height) || 1;
  const zoom = Math.max(1, fit * devicePixelRatio);
  const [w, h] = [Math.round(width * zoom), Math.round(height * zoom)];
  if (canvas.width !== w || canvas.height !== h) [canvas.width, canvas.height] = [w, h];
  paint(context, picture, state.way, zoom / fit, trust());
}

// How old the picture on the screen is, ms; null without one.
function age() {
  return state.picture ? link.now() - state.picture.captured : null;
}

// How far what lies outside of the camera's frame can be trusted; see paint().
function trust() {
  if (state.status.out_of_scene) return 'none';
  return performance.now() < state.unknownUntil ? 'rough' : 'known';
}

function tick() {
  const verdict = judge(state, age());
  const bad = !plays(verdict);
  stage.classList.toggle('old', bad);
  set(find('stale-sign'), 'hidden', !bad);
  write('stale-title', state.picture && verdict.name !== 'stale' ? `Stale · ${verdict.title}`
    : verdict.title);
  write('stale-text', verdict.text);
  write('connection', verdict.title);
  find('connection').dataset.state = verdict.name;
  document.title = verdict.name === 'live' ? 'Wide view' : `${verdict.title} · Wide view`;
  showTrust();
  showReadings(verdict);
  announce(verdict);
  around.tick();
}

function showTrust() {
  if (state.status.recognised === false) {
    state.unknownUntil = performance.now() + RECOGNISED_AFTER_MS;
  }
  const known = trust();
  if (known === state.trust) return;
  state.trust = known;
  set(find('scene-sign'), 'hidden', known !== 'none');
  set(find('place-sign'), 'hidden', known !== 'rough');
  stage.classList.toggle('alarm', known === 'none');
  explain();
  draw();
}

function showReadings(verdict) {
  const now = performance.now();
  const old = age();
  // No age of before may stand beside another verdict.
  if (now < state.nextReadings && plays(verdict) && verdict.name === state.verdict) return;
  state.verdict = verdict.name;
  state.nextReadings = now + READINGS_EVERY_MS;
  state.shown = state.shown.filter((time) => time > now - RATE_WINDOW_MS);
  write('age', old === null || player.standing ? '–' : seconds(Math.max(old, 0)));
  const rate = state.shown.length / (RATE_WINDOW_MS / 1000);
  const offered = state.status.rate ?? 0;
  write('rate', player.standing ? '–' : offered > 1.25 * rate + 1 ? `${rate.toFixed(1)} of ${offered.toFixed(1)} /s`
    : `${rate.toFixed(1)} /s`);
  const sorted = [...state.latencies].sort((a, b) => a - b);
  const median = sorted[sorted.length >> 1];
  write('latency', median === undefined || player.standing ? '–'
    : `${Math.max(median, 0).toFixed(0)} ms${state.picture?.timed ? '' : ' (link)'}`);
  write('bag-time', bagTime(state));
}

function showStatus() {
  const { status } = state;
  write('source', status.name);
  write('viewers', String(status.viewers));
  write('node-latency', status.node_ms === null ? '–' : `${status.node_ms.toFixed(0)} ms`);
  if (state.picture) {
    const { bitmap, small } = state.picture;
    write('size', `${bitmap.width} × ${bitmap.height}`
      + (small ? ' (thin link: smaller picture)' : ''));
  }
  set(find('bag-time-reading'), 'hidden', !status.span || player.able);
  stage.setAttribute('aria-label', status.span ? 'Recorded picture' : 'Live picture');
  canvas.setAttribute('aria-label', `${status.span ? 'Recorded' : 'Live'} picture of the robot's `
    + 'camera, widened');
  const notice = find('notice');
  set(notice, 'hidden', status.level === 0);
  notice.dataset.level = status.level;
  write('notice', complaint(state.status));
  tick();
}

// The signs above the picture, as one would say them.
function signs() {
  const words = { none: 'Not in the trained scene.', rough: 'Place not recognised: rough guess.' };
  return [words[trust()], complaint(state.status)].filter(Boolean).join(' ');
}

function explain() {
  write('explanation', explanation(state, trust()));
  set(find('scale'), 'hidden', state.way !== 'confidence');
}

// Tell a screen reader what changed, once it has lasted, and never the numbers.
function announce(verdict) {
  const waiting = verdict.name === 'waiting' ? `${state.status.waiting}.` : '';
  const words = [`${verdict.title}.`, waiting, signs()].filter(Boolean).join(' ');
  const now = performance.now();
  if (words !== state.pending) [state.pending, state.since] = [words, now];
  if (words !== state.announced && now - state.since > ANNOUNCE_AFTER_MS) {
    state.announced = words;
    write('announcer', words);
  }
}

function readAloud() {
  const verdict = judge(state, age());
  const time = state.status.span ? `, recorded ${bagTime(state)}` : '';
  const words = `${verdict.title}. ${verdict.text} ${signs()} Rate ${find('rate').textContent}, `
    + `latency ${find('latency').textContent}${time}. ${explanation(state, trust())}`;
  find('announcer').textContent = '';
  setTimeout(() => { find('announcer').textContent = words; }, 50);
}

function choose(way) {
  state.way = way;
  document.querySelector(`input[name=way][value=${way}]`).checked = true;
  remember('way', way);
  around.setWay(way);
  link.ask({ confidence: way === 'confidence' });
  explain();
  draw();
}

async function saveSnapshot() {
  const { picture } = state;
  if (!picture) return;
  const taken = new Date(picture.recorded === null
    ? Date.now() - (link.now() - picture.captured) : 1e3 * picture.recorded);
  const verdict = judge(state, age());
  const lines = [
    `${state.status.name ?? ''}  ${taken.toLocaleString()}`
      + (verdict.name === 'live' ? '' : `  (${verdict.title})`)
      + (state.status.span ? `  ${bagTime(state)}` : ''),
    explanation(state, trust()) + (trust() === 'none' ? ' NOT IN THE TRAINED SCENE.' : '')
      + (trust() === 'rough' ? ' PLACE NOT RECOGNISED.' : ''),
  ];
  const url = URL.createObjectURL(await snapshot(picture, state.way, lines, trust()));
  const anchor = document.createElement('a');
  anchor.href = url;
  anchor.download = `wide_${taken.toISOString().replace(/[:.]/g, '-')}.png`;
  anchor.click();
  setTimeout(() => URL.revokeObjectURL(url), 10000);
  write('announcer', 'Snapshot saved.');
}

function toggleFullScreen() {
  if (document.fullscreenElement) document.exitFullscreen();
  else stage.requestFullscreen();
}

function remember(name, value) {
  try { localStorage.setItem(`viewer ${name}`, value); } catch { /* private window */ }
}

function recall(name) {
  try { return localStorage.getItem(`viewer ${name}`); } catch { return null; }
}

const KEYS = {
  1: () => choose('outline'), 2: () => choose('dim'), 3: () => choose('confidence'),
  4: () => choose('camera'), s: saveSnapshot, f: toggleFullScreen, r: readAloud,
  '?': () => find('keys').showModal(),
};

document.addEventListener('keydown', (event) => {
  if (event.ctrlKey || event.altKey || event.metaKey || event.repeat || find('keys').open
      || (!find('keys-on').checked && event.key !== '?')) return;
  const action = KEYS[event.key.toLowerCase()];
  if (action) {
    event.preventDefault();
    action();
  }
});
for (const input of document.querySelectorAll('input[name=way]')) {
  input.addEventListener('change', () => choose(input.value));
}
find('snapshot').addEventListener('click', saveSnapshot);
find('help').addEventListener('click', () => find('keys').showModal());
find('keys-on').addEventListener('change', () => remember('keys', find('keys-on').checked));
find('full-screen').addEventListener('click', toggleFullScreen);
find('full-screen').hidden = !stage.requestFullscreen;
document.addEventListener('fullscreenchange', () => {
  find('full-screen').setAttribute('aria-pressed', String(Boolean(document.fullscreenElement)));
  draw();
});
new ResizeObserver(draw).observe(stage);

find('keys-on').checked = recall('keys') !== 'false';
choose(recall('way') in EXPLANATIONS ? recall('way') : 'outline');
setInterval(tick, TICK_MS);
