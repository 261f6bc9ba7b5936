// What both connections to the server share: how they are opened, and how messages are packed.

// Text goes to `hear` as an object, the rest to `receive` as an ArrayBuffer.
export function openSocket(path, { hear, receive }) {
  const scheme = location.protocol === 'https:' ? 'wss' : 'ws';
  const socket = new WebSocket(`${scheme}://${location.host}${path}`);
  socket.binaryType = 'arraybuffer';
  socket.onmessage = ({ data }) => (typeof data === 'string' ? hear(JSON.parse(data))
    : receive(data));
  return socket;
}

// Say something, unless there is nobody to hear it.
export function say(socket, message) {
  if (socket?.readyState === WebSocket.OPEN) socket.send(JSON.stringify(message));
}

// Unpack three little-endian uint32, the lengths of the next three parts; a JSON object; a picture;
// a second and a third one, which may be missing.
export function unpack(buffer) {
  const view = new DataView(buffer);
  const [about, first, second] = [0, 4, 8].map((at) => view.getUint32(at, true));
  const [start, middle, last] = [12 + about, 12 + about + first, 12 + about + first + second];
  const meta = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 12, about)));
  const blob = (at, length) => (length ? new Blob([new Uint8Array(buffer, at, length)]) : null);
  return { meta, image: blob(start, first), more: blob(middle, second),
    other: blob(last, buffer.byteLength - last) };
}
