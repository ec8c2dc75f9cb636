// The box that holds a surface, and how who turns it sees it. No DOM here.
import { short } from "./scales.js";

const CORNERS = [0, 1, 2, 3, 4, 5, 6, 7].map((i) => [i & 1, (i >> 1) & 1, i >> 2]);
/** Pairs of a box's corners. */
export const EDGES = [0, 1, 0, 2, 0, 4, 1, 3, 1, 5, 2, 3, 2, 6, 3, 7, 4, 5, 4, 6, 5, 7, 6, 7];
/** Degrees to the left and up, zoom, shift (panels). */
export const OUTSIDE = [35, 20, 1, 0, 0], CAMERA = [0, 0, 1, 0, 0];

/** The corners of a box between two of them. @param {number[][]} ends */
export const corners_of = (ends) => CORNERS.map((corner) => corner.map((end, i) => ends[end][i]));

/**
 * How a box is seen in a panel of a width over height: from an `eye`, which has x to the right, y
 * down and z away, through a `lens`, in which the box just fits at first.
 * @type {(box: number[][], pose: number[], inside: boolean, wide: number) => {eye: DOMMatrix,
 *   lens: DOMMatrix}}
 */
export function view_of(box, pose, inside, wide) {
  const [low, high] = box, [, , zoom, right, down] = pose;
  const middle = low.map((part, i) => (part + high[i]) / 2);
  const size = Math.hypot(...low.map((part, i) => high[i] - part)) / 2;
  const eye_of = ([yaw, pitch], back, [x, y, z]) => new DOMMatrix().translate(0, 0, back)
    .rotateAxisAngle(1, 0, 0, pitch).rotateAxisAngle(0, 1, 0, -yaw).translate(-x, -y, -z);
  const first = eye_of(OUTSIDE, 2.6 * size, middle);
  const fit = Math.max(...corners_of(box).map((corner) => {
    const { x, y, z } = first.transformPoint(new DOMPoint(...corner));
    return Math.max(Math.abs(x) / wide, Math.abs(y)) / z;
  }));
  const back = inside ? 0 : 2.6 * size / zoom, near = inside ? 1e-3 * size : 0.05 * back;
  const far = back + 20 * size, depth = far - near, scale = inside ? 0.8 * zoom : 0.9 / fit;
  const lens = new DOMMatrix([scale / wide, 0, 0, 0, 0, -scale, 0, 0,
    2 * right, -2 * down, (far + near) / depth, 1, 0, 0, -2 * far * near / depth, 0]);
  return { eye: eye_of(pose, back, inside ? [0, 0, 0] : middle), lens };
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
