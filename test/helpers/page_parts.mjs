// Parts of the page without a browser: node page_parts.mjs FOLDER OF THE PAGE, NAME OF THE TEST.
import assert from 'node:assert/strict';
import { pathToFileURL } from 'node:url';

const [folder, name] = process.argv.slice(2);
const load = (file) => import(pathToFileURL(`${folder}/${file}`));
let here = 5000;  // What performance.now() says.
Object.defineProperty(globalThis, 'performance', { value: { now: () => here } });
const heard = {};
globalThis.document = { hidden: false, addEventListener: (kind, call) => { heard[kind] = call; } };
globalThis.window = { addEventListener() {} };
globalThis.location = { protocol: 'http:', host: 'robot' };
globalThis.setInterval = () => 0;

// A connection whose server's clock is `ahead` ms ahead of the page's.
async function connected(ahead) {
  const said = [];
  globalThis.WebSocket = class {
    static OPEN = 1;
    readyState = 1;
    send(text) { said.push(JSON.parse(text)); }
    close() {}
  };
  const { Link } = await load('link.js');
  const link = new Link({ onOpen() {}, onClosed() {}, onHello() {}, onStatus() {}, onPicture() {} });
  const server = { ahead };
  const hear = (message) => link.socket.onmessage({ data: JSON.stringify(message) });
  // Let a ping take `there` ms there and `back` ms back.
  const pong = (there, back) => {
    const ping = here;
    here += there;
    const now = here + server.ahead;
    here += back;
    hear({ type: 'pong', ping, now });
  };
  hear({ type: 'hello', now: here + ahead });
  return { link, server, pong, said, error: () => link.now() - (here + server.ahead) };
}

const tests = {
  async clock() {
    const { clockTime } = await load('words.js');
    assert.deepEqual([0, 4.5, 59.94, 59.96, 60, 125.25, 3599.97].map(clockTime), [
      '0:00.0', '0:04.5', '0:59.9', '1:00.0', '1:00.0', '2:05.3', '60:00.0']);
  },

  async shortest() {
    const { pong, error } = await connected(1000);
    pong(5, 5);
    pong(0, 80);
    assert.equal(error(), 0, 'a long way tells nothing new');
  },
  async sleep() {
    const { server, pong, error } = await connected(1000);
    pong(5, 5);
    server.ahead += 30_000;  // The phone slept; its clock stood still.
    pong(0, 80);
    assert.ok(Math.abs(error()) <= 40, `off by ${error()} ms`);
  },
  async seen() {
    const { link, server, pong, said, error } = await connected(1000);
    pong(5, 5);
    pong(5, 5);
    assert.equal(link.asked.paused, false);
    document.hidden = true;
    heard.visibilitychange();
    server.ahead += 30;  // Less than a slow answer could tell.
    document.hidden = false;
    said.length = 0;
    heard.visibilitychange();
    assert.deepEqual(said.map((message) => [message.paused, 'ping' in message]),
      [[true, false], [undefined, true]]);
    pong(30, 30);
    pong(30, 30);
    assert.equal(error(), 0);
    assert.equal(link.asked.paused, false);
  },
  async loads() {
    globalThis.ResizeObserver = class { observe() {} };
    const waiting = [];
    const planned = [];
    globalThis.setTimeout = (call) => planned.push(call);
    globalThis.clearTimeout = () => {};
    globalThis.fetch = () => new Promise((answer) => {
      waiting.push((known) => answer({ ok: true, json: async () => known }));
    });
    const { Timeline } = await load('timeline.js');
    const canvas = { getBoundingClientRect: () => ({ width: 0 }) };
    let changes = 0;
    const timeline = new Timeline(canvas, () => { changes += 1; });
    const both = [timeline.load(), timeline.load()];
    waiting[1]({ of: 'the new camera', done: false });
    await both[1];
    waiting[0]({ of: 'the old camera', done: false });
    await both[0];
    assert.equal(timeline.known.of, 'the new camera');
    assert.deepEqual([planned.length, changes], [1, 1]);
  },
  async silence() {
    const { link, said } = await connected(1000);
    assert.ok(!said.some((message) => message.thin), 'a good link needs no small pictures');
    let retry = null;
    globalThis.setTimeout = (call) => { retry = call; };
    globalThis.fetch = async () => ({ status: 200 });
    here += 4000;
    link.watch();
    await retry();
    said.length = 0;
    link.socket.onmessage({ data: JSON.stringify({ type: 'hello', now: here }) });
    assert.deepEqual(said[0], { thin: true });
  },
  async overtaken() {
    const decoded = [];
    const closed = [];
    globalThis.createImageBitmap = () => new Promise((made) => {
      decoded.push(() => made({ close: () => closed.push(1) }));
    });
    globalThis.WebSocket = class { static OPEN = 1; readyState = 1; send() {} };
    const { AroundLink } = await load('around_link.js');
    const places = [];
    const looks = [];
    const around = new AroundLink({ onLook: (look) => looks.push(look.seq),
      onPlace: (place) => places.push(place.seq) }, () => 0);
    around.open();
    const message = (seq) => {
      const about = new TextEncoder().encode(JSON.stringify({ seq }));
      const buffer = new ArrayBuffer(12 + about.length + 2);
      const view = new DataView(buffer);
      [about.length, 1, 1].forEach((length, at) => view.setUint32(4 * at, length, true));
      new Uint8Array(buffer).set(about, 12);
      return around.receive(around.socket, buffer);
    };
    const both = [message(1), message(2)];
    decoded.reverse().forEach((make) => make());
    await Promise.all(both.reverse());
    assert.deepEqual([looks, places, closed.length], [[2], [2], 2]);
  },
};
await tests[name]();
