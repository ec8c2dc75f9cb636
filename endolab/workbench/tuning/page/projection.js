// The box that holds a surface, and how who turns it sees it. No DOM here.
import { short } from "./scales.js";

const CORNERS = [0, 1, 2, 3, 4, 5, 6, 7].map((i) => [i & 1, (i >> 1) & 1, i >> 2]);
/** Pairs of a box's corners. */
export const EDGES = [0, 1, 0, 2, 0, 4, 1, 3, 1, 5, 2, 3, 2, 6, 3, 7, 4, 5, 4, 6, 5, 7, 6, 7];
/** Degrees to the left and up, zoom, shift (panels). */
export const OUTSIDE = [35, 20, 1, 0, 0], CAMERA = [0, 0, 1, 0, 0];

/** To the right, down and away, as one sees who stands to the left of the axis and above it. */
export function turned([yaw, pitch]) {
  const [y, p] = [yaw, pitch].map((angle) => angle * Math.PI / 180);
  const [cy, sy, cp, sp] = [Math.cos(y), Math.sin(y), Math.cos(p), Math.sin(p)];
  return [[cy, 0, -sy], [-sp * sy, cp, -sp * cy], [cp * sy, sp, cp * cy]];
}

/** The corners of a box between two of them. @param {number[][]} ends */
export const corners_of = (ends) => CORNERS.map((corner) => corner.map((end, i) => ends[end][i]));

/**
 * How a box [low, high] is seen in a panel of a width over height: `turn`, the axes, about the
 * `middle`, `back` behind it; the `lens`, so that at first the box just fits in; the `shift`; the
 * `depth` that is drawn; and where a point is `placed`: -1 to 1 to the right and up.
 */
export function view_of(box, pose, inside, wide) {
  const [low, high] = box, [, , zoom, ...shift] = pose;
  const centre = low.map((part, i) => (part + high[i]) / 2);
  const size = Math.hypot(...low.map((part, i) => high[i] - part)) / 2;
  const from = (axes, middle, back) => (point) => axes.map((axis, i) =>
    axis.reduce((sum, part, k) => sum + part * (point[k] - middle[k]), i === 2 ? back : 0));
  const rims = corners_of(box).map(from(turned(OUTSIDE), centre, 2.6 * size));
  const fit = Math.max(...rims.map(([x, y, z]) => Math.max(Math.abs(x) / wide, Math.abs(y)) / z));
  const back = inside ? 0 : 2.6 * size / zoom, near = inside ? 1e-3 * size : 0.05 * back;
  const scale = inside ? 0.8 * zoom : 0.9 / fit, middle = inside ? [0, 0, 0] : centre;
  const turn = turned(pose), lens = [scale / wide, scale];
  const placed = (point) => {
    const [x, y, z] = from(turn, middle, back)(point);
    return z > 0 ? [lens[0] * x / z + 2 * shift[0], -lens[1] * y / z - 2 * shift[1]] : undefined;
  };
  return { turn, middle, back, lens, shift, depth: [near, back + 20 * size], placed };
}

/** The box of the near 95 % of a surface: [low, high]. */
export function box_of(map, rays) {
  const some = [];
  for (let pixel = 0; pixel < map.length; pixel += 7) if (map[pixel] > 0) some.push(pixel);
  const ends = [0, 1, 2].map((axis) => {
    const values = Float32Array.from(some, (pixel) => map[pixel] * rays[3 * pixel + axis]).sort();
    const shares = [0.01, axis === 2 ? 0.95 : 0.99];
    return shares.map((share) => values[Math.floor(share * values.length)]);
  });
  return [0, 1].map((end) => ends.map((both) => both[end]));
}

/** What is said of a box. */
export const said_of = ([low, high], unit) =>
  `${low.map((part, axis) => short(high[axis] - part, 2)).join(" × ")} ${unit}, the near 95 %`;
