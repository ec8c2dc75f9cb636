// Nodes, pens, and numbers as pictures.
import { rounds, share_of, short } from "./scales.js";

export const RED = "#d55e00", GREEN = "#009e73", BLUE = "#0072b2", BLACK = "#888";

/** A new node in another, and what it is given. @param {Element} to @param {object} [more] */
export const add = (tag, name, to, more = {}) =>
  to.appendChild(Object.assign(document.createElement(tag), name && { className: name }, more));

/** Numbers or bytes that lie in a page as base 64. @param {"f4" | "u1"} kind */
export function unpacked(kind, text) {
  const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  return kind === "f4" ? new Float32Array(bytes.buffer) : bytes;
}

/** A canvas of a size, px; one that has it keeps what is drawn. */
export function size_to(canvas, width, height) {
  const is_so = canvas.width === width && canvas.height === height;
  return is_so ? canvas : Object.assign(canvas, { width, height });
}

let scratch; // one canvas for all maps: each is drawn from it at once

/** Bytes, or numbers of four, as a canvas: that which all maps have, by default. */
export function as_picture(rgba, width, height, own = scratch ??= new OffscreenCanvas(1, 1)) {
  const bytes = new Uint8ClampedArray(rgba.buffer, rgba.byteOffset, rgba.byteLength);
  const canvas = size_to(own, width, height);
  const pen = canvas.getContext("2d", { willReadFrequently: true });
  pen.putImageData(new ImageData(bytes, width, height), 0, 0);
  return canvas;
}

/** Numbers in the colours of a palette, as a canvas. */
export function coloured(values, { palette, low, high, log }, width, height) {
  const to = new Uint32Array(values.length), last = palette.length - 1;
  const from = log ? Math.log(low) : low;
  const scale = palette.length / ((log ? Math.log(high) : high) - from);
  for (let p = 0; p < values.length; p++) {
    const value = values[p], place = ((log ? Math.log(value) : value) - from) * scale | 0;
    if (value === value) to[p] = palette[Math.max(0, Math.min(last, place))];
  }
  return as_picture(to, width, height);
}

/** A line through points, with gaps where one is no number; `at` tells where they lie. */
export function path(pen, xs, ys, at = (x, y) => [x, y]) {
  pen.beginPath();
  let down = false;
  for (let i = 0; i < xs.length; i++) {
    const known = Number.isFinite(xs[i]) && Number.isFinite(ys[i]);
    if (known) pen[down ? "lineTo" : "moveTo"](...at(xs[i], ys[i]));
    down = known;
  }
  pen.stroke();
}

/** Nothing is drawn outside a box until the pen is restored. */
export function clip(pen, ...box) {
  pen.save();
  pen.beginPath();
  pen.rect(...box);
  pen.clip();
}

/** Words at a place, in a colour. */
export function write(pen, text, x, y, fillStyle, textAlign = "left", textBaseline = "top") {
  Object.assign(pen, { fillStyle, textAlign, textBaseline });
  pen.fillText(text, x, y);
}

/** The colours of a scale in a box [left, top, width, height], with round numbers beside them. */
export function draw_bar(pen, [left, top, wide, tall], scale, ink) {
  const { palette, low, high, log } = scale, colours = palette.slice().reverse();
  palette.strip ??= as_picture(colours, 1, colours.length, new OffscreenCanvas(1, 1));
  pen.drawImage(palette.strip, left, top, wide, tall);
  Object.assign(pen, { strokeStyle: ink, lineWidth: 1 });
  pen.strokeRect(left, top, wide, tall);
  for (const value of rounds(low, high, Math.max(2, Math.floor(tall / 30)), log)) {
    const y = top + tall * (1 - share_of(scale, value));
    write(pen, short(value), left + wide + 4, y, ink, "left", "middle");
  }
}

/** The pen of a panel whose canvas is as fine as the screen and empty. */
export function pen_of({ canvas, wide, tall }) {
  const ratio = devicePixelRatio, font = "11px system-ui, 'DejaVu Sans', sans-serif";
  const pen = size_to(canvas, Math.round(ratio * wide), Math.round(ratio * tall)).getContext("2d");
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.clearRect(0, 0, wide, tall);
  return Object.assign(pen, { font, lineWidth: 1, imageSmoothingEnabled: false });
}
