// What the page's store asks Python for, and keeps of what it hears.
import assert from "node:assert/strict";
import { readFileSync, readdirSync } from "node:fs";
import { beforeEach, test } from "node:test";

import { has_left, leave_out, see, seen, widen }
  from "../../../../endolab/workbench/tuning/page/sight.js";
import { Store } from "../../../../endolab/workbench/tuning/page/store.js";
import { map_of } from "../../../../endolab/workbench/tuning/page/maps.js";

const TUNING = new URL("../../../../endolab/workbench/tuning/", import.meta.url);
const { asks, says } = JSON.parse(readFileSync(new URL("messages.json", TUNING)));
const FIRST = { lam: 1, k: null, channel: "auto", solver: "gauss_newton", scene: 0, left_out: [] };
const PRESETS = { default: { channel: "auto", solver: "gauss_newton" },
  fastest: { channel: "green", solver: "fast_marching" } };
const FACTS = { first: FIRST, presets: PRESETS, with_energy: ["gauss_newton"], palettes: { grey: [0, 1] },
  specs: [{ name: "scene", options: [["a", 0], ["b", 1], ["tube", "tube"]] }],
  scales: { distance: { palette: "grey", kind: "log", unit: null },
    error: { palette: "grey", kind: "signed", unit: "%" } } };
const STILL = { width: 4, height: 3, window: [0, 0, 4, 3], unit: "mm", metric: true, has_gain: true };
const MAPS = { distance: { title: "" }, "model - frame": { title: "" } };

let store, sent, python;

// What is asked for of one kind, since it was looked at last.
const asked = (action) => sent.splice(0).filter(([name]) => name === action).map(([, ...given]) => given);

function say(message, arrays = {}) {
  assert.deepEqual(Object.keys(message).filter((name) => !says.some((row) => row.name === name)), []);
  const names = Object.keys(arrays).map((name) => [name, "f4"]);
  const buffers = Object.values(arrays).map((one) => new DataView(Float32Array.from(one).buffer));
  store.hear({ ...message, names }, buffers);
}

// A final answer, in Python's place: each wish has a state, what is found anew has a number.
function answer(more = {}, far = 20) {
  const { state, found, knobs } = python, distance = Array.from({ length: 12 }, (_, p) => far + p);
  const message = { state, found, asked: knobs, moving: false, label: "λ, 99 %", maps: MAPS };
  say({ ...message, ...more }, { distance, "model - frame": distance.map(() => 0) });
}

// Answers the last turn; what has another channel is found anew.
function do_what_is_asked() {
  const [values, anew, found] = asked("turn").at(-1);
  const is_new = found === undefined && (anew || values.channel !== python.knobs.channel);
  python.found = is_new ? python.newest += 1 : found ?? python.found;
  python.knobs = values;
  python.state += 1;
  answer();
  return [values.lam, python.found];
}

const turn = (values) => { store.turn(values); return do_what_is_asked(); };
const anew = () => { store.turn({}, true); return do_what_is_asked(); };
const undo = () => { store.undo(); return do_what_is_asked(); };
const reset = () => { store.reset(); return do_what_is_asked(); };
const preset = (name) => { store.begin_with(PRESETS[name]); return do_what_is_asked(); };

beforeEach(() => {
  sent = [];
  python = { state: 0, found: 0, newest: 0, knobs: FIRST };
  store = new Store(FACTS, (action, ...given) => {
    assert.ok(given.length <= asks.find(({ name }) => name === action).given.length);
    sent.push([action, ...structuredClone(given)]);
  });
  answer({ still: STILL, knobs: FIRST, anew: true });
});

