// Maps: numbers in colours with a scale, or a picture; with lines of round distances.
import { as_picture, coloured, draw_bar, GREEN, path, pen_of, RED } from "./drawing.js";
import { ends_of, percentile, rounds, short } from "./scales.js";
import { covered, is_wiped, line_of, seen, spot } from "./sight.js";
import { COMPARED } from "./store.js";

/**
 * @typedef {{values?: Float32Array, picture?: Uint8Array, empty?: string, title?: string,
 *   keys?: [string, number[]][], unit?: string, palette?: Uint32Array, low?: number,
 *   high?: number, log?: boolean}} PanelMap  numbers and their colours, a picture, or why none is
 */

// Where colours end is held until all is asked anew; of B / A - 1, while the hand moves.
function scaled({ now, facts, palettes }, name, more) {
  const { palette, kind, unit } = facts.scales[name] ?? facts.scales.error;
  if (!now.held[name] || (name === COMPARED && !now.moving)) {
    now.held[name] = ends_of(kind, more.values);
  }
  const [low, high] = now.held[name], scale = { palette: palettes[palette], low, high };
  return { unit: unit ?? now.still.unit, ...scale, log: kind === "log", ...more };
}

/**
 * What a map shows, of these arrays.
 * @type {(store: Store, name: string, arrays?: object) => PanelMap}
 */
export function map_of(store, name, arrays = store.now.arrays) {
  const { now, kept, facts } = store, { truth, distance } = arrays, spec = now.maps[name];
  if (name === "frame") return { picture: arrays.picture };
  if (name === "error") {
    if (!truth?.length) return { empty: "the truth is unknown" };
    const values = distance.map((far, p) => 100 * (far / truth[p] - 1));
    const middle = short(percentile(values.map(Math.abs), 0.5), 2);
    return scaled(store, name, { values, title: `of the distance [%], median ${middle}` });
  }
  if (name === COMPARED) {
    if (!kept) return { empty: "keep an answer as A first" };
    const ratio = distance.map((far, p) => far / kept.arrays.distance[p]);
    const common = now.still.metric ? 1 : percentile(ratio, 0.5);
    const values = ratio.map((one) => 100 * (one / common - 1));
    return scaled(store, name, { values, title: `[%], A: ${kept.label}` });
  }
  const values = arrays[name];
  if (!spec || spec.empty || !values) return { empty: spec?.empty ?? "with the next answer" };
  if (facts.scales[name]) return scaled(store, name, { ...spec, values });
  return { ...spec, picture: values };
}

/** Its canvas. @param {PanelMap} map */
export const canvas_of = (map, { width, height }) =>
  (map.picture ? as_picture(map.picture, width, height) : coloured(map.values, map, width, height));

/**
 * Lines where a map crosses levels, as pairs of points, in pixels of the map; of every pixel, or of
 * every second one.
 * @returns {number[]}
 */
export function isolines(map, width, height, levels, step) {
  const lines = [];
  for (let i = 0; i < height - step; i += step) for (let j = 0; j < width - step; j += step) {
    const at = i * width + j, under = at + step * width;
    const a = map[at], b = map[at + step], c = map[under], d = map[under + step];
    const low = Math.min(a, b, c, d), high = Math.max(a, b, c, d);
    if (!(high < 1.15 * low)) continue; // nan, or a fold
    for (let k = 0; levels[k] <= high; k++) {
      const level = levels[k];
      if (level <= low) continue;
      const cross = (p, q, x, y, right, down) => { // on the side from pixel p to pixel q
        if ((p < level) === (q < level)) return;
        const share = step * (level - p) / (q - p);
        lines.push(x + 0.5 + share * right, y + 0.5 + share * down);
      };
      cross(a, b, j, i, 1, 0);
      cross(a, c, j, i, 0, 1);
      cross(b, d, j + step, i, 0, 1);
      cross(c, d, j, i + step, 1, 0);
      lines.length -= lines.length % 4; // of a saddle only whole lines
    }
  }
  return lines;
}

