// Nineteen further viewers in one page; returns how many pictures each got in two seconds.
async () => {
    const counts = Array(19).fill(0);
    window.sockets = counts.map((_, i) => {
        const socket = new WebSocket(`ws://${location.host}/stream`);
        socket.binaryType = 'arraybuffer';
        socket.onmessage = ({ data }) => {
            if (typeof data === 'string') return;
            const length = new DataView(data).getUint32(0, true);
            const meta = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 12, length)));
            socket.send(JSON.stringify({ shown: meta.seq }));
            counts[i] += 1;
        };
        return socket;
    });
    // Chromium opens one after the other, with pauses.
    await Promise.all(window.sockets.map((socket) => new Promise((done) => {
        socket.onopen = () => {
            socket.send(JSON.stringify({ paused: false }));
            done();
        };
    })));
    counts.fill(0);
    await new Promise((done) => setTimeout(done, 2000));
    return counts;
}
