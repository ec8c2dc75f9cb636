// The box that holds a surface, and how who turns it sees it. No DOM here.
import { short } from "./scales.js";

export const CORNERS = [0, 1, 2, 3, 4, 5, 6, 7].map((i) => [i & 1, (i >> 1) & 1, i >> 2]);
/** Pairs of corners. */
export const EDGES = CORNERS.flatMap((_, i) =>
  [1, 2, 4].filter((bit) => !(i & bit)).flatMap((bit) => [i, i | bit]));
/** Degrees to the left and up, zoom, shift (panels). */
export const OUTSIDE = [35, 20, 1, 0, 0], CAMERA = [0, 0, 1, 0, 0];

export const dot = (a, b) => a.reduce((sum, part, i) => sum + part * b[i], 0);

/** To the right, down and away, as one sees who stands to the left of the axis and above it. */
export function turned([yaw, pitch]) {
  const [y, p] = [yaw, pitch].map((angle) => angle * Math.PI / 180);
  const [cy, sy, cp, sp] = [Math.cos(y), Math.sin(y), Math.cos(p), Math.sin(p)];
  return [[cy, 0, -sy], [-sp * sy, cp, -sp * cy], [cp * sy, sp, cp * cy]];
}

/**
 * @typedef {{middle: number[], size: number, corners: number[][]}} Box
 * @type {(ends: number[][]) => Box}
 */
export function box_between([low, high]) {
  const corners = CORNERS.map((ends) => ends.map((end, axis) => (end ? high : low)[axis]));
  const middle = low.map((part, i) => (part + high[i]) / 2);
  return { middle, size: Math.hypot(...low.map((part, i) => high[i] - part)) / 2, corners };
}

/**
 * By columns, from the camera's frame to clip space, and where the eye is; `wide` is a panel's
 * width over its height. As it is seen at first the box just fits in.
 * @type {(box: Box, pose: number[], inside: boolean, wide: number) => {seen: number[],
 *   eye: number[]}}
 */
export function view_of({ middle, size, corners }, pose, inside, wide) {
  const [, , zoom, shift, sink] = pose, [right, down, away] = turned(pose);
  const rims = corners.map((corner) => {
    const off = corner.map((part, i) => part - middle[i]);
    const [x, y, z] = turned(OUTSIDE).map((axis) => dot(axis, off));
    return Math.max(Math.abs(x) / wide, Math.abs(y)) / (z + 2.6 * size);
  });
  const back = inside ? 0 : 2.6 * size / zoom, near = inside ? 1e-3 * size : 0.05 * back;
  const end = back + 20 * size, to = inside ? [0, 0, 0] : middle;
  const lens = inside ? 0.8 * zoom : 0.9 / Math.max(...rims), stretch = (end + near) / (end - near);
  const column = (place, w, more) => [lens / wide * dot(right, place) + 2 * shift * w,
    -lens * dot(down, place) - 2 * sink * w, stretch * w + more, w];
  const axes = [[1, 0, 0], [0, 1, 0], [0, 0, 1]];
  const off = to.map((part) => -part);
  const last = column(off, dot(away, off) + back, -2 * end * near / (end - near));
  const seen = [...axes.flatMap((axis) => column(axis, dot(away, axis), 0)), ...last];
  return { seen, eye: to.map((part, i) => part - back * away[i]) };
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
  return [ends.map(([low]) => low), ends.map(([, high]) => high)];
}

/** What is said of a box. */
export const said_of = ([low, high], unit) =>
  `${low.map((part, axis) => short(high[axis] - part, 2)).join(" × ")} ${unit}, the near 95 %`;
