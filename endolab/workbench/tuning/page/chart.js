// Lines and dots on axes.
import { clip, path, write } from "./drawing.js";
import { rounds, share_of, short } from "./scales.js";

/** @typedef {{label: string, low: number, high: number, log?: boolean, ticks?: any[][]}} Axis */

/**
 * Draws a chart, and returns where values lie on it, px. A rule is a line across at an x or a y;
 * `right` is another axis, for lines that say so; `equal` gives a unit one length along both.
 * @param {{x: Axis, y: Axis, right?: Axis, lines: object[], dots?: object[], rules?: object[],
 *   equal?: boolean, down?: boolean}} content  all with an x, a y and a colour
 */
export function draw_chart(pen, wide, tall, content, { ink, faint }) {
  const { x, y, right, lines, dots = [], rules = [], equal, down } = content;
  const [left, top, w, h] = [60, 20, wide - (right ? 94 : 70), tall - 52];
  if (equal) {
    const scale = Math.max((x.high - x.low) / w, (y.high - y.low) / h);
    for (const [axis, size] of [[x, w], [y, h]]) {
      const middle = (axis.low + axis.high) / 2, half = scale * size / 2;
      Object.assign(axis, { low: middle - half, high: middle + half });
    }
  }
  const to_x = (value) => left + w * share_of(x, value);
  const to_y = (value, axis = y) =>
    top + h * (down ? share_of(axis, value) : 1 - share_of(axis, value));
  const labels = (axis, count) => axis.ticks ??
    rounds(axis.low, axis.high, Math.floor(count), axis.log).map((one) => [one, short(one)]);
  Object.assign(pen, { strokeStyle: faint, lineWidth: 1 });
  let end = 0; // of the last label
  for (const [value, text] of labels(x, w / 50)) {
    const half = pen.measureText(text).width / 2;
    pen.strokeRect(to_x(value), top, 0, h);
    if (to_x(value) - half < end) continue;
    write(pen, text, to_x(value), top + h + 3, ink, "center");
    end = to_x(value) + half + 5;
  }
  write(pen, x.label, left + w / 2, tall - 14, ink, "center");
  for (const [value, text] of labels(y, h / 28)) {
    pen.strokeRect(left, to_y(value), w, 0);
    write(pen, text, left - 4, to_y(value), ink, "right", "middle");
  }
  for (const [value, text] of right ? labels(right, h / 28).slice(1) : []) { // above its low end
    write(pen, text, left + w + 4, to_y(value, right), ink, "left", "middle");
  }
  pen.save();
  pen.translate(7, top + h / 2);
  pen.rotate(-Math.PI / 2);
  write(pen, y.label, 0, 0, ink, "center", "middle");
  pen.restore();
  clip(pen, left, top, w, h);
  pen.lineWidth = 2;
  for (const { x: across, y: up, colour } of rules) {
    pen.strokeStyle = colour;
    if (across !== undefined) pen.strokeRect(to_x(across), top - 2, 0, h + 4);
    else pen.strokeRect(left - 2, to_y(up), w + 4, 0);
  }
  for (const line of lines) {
    pen.strokeStyle = line.colour;
    path(pen, line.x, line.y, (a, b) => [to_x(a), to_y(b, line.right ? right : y)]);
  }
  for (const { x: across, y: up, colour, text } of dots) {
    pen.fillStyle = colour;
    pen.beginPath();
    pen.arc(to_x(across), to_y(up), 4.5, 0, 7);
    pen.fill();
    const within = Math.min(Math.max(to_x(across), left + 12), left + w - 12);
    if (text) write(pen, text, within, to_y(up) - 6, ink, "center", "bottom");
  }
  pen.restore();
  let place = 6;
  for (const { name, colour } of lines.filter((line) => line.name)) {
    write(pen, name, place, 2, colour);
    place += pen.measureText(name).width + 10;
  }
  return { to_x, to_y };
}