test("what the page asks for, and reads, is in the table of what Python does, and says", () => {
  const files = readdirSync(new URL("page/", TUNING)).filter((name) => /^(?!page).*js$/.test(name));
  const page = files.map((name) => readFileSync(new URL(`page/${name}`, TUNING), "utf8")).join("");
  const names = [...page.matchAll(/\bsend\("(\w+)"/g)].map(([, name]) => name);
  assert.deepEqual([...new Set(names)].sort(), asks.map(({ name }) => name).sort());
  const read = new Set([...page.matchAll(/\b(?:now|message)\.(\w+)/g)].map(([, name]) => name));
  const said = new Set(["arrays", "held", ...says.map(({ name }) => name)]);
  assert.deepEqual([...read].filter((name) => !said.has(name)), []);
});

// The answer to the first of two quick undos came after the second, and stood in the list as the last.
test("an answer that comes after another wish is not one to go back to", () => {
  for (const lam of [0.1, 3, 10]) turn({ lam });
  store.undo();
  const [[first]] = asked("turn");
  store.undo();
  python.state += 1;
  answer({ asked: first });
  assert.equal(do_what_is_asked()[0], 0.1);
  assert.equal(undo()[0], 1);
});

// The controls stayed where they were, and the next that was turned undid what code had turned.
test("what code turns is shown by the controls, and can be undone", () => {
  turn({ lam: 3 });
  python.knobs = { ...python.knobs, lam: 0.1 };
  say({ knobs: python.knobs });
  python.state += 1;
  answer();
  assert.equal(store.now.knobs.lam, 0.1);
  assert.equal(turn({ k: 2 })[0], 0.1);
  assert.deepEqual([undo()[0], undo()[0], undo()[0]], [0.1, 3, 1]);
});

// A reset showed another answer than the first: of light and contours found under another λ.
test("undo, reset and presets bring back what was found", () => {
  assert.deepEqual(turn({ lam: 5 }), [5, 0]);
  assert.deepEqual(anew(), [5, 1]);
  assert.deepEqual(turn({ lam: 1 }), [1, 1]);
  assert.deepEqual([undo(), undo(), undo()], [[5, 1], [5, 0], [1, 0]]);
  turn({ lam: 5 });
  anew();
  assert.deepEqual(reset(), [1, 0]);
  assert.deepEqual(python.knobs, FIRST);
  assert.deepEqual(undo(), [5, 2]);
  turn({ k: 3 });
  assert.deepEqual(reset(), [1, 0]);
  turn({ k: 3 });
  assert.deepEqual(preset("fastest"), [1, 3]);
  assert.deepEqual(python.knobs, { ...FIRST, ...PRESETS.fastest, k: 3 });
  assert.deepEqual(preset("default"), [1, 4]); // k is not what it was at first
  assert.deepEqual([preset("fastest"), preset("default"), reset()], [[1, 3], [1, 4], [1, 0]]);
});

test("undo before an answer goes back to the last that came", () => {
  turn({ lam: 5 });
  store.turn({ lam: 7 });
  assert.deepEqual(undo(), [5, 0]);
  answer(); // the same again, as with σ
  assert.deepEqual([undo(), undo()], [[1, 0], [1, 0]]);
});

test("what Python has forgotten is found again, and undo goes on", () => {
  turn({ lam: 5 });
  turn({ lam: 7 });
  store.undo();
  Object.assign(python, { state: 9, found: 9, newest: 9, knobs: { ...python.knobs, lam: 5 } });
  answer();
  assert.deepEqual(undo(), [1, 0]);
});

test("what comes of an older wish is dropped, and Python does not wait for it", () => {
  turn({ lam: 5 });
  python.state = 0;
  answer({}, 30);
  assert.equal(store.now.arrays.distance[0], 20);
  assert.deepEqual(asked("painted"), [[]]);
});

test("a map belongs to its answer, and σ is found of the one that is shown", () => {
  say({ maps: { ...MAPS, "σ": { title: "" } } }, { "σ": [1] });
  store.find_sigma();
  assert.deepEqual(asked("sigma"), [[0]]);
  turn({ lam: 5 });
  assert.ok(!("σ" in store.now.arrays));
  let was_heard = false;
  store.on("said", () => { was_heard = true; });
  say({ sigma: { done: 1, of: 8 }, state: 0 });
  assert.ok(!was_heard);
});

test("the next frame is a frame, and a scene no frame", () => {
  store.step(-1);
  assert.deepEqual(asked("turn"), []);
  store.step(1);
  store.step(1);
  assert.deepEqual(asked("turn").map(([{ scene }]) => scene), [1]);
});

test("colours are held while the hand moves, and B is compared with A", () => {
  const [{ low, high }] = [map_of(store, "distance")];
  store.keep();
  assert.equal(store.panels[2], "B / A - 1");
  python.state = 1;
  answer({ moving: true }, 40);
  assert.deepEqual([map_of(store, "distance").low, map_of(store, "distance").high], [low, high]);
  assert.deepEqual(map_of(store, "B / A - 1").values[0], 100);
  answer({ anew: true });
  assert.ok(store.kept);
  store.keep();
  assert.equal(store.panels[2], "model - frame");
});

test("colours that the surface has left are fitted, and held again", () => {
  map_of(store, "distance");
  python.state = 1;
  answer({}, 40);
  assert.ok(has_left(store));
  store.fit();
  assert.equal(map_of(store, "distance").low, 40);
  assert.ok(!has_left(store));
});

test("from a frame that cannot be read one goes on to the next", () => {
  store.step(1);
  say({ knobs: FIRST }); // refused
  assert.deepEqual(asked("turn").map(([{ scene }]) => scene), [1]);
  store.facts = { ...FACTS, specs: [{ name: "scene", options: [["a", 0], ["b", 1], ["c", 2]] }] };
  store.step(1);
  say({ knobs: FIRST });
  answer({ anew: true });
  say({ knobs: FIRST });
  assert.deepEqual(asked("turn").map(([{ scene }]) => scene), [1, 2]);
});

test("3D is there once, and moves", () => {
  store.show_in(0, "3D");
  assert.deepEqual(store.panels.slice(0, 5), ["3D", "distance", "model - frame", "section", "frame"]);
});

test("where an answer is not unique is what asking anew has changed, whatever was A", () => {
  python.state = 1;
  answer({ moving: true }, 30);
  store.keep();
  python.state = 2;
  answer({ anew: true }, 40);
  store.compare_with_before();
  assert.deepEqual([store.kept.arrays.distance[0], store.panels[2]], [20, "B / A - 1"]);
});

test("one looks closer about the cursor, and a rectangle is left out in shares", () => {
  store.cursor = [3, 0];
  widen(store, 0.5);
  assert.deepEqual(seen(store), [1.5, 0, 2, 1.5]);
  see(store);
  store.corner = [1, 2];
  leave_out(store);
  assert.deepEqual(asked("turn")[0][0].left_out, [[0.25, 0, 1, 1]]);
});
