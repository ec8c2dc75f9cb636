// A tuner without Python: answers for each regulariser and λ lie packed in the page.
import { unpacked } from "./drawing.js";
import { render } from "./tuner.js";

// Three planes of maps, each of which is what it differs by from the one before.
async function unpack(packed, count, size) {
  const stream = new Blob([unpacked("u1", packed)]).stream();
  const inflated = stream.pipeThrough(new DecompressionStream("deflate"));
  const planes = new Uint8Array(await new Response(inflated).arrayBuffer());
  for (let p = 0; p < planes.length; p++) {
    if (p % (count * size) >= size) planes[p] += planes[p - size];
  }
  return planes;
}

/** Shows it in a node. @type {(content: object, el: Element) => Promise<void>} */
export async function play({ facts, first, messages, still, packed, low, step, end }, el) {
  const size = first.still.width * first.still.height, all = messages.length * size;
  const planes = await unpack(packed, messages.length, size);
  let hear, shown; // the answer on the screen
  const show = ({ lam, regulariser }, more = {}, before = []) => {
    const away = ({ asked }) =>
      Math.abs(Math.log(asked.lam / lam)) + (asked.regulariser === regulariser ? 0 : 99);
    const answer = messages.reduce((a, b) => (away(b) < away(a) ? b : a));
    if (answer === shown) return;
    shown = answer;
    const from = messages.indexOf(answer) * size;
    const distance = new Float32Array(size).map((_, p) => {
      const code = planes[from + p] + 256 * planes[all + from + p];
      return code ? Math.exp(low + step * code) : NaN;
    });
    const left = planes.subarray(2 * all + from, 2 * all + from + size);
    const residual = Float32Array.from(left, (code) => (code ? (code - 128) * end / 127 : NaN));
    const sent = [...before, ["distance", "f4", distance], ["model - frame", "f4", residual]];
    const always = { names: sent, badge: "no Python", knobs: answer.asked, state: 0 };
    hear({ ...answer, ...more, ...always }, sent.map(([, , { buffer }]) => new DataView(buffer)));
  };
  const model = {
    get: () => facts,
    on(event, action) { if (event === "msg:custom") hear = action; },
    send({ do: action, given }) {
      const arrays = () => still.map(([name, kind, text]) => [name, kind, unpacked(kind, text)]);
      if (action === "ready") show(first.knobs, first, arrays());
      if (action === "turn") show(given[0]);
    },
  };
  render({ model, el });
}
