// Before the page's own scripts: keeps when each picture arrives, and asks for the time 20 times
// as often, so that what the page would believe after a minute shows in seconds.
window.arrivals = [];
const Socket = window.WebSocket;
window.WebSocket = class extends Socket {
    constructor(...address) {
        super(...address);
        window.arrivals.length = 0;
        this.addEventListener('message', ({ data }) => {
            if (typeof data === 'string') return;
            const length = new DataView(data).getUint32(0, true);
            const meta = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 12, length)));
            window.arrivals.push(performance.timeOrigin + performance.now() - meta.captured);
        });
    }
};
const every = window.setInterval;
window.setInterval = (call, ms) => every(call, ms === 2000 ? 100 : ms);
