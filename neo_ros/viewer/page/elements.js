// Elements of the page, written only where something changes.
export const find = (id) => document.getElementById(id);

export function write(id, text) {
  const element = find(id);
  if (element.textContent !== (text ?? '')) element.textContent = text ?? '';
}

export function set(element, property, value) {
  if (element[property] !== value) element[property] = value;
}

// Left, top, width and height on the page of what a canvas shows; the rest of its box is empty.
export function contentOf(canvas) {
  const box = canvas.getBoundingClientRect();
  const fit = Math.min(box.width / canvas.width, box.height / canvas.height);
  const [width, height] = [canvas.width * fit, canvas.height * fit];
  return [box.left + (box.width - width) / 2, box.top + (box.height - height) / 2, width, height];
}
