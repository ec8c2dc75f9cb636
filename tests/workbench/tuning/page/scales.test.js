// Round numbers, ends of colours, and what is typed.
import assert from "node:assert/strict";
import { test } from "node:test";

import { ends_of, percentile, rounds, share_of, typed }
  from "../../../../endolab/workbench/tuning/page/scales.js";

test("round numbers lie between the ends, and are as many as there is room for", () => {
  for (const [low, high, count] of [[0, 1, 5], [-3.2, 17, 8], [0.011, 0.019, 4], [5, 5000, 6]]) {
    for (const log of low > 0 ? [false, true] : [false]) {
      const found = rounds(low, high, count, log);
      assert.ok(found.length > 1 && found.length <= 2 * count + 1, `${found}`);
      for (const one of found) {
        assert.ok(one >= low - 1e-3 * Math.abs(low) && one <= 1.001 * high);
        assert.equal(Number(one.toPrecision(2)), Number(one.toPrecision(6)));
      }
    }
  }
  assert.deepEqual(rounds(5, 200, 12, true), [5, 10, 20, 50, 100, 200]);
});

test("where a value lies is between 0 and 1, evenly in its logarithm", () => {
  assert.equal(share_of({ low: 10, high: 30 }, 15), 0.25);
  assert.ok(Math.abs(share_of({ low: 1, high: 100, log: true }, 10) - 0.5) < 1e-12);
});

test("colours end where nearly all values lie, and what is unknown counts for nothing", () => {
  const values = Float32Array.from({ length: 1001 }, (_, i) => (i === 500 ? NaN : i - 500));
  assert.equal(percentile(values, 0.5), -1);
  assert.deepEqual(ends_of("signed", values), [-490, 490]);
  const [low, high] = ends_of("log", values.map((value) => value + 501));
  assert.ok(low > 5 && low < 15 && high > 985 && high < 995);
});

test("a typed number is a number, and nothing else is", () => {
  assert.deepEqual(["0", " 0.5", "1, 2,3", ""].map(typed), [0, 0.5, [1, 2, 3], null]);
  assert.deepEqual(["abc", "1,,2", "1e999"].map(typed), [undefined, undefined, undefined]);
});
