// A section: z and x of a row, or y of a column.
import { draw_chart } from "./chart.js";
import { BLACK, GREEN, pen_of, RED } from "./drawing.js";
import { percentile } from "./scales.js";
import { line_of } from "./sight.js";

/** Draws the result, A and the truth, with gaps at cuts, in limits that are held as scales are. */
export function draw_section(store, panel, colours) {
  const { now, kept, cut: { is_row } } = store, { unit, width, height } = now.still;
  const index = line_of(store), { truth, cuts, distance, rays } = now.arrays, lines = [];
  const brief = ({ label }) => label.split(" · ").slice(0, 2).join(" · ").replace(" order", "");
  const add_line = (map, cracks, name, colour) => {
    const x = [], y = [];
    for (let i = 0; i < (is_row ? width : height); i++) {
      const pixel = is_row ? index * width + i : i * width + index;
      x.push(map[pixel] * rays[3 * pixel + 2]);
      y.push(map[pixel] * rays[3 * pixel + (is_row ? 0 : 1)]);
      if (cracks[pixel] & (is_row ? 1 : 2)) { x.push(NaN); y.push(NaN); }
    }
    lines.push({ x, y, name, colour });
  };
  if (truth?.length) add_line(truth, cuts, "truth", BLACK);
  if (kept) add_line(kept.arrays.distance, kept.arrays.cuts, `A: ${brief(kept)}`, GREEN);
  add_line(distance, cuts, kept ? `B: ${brief(now)}` : "result", RED);
  panel.title.textContent = `along ${is_row ? "row" : "column"} ${index}`;
  const ends = (some) => [percentile(some, 0.005), percentile(some, 0.98)];
  const held = now.held[`${is_row} ${index}`] ??= [ends(lines[0].x), ends(lines[0].y)];
  const [[x_low, x_high], [y_low, y_high]] = held;
  const more = 0.06 * (x_high - x_low), beside = 0.1 * (y_high - y_low);
  const x = { label: `z [${unit}]`, low: x_low - more, high: x_high + 2 * more };
  const label = `${is_row ? "x" : "y"} [${unit}]`;
  const y = { label, low: y_low - beside, high: y_high + beside };
  const content = { x, y, lines, equal: true, down: !is_row };
  panel.axes = draw_chart(pen_of(panel), panel.wide, panel.tall, content, colours);
}
