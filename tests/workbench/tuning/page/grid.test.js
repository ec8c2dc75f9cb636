// The surface is torn along the crack: nothing is missing, and nothing reaches over it.
import assert from "node:assert/strict";
import { test } from "node:test";

import { lay_grid } from "../../../../endolab/workbench/tuning/page/grid.js";

const width = 13, height = 9, size = width * height;
const rays = Float32Array.from({ length: 3 * size }, () => 0.5);

// A slanted crack from top to bottom, as the solver cuts: between the columns left and right of it.
const edge = (i) => 4 + Math.floor(i / 2);
const cuts = new Uint8Array(size);
for (let i = 0; i < height; i++) {
  cuts[i * width + edge(i)] |= 1;
  if (i + 1 < height && edge(i + 1) > edge(i)) cuts[i * width + edge(i + 1)] |= 2;
}
const is_left = (pixel) => pixel % width <= edge(Math.floor(pixel / width));

test("each side goes on to the crack as it came", () => {
  const plane = (x, y, left) => (left ? 20 + x + 2 * y : 50 - 2 * x + y);
  const map = Float32Array.from({ length: size }, (_, p) =>
    plane(p % width, Math.floor(p / width), is_left(p)));
  const { pixels, behind, shares, at } = lay_grid({ rays, cuts, width, height }, 1);
  let torn = 0;
  pixels.forEach((pixel, one) => {
    if (behind[one] === pixel) return; // on the grid, or alone
    torn += 1;
    const far = map[pixel] + shares[one] * (map[pixel] - map[behind[one]]);
    const [x, y] = [at[2 * one] * width - 0.5, at[2 * one + 1] * height - 0.5];
    assert.ok(Math.abs(far - plane(x, y, is_left(pixel))) < 1e-4);
  });
  assert.ok(torn > 10);
});

for (const step of [1, 2, 4]) {
  test(`a crack leaves no hole, every ${step} px`, () => {
    const { pixels, at, corners } = lay_grid({ rays, cuts, width, height }, step);
    let area = 0;
    for (let k = 0; k < corners.length; k += 3) {
      const three = [...corners.slice(k, k + 3)], sides = three.map((one) => is_left(pixels[one]));
      const [[a, b], [c, d], [e, f]] = three.map((one) => [at[2 * one] * width, at[2 * one + 1] * height]);
      assert.equal(new Set(sides).size, 1);
      area -= ((c - a) * (f - b) - (e - a) * (d - b)) / 2; // all face one way
    }
    assert.ok(Math.abs(area - (width - 1) * (height - 1)) < 0.5 * height * step, `${area}`);
  });
}
