// Maps: numbers in colours with a scale, or a picture; with lines of round distances.
import { as_picture, clip, coloured, draw_bar, path, pen_of, write } from "./drawing.js";
import { GREEN, RED } from "./drawing.js";
import { ends_of, percentile, rounds, short } from "./scales.js";
import { covered, is_wiped, line_of, spot } from "./sight.js";
import { COMPARED } from "./store.js";

/** @typedef {object} PanelMap  `values` and their colours, a `picture`, or why it is `empty` */

// Where colours end is held until all is asked anew; of B / A - 1, in looks.
function scaled({ now, facts }, name, values, more) {
  const { palette, kind, unit } = facts.scales[name] ?? facts.scales.error;
  if (name === COMPARED && !now.moving) delete now.held[name];
  const [low, high] = now.held[name] ??= ends_of(kind, values);
  const scale = { palette: facts.palettes[palette], low, high, log: kind === "log" };
  return { unit: unit ?? now.still.unit, ...scale, values, ...more };
}

/** What it shows. @type {(store: Store, name: string, arrays?: object) => PanelMap} */
export function map_of(store, name, arrays = store.now.arrays) {
  const { now, kept, facts } = store, { truth, distance } = arrays, spec = now.maps[name];
  if (name === "frame") return { picture: arrays.picture };
  if (name === "error") {
    if (!truth?.length) return { empty: "the truth is unknown" };
    const values = distance.map((far, p) => 100 * (far / truth[p] - 1));
    const middle = short(percentile(values.map(Math.abs), 0.5), 2);
    return scaled(store, name, values, { title: `of the distance [%], median ${middle}` });
  }
  if (name === COMPARED) {
    if (!kept) return { empty: "keep an answer as A first" };
    const ratio = distance.map((far, p) => far / kept.arrays.distance[p]);
    const common = now.still.metric ? 1 : percentile(ratio, 0.5);
    const values = ratio.map((one) => 100 * (one / common - 1));
    return scaled(store, name, values, { title: `[%], A: ${kept.label}` });
  }
  const values = arrays[name];
  if (!spec || spec.empty || !values) return { empty: spec?.empty ?? "with the next answer" };
  return facts.scales[name] ? scaled(store, name, values, spec) : { ...spec, picture: values };
}

/** Its canvas. @param {PanelMap} map */
export const canvas_of = (map, { width, height }) =>
  (map.picture ? as_picture(map.picture, width, height) : coloured(map.values, map, width, height));

// Lines where a map crosses levels, in its pixels; of each of them, or of every second one.
function draw_isolines(pen, map, { width, height }, levels, step) {
  pen.beginPath();
  for (let i = 0; i < height - step; i += step) for (let j = 0; j < width - step; j += step) {
    const at = i * width + j, under = at + step * width;
    const a = map[at], b = map[at + step], c = map[under], d = map[under + step];
    const low = Math.min(a, b, c, d), high = Math.max(a, b, c, d);
    if (!(high < 1.15 * low)) continue; // nan, or a fold
    for (let k = 0; levels[k] <= high; k++) {
      const level = levels[k];
      if (level <= low) continue;
      let goes_on = false;
      const cross = (p, q, x, y, right, down) => { // on the side from pixel p to pixel q
        if ((p < level) === (q < level)) return;
        const share = step * (level - p) / (q - p);
        pen[goes_on ? "lineTo" : "moveTo"](x + 0.5 + share * right, y + 0.5 + share * down);
        goes_on = !goes_on;
      };
      cross(a, b, j, i, 1, 0);
      cross(a, c, j, i, 0, 1);
      cross(b, d, j + step, i, 0, 1);
      cross(c, d, j, i + step, 1, 0);
    }
  }
  pen.stroke();
}

/** Draws a map into its panel. */
export function draw_map(store, panel, { ink }) {
  const { now, cut, corner, cursor, wipe } = store, { still, moving } = now;
  const { name, wide, tall } = panel, pen = pen_of(panel), map = panel.map = map_of(store, name);
  panel.title.textContent = map.title ?? map.empty ?? "";
  if (map.empty) return;
  const [left, top, scale, [x, y, w, h]] = spot(store, panel), edge = left + scale * (x + wipe * w);
  const use = (strokeStyle, px) => Object.assign(pen, { strokeStyle, lineWidth: px / scale });
  pen.save();
  pen.translate(left, top);
  pen.scale(scale, scale); // a unit is a pixel of the frame
  clip(pen, x, y, w, h);
  pen.drawImage(canvas_of(map, still), 0, 0);
  // What is A, in B's colours, if it was asked for.
  const before = is_wiped(store, name) && map_of(store, name, store.kept.arrays);
  if (before && !before.empty) {
    clip(pen, x, y, wipe * w, h);
    pen.drawImage(canvas_of({ ...before, low: map.low, high: map.high }, still), 0, 0);
    pen.restore();
  }
  use("#fffb", 1);
  if (name === "distance") {
    const levels = rounds(map.low, map.high, 12, true);
    draw_isolines(pen, map.values, still, levels, moving ? 2 : 1);
  }
  use(RED, 1.5);
  if (["frame", "distance"].includes(name)) {
    const at = line_of(store) + 0.5, across = [at, at];
    path(pen, ...(cut.is_row ? [[0, still.width], across] : [across, [0, still.height]]));
  }
  use(GREEN, 2);
  if (corner && cursor) {
    const [from, above, to, below] = covered(store);
    pen.strokeRect(from, above, to - from, below - above);
  }
  pen.restore();
  pen.restore();
  if (before && !before.empty) {
    Object.assign(pen, { strokeStyle: GREEN, fillStyle: GREEN, lineWidth: 2 });
    pen.strokeRect(edge, top + scale * y, 0, scale * h);
    pen.fillRect(edge - 16, top + scale * y, 32, 15);
    write(pen, "A   B", edge, top + scale * y + 2, "white", "center");
  }
  if (map.values) draw_bar(pen, [wide - 50, 8, 10, tall - 16], map, ink);
  (map.keys ?? []).forEach(([text, colour], i) => {
    pen.fillStyle = "#000a";
    pen.fillRect(0, 16 * i, pen.measureText(text).width + 24, 16);
    pen.fillStyle = `rgb(${colour})`;
    pen.fillRect(4, 3 + 16 * i, 10, 10);
    write(pen, text, 18, 3 + 16 * i, "white");
  });
}
