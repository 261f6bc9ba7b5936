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

// Unpack two little-endian uint32, the lengths of the next two parts; a JSON object; a picture; a
// second one, which may be missing.
export function unpack(buffer) {
  const view = new DataView(buffer);
  const [about, first] = [view.getUint32(0, true), view.getUint32(4, true)];
  const [start, middle] = [8 + about, 8 + about + first];
  const meta = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 8, about)));
  return { meta, image: new Blob([new Uint8Array(buffer, start, first)]),
    more: buffer.byteLength > middle ? new Blob([new Uint8Array(buffer, middle)]) : null };
}