// What is A, up to the wipe, in B's colours.
function draw_kept(store, name, pen, { low, high }, [left, top, scale]) {
  const [x, y, w, h] = seen(store), share = store.wipe * w, end = left + scale * share;
  const before = { ...map_of(store, name, store.kept.arrays), low, high };
  if (before.empty) return; // it was not asked for
  const canvas = canvas_of(before, store.now.still);
  pen.drawImage(canvas, x, y, share, h, left, top, scale * share, scale * h);
  Object.assign(pen, { strokeStyle: GREEN, fillStyle: GREEN, lineWidth: 2 });
  Object.assign(pen, { textBaseline: "top", textAlign: "center" });
  pen.strokeRect(end, top, 0, scale * h);
  pen.fillRect(end - 16, top, 32, 15);
  pen.fillStyle = "white";
  pen.fillText("A   B", end, top + 2);
}

// Rectangles [left, top, width, height] that are left out.
function hatch(pen, rectangles) {
  pen.save();
  pen.beginPath();
  for (const one of rectangles) pen.rect(...one);
  pen.clip();
  Object.assign(pen, { strokeStyle: "#fffc", lineWidth: 1 });
  pen.beginPath();
  for (const [left, top, wide, tall] of rectangles) {
    for (let x = left - tall; x < left + wide; x += 8) {
      pen.moveTo(x, top + tall);
      pen.lineTo(x + tall, top);
    }
  }
  pen.stroke();
  pen.restore();
}

function draw_keys(pen, keys) {
  keys.forEach(([text, colour], i) => {
    Object.assign(pen, { fillStyle: "#000a", textBaseline: "top", textAlign: "left" });
    pen.fillRect(0, 16 * i, pen.measureText(text).width + 24, 16);
    pen.fillStyle = `rgb(${colour})`;
    pen.fillRect(4, 3 + 16 * i, 10, 10);
    pen.fillStyle = "white";
    pen.fillText(text, 18, 3 + 16 * i);
  });
}

/** Draws a map into its panel. */
export function draw_map(store, panel, { ink }) {
  const { now, cut, corner, cursor } = store, { width, height } = now.still;
  const { name } = panel, [pen, wide, tall] = pen_of(panel), map = panel.map = map_of(store, name);
  panel.title.textContent = map.title ?? map.empty ?? "";
  if (map.empty) return;
  const [left, top, scale] = spot(store, panel), [x, y, w, h] = seen(store);
  const at = (u, v) => [left + scale * (u - x), top + scale * (v - y)];
  pen.drawImage(canvas_of(map, now.still), x, y, w, h, left, top, scale * w, scale * h);
  if (is_wiped(store, name)) draw_kept(store, name, pen, map, [left, top, scale]);
  pen.save();
  pen.beginPath();
  pen.rect(left, top, scale * w, scale * h);
  pen.clip();
  if (name === "distance") {
    const levels = rounds(map.low, map.high, 12, true);
    const lines = isolines(map.values, width, height, levels, now.moving ? 2 : 1);
    Object.assign(pen, { strokeStyle: "#fffb", lineWidth: 1 });
    pen.beginPath();
    for (let i = 0; i < lines.length; i += 4) {
      pen.moveTo(...at(lines[i], lines[i + 1]));
      pen.lineTo(...at(lines[i + 2], lines[i + 3]));
    }
    pen.stroke();
  }
  if (name === "frame") hatch(pen, (now.asked?.left_out ?? []).map(([l, t, r, b]) =>
    [...at(l * width, t * height), scale * (r - l) * width, scale * (b - t) * height]));
  if (["frame", "distance"].includes(name)) {
    const across = [line_of(store) + 0.5, line_of(store) + 0.5];
    Object.assign(pen, { strokeStyle: RED, lineWidth: 1.5 });
    path(pen, ...(cut.is_row ? [[0, width], across] : [across, [0, height]]), at);
  }
  if (corner && cursor) {
    const [l, t, r, b] = covered(store);
    Object.assign(pen, { strokeStyle: GREEN, lineWidth: 2 });
    pen.strokeRect(...at(l, t), scale * (r - l), scale * (b - t));
  }
  pen.restore();
  if (map.values) draw_bar(pen, [wide - 50, 8, 10, tall - 16], map, ink);
  draw_keys(pen, map.keys ?? []);
}
