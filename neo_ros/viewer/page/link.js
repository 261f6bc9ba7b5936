// The connection to the server: pictures in, confirmations out, and the server's clock.
import { openSocket, say, unpack } from './socket.js';

const RETRY_MS = [250, 500, 1000, 2000, 5000];
const PING_MS = 2000;
// So many answers come before the first picture: behind pictures an answer would wait on a thin
// link, and everything would look younger than it is.
const ANSWERS_FIRST = 2;
// What two good clocks may have drifted apart from one answer to the next.
const DRIFT_MS = 0.2;
// The server tells its state twice a second: silence means that the link is dead.
const SILENCE_MS = 3000;
// How long the server may take to say whether the session still holds.
const CHECK_MS = 5000;
// Codes of the server's: no place left, and hidden for so long that the place is another's.
const FULL = 4001;
const ASLEEP = 4002;

export class Link {
  // `events`: onOpen(), onClosed('full', 'asleep' or 'lost'), onHello(hello), onStatus(status), onPicture(picture).
  constructor(events) {
    this.events = events;
    this.asked = { confidence: false, beside: '', paused: true };
    this.answers = 0;
    this.attempt = 0;
    this.thin = false;
    this.checking = false;
    this.offset = null;
    this.roundTrip = Infinity;
    document.addEventListener('visibilitychange', () => {
      if (document.hidden) {
        this.pauseOrGoOn();
      } else {
        this.measureAnew();
        this.retryNow();
      }
    });
    window.addEventListener('online', () => this.retryNow());
    setInterval(() => this.watch(), 500);
    setInterval(() => this.send({ ping: performance.now() }), PING_MS);
    this.connect();
  }

  // The server's clock in ms; only differences to what the server sends mean anything.
  now() {
    return performance.now() + (this.offset ?? 0);
  }

  // Ask for other things than before: { confidence: bool }, { beside: string } or { paused: bool }.
  ask(wanted) {
    Object.assign(this.asked, wanted);
    this.send(this.asked);
  }

  pauseOrGoOn() {
    this.ask({ paused: document.hidden || this.answers < ANSWERS_FIRST });
  }

  connect() {
    clearTimeout(this.retry);
    const socket = openSocket('/stream', {
      hear: (message) => this.hear(message), receive: (buffer) => this.receive(buffer) });
    this.socket = socket;
    this.heard = performance.now();
    socket.onclose = (event) => {
      const reasons = { [FULL]: 'full', [ASLEEP]: 'asleep' };
      if (this.socket === socket) this.lost(reasons[event.code] ?? 'lost');
    };
  }

  hear(message) {
    this.heard = performance.now();
    if (message.type === 'hello') {
      this.attempt = 0;
      if (this.thin) this.send({ thin: true });
      this.offset = message.now - performance.now();
      this.events.onOpen();
      this.events.onHello(message);
      this.measureAnew();
    } else if (message.type === 'pong') {
      this.setClock(message);
      this.answers += 1;
      if (this.answers < ANSWERS_FIRST) this.send({ ping: performance.now() });
      if (this.answers === ANSWERS_FIRST) {
        this.send({ round_trip: this.roundTrip });
        this.pauseOrGoOn();
      }
    } else {
      this.events.onStatus(message);
    }
  }

  // Ask for the server's clock before pictures come: it is not known, or the clock here may have
  // stood still while the page was hidden.
  measureAnew() {
    this.roundTrip = Infinity;
    this.answers = 0;
    this.pauseOrGoOn();
    this.send({ ping: performance.now() });
  }

  // The answer that took the shortest way tells the server's clock best; clocks drift, so that
  // an old best answer loses its worth, by as much as they may. Where two answers contradict one
  // another, the clock here stood still between them, as in a sleep, and the newer one is right.
  setClock({ ping, now }) {
    const roundTrip = performance.now() - ping;
    const offset = now + roundTrip / 2 - performance.now();
    this.roundTrip += DRIFT_MS;
    const fits = Math.abs(offset - this.offset) <= (roundTrip + this.roundTrip) / 2;
    if (roundTrip > this.roundTrip && fits) return;
    this.roundTrip = roundTrip;
    this.offset = offset;
  }

  async receive(buffer) {
    this.heard = performance.now();
    const { meta, ...blobs } = unpack(buffer);
    try {
      const [bitmap, sureness, other] = await Promise.all(
        [blobs.image, blobs.more, blobs.other].map((blob) => blob && createImageBitmap(blob)));
      this.events.onPicture({ ...meta, bitmap, sureness, other });
    } catch {
      // A picture that the browser cannot decode; without its confirmation no other would come.
    }
    this.send({ shown: meta.seq });
  }

  send(message) {
    say(this.socket, message);
  }

  watch() {
    const busy = this.socket.readyState <= WebSocket.OPEN;
    if (busy && !document.hidden && performance.now() - this.heard > SILENCE_MS) {
      const dead = this.socket;
      this.thin = true;  // A picture that takes so long looks the same: the next ones are smaller.
      this.lost('lost');
      dead.close();
    }
  }

  lost(reason) {
    this.socket.onclose = this.socket.onmessage = null;
    this.events.onClosed(reason);
    if (reason === 'asleep' && document.hidden) return;  // Goes on when the tab is seen.
    const wait = reason === 'full' ? RETRY_MS.at(-1) : RETRY_MS[Math.min(this.attempt, RETRY_MS.length - 1)];
    this.attempt += 1;
    this.retry = setTimeout(() => this.checkSession(), wait);
  }

  retryNow() {
    if (this.socket.readyState > WebSocket.OPEN) this.checkSession();
  }

  // A WebSocket does not tell why it is refused; a request for the page does.
  async checkSession() {
    clearTimeout(this.retry);
    if (this.checking) return;
    this.checking = true;
    try {
      const answer = await fetch('/viewer.js', {
        method: 'HEAD', redirect: 'manual', signal: AbortSignal.timeout(CHECK_MS) });
      if (answer.status === 401) {
        location.assign('/login');
        return;
      }
    } catch {
      this.lost('lost');
      return;
    } finally {
      this.checking = false;
    }
    this.connect();
  }
}
