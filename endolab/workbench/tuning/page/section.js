// A section: z and x of a row, or y of a column.
import { BLACK, GREEN, pen_of, RED } from "./drawing.js";
import { draw_chart } from "./chart.js";
import { percentile } from "./scales.js";
import { line_of } from "./sight.js";

/**
 * z and x of a row, or y of a column, with a gap where the surface is cut.
 * @type {(map: Float32Array, grid: object, is_row: boolean, index: number) => {x: number[],
 *   y: number[]}}
 */
export function section(map, { rays, cuts, width, height }, is_row, index) {
  const x = [], y = [];
  for (let i = 0; i < (is_row ? width : height); i++) {
    const pixel = is_row ? index * width + i : i * width + index;
    x.push(map[pixel] * rays[3 * pixel + 2]);
    y.push(map[pixel] * rays[3 * pixel + (is_row ? 0 : 1)]);
    if (cuts[pixel] & (is_row ? 1 : 2)) { x.push(NaN); y.push(NaN); }
  }
  return { x, y };
}

const brief = ({ label }) => label.split(" · ").slice(0, 2).join(" · ");

/** Draws it: the result, A and the truth, in limits that are held as scales are. */
export function draw_section(store, panel, colours) {
  const { now, kept, cut } = store, { unit } = now.still, index = line_of(store), { arrays } = now;
  const add_line = (of, name, colour, cuts = of.cuts, map = of.distance) => {
    if (map?.length) {
      const grid = { ...now.still, rays: arrays.rays, cuts };
      lines.push({ ...section(map, grid, cut.is_row, index), name, colour });
    }
  };
  const lines = [];
  add_line(arrays, "truth", BLACK, arrays.cuts, arrays.truth);
  if (kept) add_line(kept.arrays, `A: ${brief(kept)}`, GREEN);
  add_line(arrays, kept ? `B: ${brief(now)}` : "result", RED);
  panel.title.textContent = `along ${cut.is_row ? "row" : "column"} ${index}`;
  const ends = (some) => [percentile(some, 0.005), percentile(some, 0.98)];
  const held = now.held[`${cut.is_row} ${index}`] ??= [ends(lines[0].x), ends(lines[0].y)];
  const [[x_low, x_high], [y_low, y_high]] = held;
  const more = 0.06 * (x_high - x_low), beside = 0.1 * (y_high - y_low);
  const x = { label: `z [${unit}]`, low: x_low - more, high: x_high + 2 * more };
  const y = { label: `x [${unit}]`, low: y_low - beside, high: y_high + beside };
  if (!cut.is_row) y.label = `y [${unit}]`;
  const content = { x, y, lines, equal: true, down: !cut.is_row };
  panel.axes = draw_chart(...pen_of(panel), content, colours);
}
