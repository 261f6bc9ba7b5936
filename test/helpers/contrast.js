// The contrast of every visible text with what lies behind it (WCAG 2.2, 1.4.3), by element.
// A translucent ground lies on white or black, whichever is worse.
() => {
    const parse = (text) => {
        const [r, g, b, a = 1] = text.match(/[\d.]+/g).map(Number);
        return [r, g, b, a];
    };
    const light = (rgb) => rgb.slice(0, 3).map((v) => v / 255).map(
        (v) => v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4
    ).reduce((sum, v, i) => sum + v * [0.2126, 0.7152, 0.0722][i], 0);
    const over = (top, below) => [0, 1, 2].map((i) => top[i] * top[3] + below[i] * (1 - top[3]));
    const worst = {};
    for (const element of document.querySelectorAll('body *')) {
        const own = [...element.childNodes].some((n) => n.nodeType === 3 && n.data.trim());
        if (!own || !element.checkVisibility() || element.closest('.hidden-text, .skip')) continue;
        const layers = [];
        for (let e = element; e; e = e.parentElement) {
            const ground = parse(getComputedStyle(e).backgroundColor);
            if (ground[3] > 0) layers.unshift(ground);
            if (ground[3] === 1) break;
            if (e.id === 'stage') break;
        }
        const text = parse(getComputedStyle(element).color);
        const ratios = [[255, 255, 255], [0, 0, 0]].map((base) => {
            const ground = light(layers.reduce((below, top) => over(top, below), base));
            const ink = light(text);
            return (Math.max(ground, ink) + 0.05) / (Math.min(ground, ink) + 0.05);
        });
        const name = element.tagName + (element.id && '#' + element.id);
        worst[name] = Math.min(worst[name] ?? 99, ...ratios);
    }
    return worst;
}
