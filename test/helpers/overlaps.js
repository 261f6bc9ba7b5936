// Pairs of visible texts and controls of which one covers the other, and what is cut off.
() => {
    const seen = [];
    for (const element of document.querySelectorAll('body *')) {
        const own = [...element.childNodes].some((n) => n.nodeType === 3 && n.data.trim());
        const control = element.matches('button, input, canvas');
        if (!(own || control) || !element.checkVisibility()
            || element.closest('.hidden-text, .skip, dialog, noscript')) continue;
        const box = element.getBoundingClientRect();
        if (box.width && box.height) seen.push([element, box]);
    }
    const name = (element) => element.id || element.textContent.trim() || element.tagName;
    const found = [];
    seen.forEach(([one, a], i) => seen.slice(i + 1).forEach(([other, b]) => {
        if (one.contains(other) || other.contains(one)
            || one.parentElement.contains(other) && one.matches('fieldset input')) return;
        // The time line lies under its slider.
        if (one.id === 'timeline' && other.id === 'seek') return;
        // The sign over a stale picture is meant to cover it, and only it.
        if (one.matches('canvas') && other.closest('#stale-sign')) return;
        const width = Math.min(a.right, b.right) - Math.max(a.left, b.left);
        const height = Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top);
        if (width > 1 && height > 1) found.push(`${name(one)} / ${name(other)}`);
    }));
    for (const element of document.querySelectorAll('#stage, #stage dl, .panel')) {
        if (element.scrollWidth > element.clientWidth) found.push(`${name(element)} is cut`);
    }
    const sign = document.getElementById('stale-sign');
    if (!sign.hidden) {
        const box = sign.getBoundingClientRect();
        const top = document.elementFromPoint(box.x + box.width / 2, box.y + box.height / 2);
        if (!sign.contains(top)) found.push('the picture covers the sign');
    }
    const readings = document.querySelector('.readings').getBoundingClientRect();
    const stage = document.getElementById('stage').getBoundingClientRect();
    if (readings.bottom > stage.bottom + 1) found.push('the readings are cut');
    const canvas = document.getElementById('picture').getBoundingClientRect();
    if (canvas.height < 100) found.push(`the picture is ${canvas.height} high`);
    if (document.documentElement.scrollWidth > innerWidth) found.push('scrolls sideways');
    return found;
}
