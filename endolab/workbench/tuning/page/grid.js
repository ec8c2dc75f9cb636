// The surface as triangles: a grid of pixels, torn along the crack where it is cut. No DOM here.

/**
 * Lays triangles over every few pixels. Each corner of one has the distance of one pixel; up to a
 * crack, which both sides reach, it goes on by a share of its step from the pixel behind that one.
 * `at` tells where a corner lies in the picture, 0 to 1.
 * @param {{rays: Float32Array, cuts: Uint8Array, width: number, height: number}} frame
 */
export function lay_grid({ rays, cuts, width, height }, step) {
  const pixels = [], behind = [], shares = [], seen = [], at = [], corners = [];
  const columns = Math.ceil(width / step), rows = Math.ceil(height / step);
  // On the way from one pixel to another, on the side of the first.
  const add_corner = (from, to, share) => {
    const back = 2 * from - to, by = Math.abs(to - from) / step, low = Math.min(back, from);
    const is_there = by > 1 ? back >= 0 && back < width * height
      : Math.floor(back / width) === Math.floor(from / width);
    behind.push(is_there && !(crack(low, by, by > 1 ? 2 : 1) >= 0) ? back : from);
    shares.push(share);
    const between = (one, other) => one + share * (other - one);
    for (const axis of [0, 1, 2]) seen.push(between(rays[3 * from + axis], rays[3 * to + axis]));
    at.push((between(from % width, to % width) + 0.5) / width,
      (between(Math.floor(from / width), Math.floor(to / width)) + 0.5) / height);
    return pixels.push(from) - 1;
  };
  // Where a line of pixels is cut, between two of them: a share of the way; NaN if nowhere.
  const crack = (from, by, bit) => {
    for (let k = 0; k < step; k++) if (cuts[from + k * by] & bit) return (k + 0.5) / step;
    return NaN;
  };
  // From one crack to the next a cell holds together: a polygon up to these, a fan of triangles.
  const tear = (around) => {
    const [a, b, , d] = around.map((corner) => pixels[corner]);
    const shares = [crack(a, 1, 1), crack(b, width, 2), 1 - crack(d, 1, 1), 1 - crack(a, width, 2)];
    const cracked = [0, 1, 2, 3].filter((side) => shares[side] >= 0);
    const next = (side) => (side + 1) % 4;
    const reach = (from, to, share) => add_corner(pixels[around[from]], pixels[around[to]], share);
    if (cracked.length < 2) return [around];
    return cracked.map((side, k) => {
      const end = cracked[(k + 1) % cracked.length];
      const fan = [reach(next(side), side, 1 - shares[side])];
      for (let c = next(side); fan.push(around[c]), c !== end; c = next(c));
      return [...fan, reach(end, next(end), shares[end])];
    });
  };
  for (let i = 0; i < rows; i++) for (let j = 0; j < columns; j++) {
    const pixel = (i * width + j) * step;
    add_corner(pixel, pixel, 0);
  }
  for (let i = 0; i + 1 < rows; i++) for (let j = 0; j + 1 < columns; j++) {
    const p = i * columns + j, under = p + columns;
    for (const fan of tear([p, p + 1, under + 1, under])) {
      for (let k = 1; k + 1 < fan.length; k++) corners.push(fan[0], fan[k + 1], fan[k]);
    }
  }
  return { pixels, behind, shares, rays: seen, at, corners };
}
