// Nodes, pens, and numbers as pictures.
import { rounds, share_of, short } from "./scales.js";

export const RED = "#d55e00", GREEN = "#009e73", BLUE = "#0072b2", BLACK = "#888";

/**
 * A new node in another.
 * @type {(tag: string, name: string, to: Element, more?: object) => HTMLElement}
 */
export const add = (tag, name, to, more = {}) => {
  const node = to.appendChild(document.createElement(tag));
  if (name) node.className = name;
  return Object.assign(node, more);
};

/**
 * Numbers or bytes that lie in a page, as base 64.
 * @type {(kind: "f4" | "u1", text: string) => Float32Array | Uint8Array}
 */
export function unpacked(kind, text) {
  const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  return kind === "f4" ? new Float32Array(bytes.buffer) : bytes;
}

let scratch; // one canvas for all maps: each is drawn from it at once

/** Bytes, or numbers of four, as a canvas. */
export function as_picture(rgba, width, height) {
  scratch ??= new OffscreenCanvas(1, 1);
  const { width: w, height: h } = scratch;
  if (w !== width || h !== height) Object.assign(scratch, { width, height });
  const bytes = new Uint8ClampedArray(rgba.buffer, rgba.byteOffset, rgba.byteLength);
  const pen = scratch.getContext("2d", { willReadFrequently: true });
  pen.putImageData(new ImageData(bytes, width, height), 0, 0);
  return scratch;
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
export function path(pen, xs, ys, at) {
  pen.beginPath();
  let down = false;
  for (let i = 0; i < xs.length; i++) {
    const known = Number.isFinite(xs[i]) && Number.isFinite(ys[i]);
    if (known) pen[down ? "lineTo" : "moveTo"](...at(xs[i], ys[i]));
    down = known;
  }
  pen.stroke();
}

/** The colours of a scale in a box [left, top, width, height], with round numbers beside them. */
export function draw_bar(pen, [left, top, wide, tall], scale, ink) {
  const { palette, low, high, log } = scale;
  if (!palette.strip) {
    palette.strip = new OffscreenCanvas(1, palette.length);
    const colours = new Uint8ClampedArray(palette.slice().reverse().buffer);
    palette.strip.getContext("2d").putImageData(new ImageData(colours, 1, palette.length), 0, 0);
  }
  pen.drawImage(palette.strip, left, top, wide, tall);
  Object.assign(pen, { fillStyle: ink, strokeStyle: ink, lineWidth: 1 });
  Object.assign(pen, { textAlign: "left", textBaseline: "middle" });
  pen.strokeRect(left, top, wide, tall);
  for (const value of rounds(low, high, Math.max(2, Math.floor(tall / 30)), log)) {
    pen.fillText(short(value), left + wide + 4, top + tall * (1 - share_of(scale, value)));
  }
}

/** The pen of a panel whose canvas is as fine as the screen and empty; and its size, px. */
export function pen_of({ canvas, wide, tall }) {
  const ratio = window.devicePixelRatio || 1;
  const size = [wide, tall].map((side) => Math.round(ratio * side));
  if (canvas.width !== size[0] || canvas.height !== size[1]) [canvas.width, canvas.height] = size;
  const pen = canvas.getContext("2d");
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.clearRect(0, 0, wide, tall);
  const font = "11px system-ui, 'DejaVu Sans', sans-serif";
  Object.assign(pen, { font, lineWidth: 1, imageSmoothingEnabled: false });
  return [pen, wide, tall];
}
