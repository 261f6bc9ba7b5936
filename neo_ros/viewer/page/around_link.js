// The second connection: the camera's place and looks in, directions and questions out.
import { openSocket, say, unpack } from './socket.js';

const RETRY_MS = 2000;

export class AroundLink {
  // `events`: onOpen(), onPlace(place), onLook(look), onDistance(distance), onFull(); `delay()`:
  // ms that a message takes.
  constructor(events, delay) {
    Object.assign(this, { events, delay });
    this.wanted = false;
    document.addEventListener('visibilitychange', () => (document.hidden ? this.drop()
      : this.connect()));
  }

  // The main connection is there, or lost.
  open() { this.wanted = true; this.connect(); }

  close() { this.wanted = false; this.drop(); }

  connect() {
    if (!this.wanted || document.hidden || this.socket) return;
    const socket = openSocket('/around', {
      hear: (message) => this.hear(message), receive: (buffer) => this.receive(socket, buffer) });
    this.socket = socket;
    this.newest = 0;  // Every connection counts anew.
    socket.onopen = () => this.events.onOpen();
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
    say(this.socket, message);
  }

  confirm(seq) {
    const delay = this.delay();
    this.send({ got: seq, ahead: Number.isFinite(delay) ? delay / 1000 : 0 });
  }

  hear(message) {
    if (message.type === 'place') {
      this.confirm(message.seq);
      this.events.onPlace(message);
    } else if (message.type === 'distance') {
      this.events.onDistance(message);
    } else {
      this.events.onFull();
    }
  }

  async receive(socket, buffer) {
    const { meta, image, more } = unpack(buffer);
    try {
      const [bitmap, kinds] = await Promise.all([createImageBitmap(image),
        createImageBitmap(more)]);
      if (this.socket !== socket) return;
      if (meta.seq > this.newest) {  // Decoding may overtake.
        this.newest = meta.seq;
        this.events.onLook({ ...meta, bitmap, kinds });
        this.events.onPlace(meta);
      } else {
        bitmap.close();
        kinds.close();
      }
    } catch {
      // What the browser cannot decode; without its confirmation no other would come.
    }
    this.confirm(meta.seq);
  }
}
