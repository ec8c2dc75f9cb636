// The surface as triangles: a grid of pixels, torn along the crack where it is cut. No DOM here.

// Corners of a cell, around it: across and down.
const AROUND = [[0, 0], [1, 0], [1, 1], [0, 1]];

/**
 * Where a line of pixels is cut, between two of them: a share of the way, or undefined.
 * @type {(cuts: Uint8Array, from: number, by: number, step: number, bit: 1 | 2) => number}
 */
function crack(cuts, from, by, step, bit) {
  for (let k = 0; k < step; k++) if (cuts[from + k * by] & bit) return (k + 0.5) / step;
  return undefined;
}

/**
 * Lays triangles over every few pixels. Each corner of one has the distance of one pixel: beyond a
 * crack that of the side that it belongs to, so that both sides reach it. `at` tells where a corner
 * lies in the picture, 0 to 1.
 * @type {(frame: {rays: Float32Array, cuts: Uint8Array, width: number, height: number},
 *   step: number) => {pixels: Uint32Array, rays: Float32Array, at: Float32Array,
 *   corners: Uint32Array}}
 */
export function lay_grid(frame, step) {
  const { rays, cuts, width, height } = frame;
  const columns = Math.ceil(width / step), rows = Math.ceil(height / step), count = columns * rows;
  const pixels = new Uint32Array(count), seen = new Float32Array(3 * count);
  const at = new Float32Array(2 * count), corners = new Uint32Array(6 * (columns - 1) * (rows - 1));
  const beyond = { pixels: [], seen: [], at: [], corners: [] }; // of cells that are torn
  let joined = 0;
  for (let i = 0, p = 0; i < rows; i++) for (let j = 0; j < columns; j++, p++) {
    const pixel = pixels[p] = (i * width + j) * step;
    for (let axis = 0; axis < 3; axis++) seen[3 * p + axis] = rays[3 * pixel + axis];
    at[2 * p] = (j * step + 0.5) / width;
    at[2 * p + 1] = (i * step + 0.5) / height;
  }
  for (let i = 0; i + 1 < rows; i++) for (let j = 0; j + 1 < columns; j++) {
    const p = i * columns + j, under = p + columns;
    let is_cut = false;
    for (let a = 0; a <= step; a++) for (let b = 0; b <= step; b++) {
      is_cut ||= cuts[pixels[p] + a * width + b] > 0;
    }
    if (is_cut) tear([p, p + 1, under + 1, under], pixels, frame, step, beyond);
    else {
      for (const one of [p, under, p + 1, p + 1, under, under + 1]) corners[joined++] = one;
    }
  }
  const all = (kind, some, more) => {
    const one = new kind(some.length + more.length);
    one.set(some);
    one.set(more, some.length);
    return one;
  };
  return { pixels: all(Uint32Array, pixels, beyond.pixels), at: all(Float32Array, at, beyond.at),
    rays: all(Float32Array, seen, beyond.seen),
    corners: all(Uint32Array, corners.subarray(0, joined), beyond.corners) };
}

// Each part of a cell that holds together is a polygon up to the cracks: a fan of triangles.
function tear(around, grid, { rays, cuts, width, height }, step, { pixels, seen, at, corners }) {
  const [a, b, , d] = around.map((corner) => grid[corner]), parts = [0, 1, 2, 3];
  const cracks = [crack(cuts, a, 1, step, 1), crack(cuts, b, width, step, 2),
    crack(cuts, d, 1, step, 1), crack(cuts, a, width, step, 2)];
  for (const side of [0, 1, 2, 3, 0, 1, 2]) { // corners along sides without a crack are of one part
    const next = (side + 1) % 4;
    if (cracks[side] === undefined) parts[side] = parts[next] = Math.min(parts[side], parts[next]);
  }
  // A corner on the way from one pixel to another, with the distance of the first.
  const add_corner = (from, to, share) => {
    const between = (one, other) => (1 - share) * one + share * other;
    for (const axis of [0, 1, 2]) seen.push(between(rays[3 * from + axis], rays[3 * to + axis]));
    const [x, y] = [between(from % width, to % width),
      between(Math.floor(from / width), Math.floor(to / width))];
    at.push((x + 0.5) / width, (y + 0.5) / height);
    return grid.length + pixels.push(from) - 1;
  };
  for (const part of new Set(parts)) {
    const fan = [];
    for (const side of [0, 1, 2, 3]) {
      const next = (side + 1) % 4, [from, to] = [grid[around[side]], grid[around[next]]];
      // Along the lower and the left side one goes backwards.
      const share = side < 2 ? cracks[side] : 1 - cracks[side];
      if (parts[side] === part) fan.push(around[side]);
      if (parts[side] === part && parts[next] !== part) fan.push(add_corner(from, to, share));
      if (parts[side] !== part && parts[next] === part) fan.push(add_corner(to, from, 1 - share));
    }
    for (let k = 1; k + 1 < fan.length; k++) corners.push(fan[0], fan[k + 1], fan[k]);
  }
}
