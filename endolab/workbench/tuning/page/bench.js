// The model's bench: a plane before an endoscope, its picture, and the factors that make it.
import { draw_chart } from "./chart.js";
import { add, BLUE, coloured, GREEN, path, RED, unpacked } from "./drawing.js";
import { short } from "./scales.js";
import { shade } from "./shading.js";

const KNOBS = [
  ["k", "k′ of the lens", 0, 6, 0.05, "its vignetting: cosᵏ′ α"],
  ["m", "m of the lamp", 0, 6, 0.05, "how it spreads its light: cosᵐ ψ"],
  ["gamma", "γ", 1, 3, 0.02, "the response: the γ-th root of light is stored"],
  ["gain", "gain g [mm²]", 2, 6, 0.01, "brightness of the lamp times exposure", true],
  ["lamp", "lamp beside the lens [mm]", -10, 10, 0.1, "to the right of the optical centre"],
  ["tilt", "tilt of the wall [°]", -60, 60, 0.5, "about the vertical"],
  ["depth", "distance of the wall [mm]", 10, 150, 0.5, "along the optical axis"],
];
const GREYS = Uint32Array.from({ length: 256 }, (_, i) => 0xFF000000 | (i << 16) | (i << 8) | i);
const UNIT = { low: 0, high: 1 }, DEGREE = Math.PI / 180;
const FACTORS = [
  ["cos<sup>k′</sup> α · cos<sup>m</sup> ψ", UNIT],
  ["1/d<sup>2</sup> [1/mm²], logarithmic", { low: 1 / 150 ** 2, high: 1 / 10 ** 2, log: true }],
  ["fᵣ(θ) [1/sr]", { low: 0, high: 0.5 }],
  ["cos θ", UNIT],
  ["L = their product times g", UNIT],
];
const COLOURS = { ink: "#212121", faint: "#DDD" };
const NO_WALL = "repeating-linear-gradient(45deg, #B8B8B8 0 3px, #E4E4E4 3px 6px)";
const TURN = Array.from({ length: 25 }, (_, i) => i * Math.PI / 12);
// What is marked in all maps, px about its place: the nearest point, the brightest, the cursor.
const CROSS = [RED, [-7, 7, NaN, 0, 0], [0, 0, NaN, -7, 7]];
const RING = [BLUE, TURN.map((at) => 7 * Math.cos(at)), TURN.map((at) => 7 * Math.sin(at))];
const CURSOR = [GREEN, [-5, 5, NaN, -5, 5], [-5, 5, NaN, 5, -5]];
const LEGEND = "+ nearest to the lamp, ○ brightest, hatched: no wall";
const CATCH = 16; // px from the line of the BRDF at which its nodes are caught

const digits_of = (value) => (value && value < 0.01 ? value.toExponential(2) : short(value));
const largest = (map) => map.reduce((at, value, p) => (value > (map[at] ?? -1) ? p : at), -1);

function add_knob([name, label, min, max, step, title, log], knobs, to, ask) {
  const box = add("label", "", to, { title });
  const line = add("div", "", box, { style: "display: flex; justify-content: space-between" });
  add("span", "", line, { textContent: label });
  const said = add("output", "", line), style = "width: 100%";
  const slider = add("input", "", box, { type: "range", min, max, step, name, style });
  const tell = () => { said.textContent = log ? knobs[name].toExponential(2) : knobs[name]; };
  slider.value = log ? Math.log10(knobs[name]) : knobs[name];
  slider.oninput = () => {
    knobs[name] = log ? 10 ** slider.value : slider.valueAsNumber;
    tell();
    ask();
  };
  tell();
}

function add_panel(width, height, to, innerHTML = "") {
  const box = add("div", "", to, { style: "min-width: 0" });
  const title = add("div", "", box, { style: "font-weight: bold", innerHTML });
  const style = `background: ${NO_WALL}; max-width: 100%; display: block`;
  const canvas = add("canvas", "", box, { width, height, style });
  const said = add("div", "", box, { style: "height: 16px" });
  return { title, canvas, said, pen: canvas.getContext("2d") };
}

function draw_lines({ pen, canvas }, content) {
  pen.fillStyle = "white";
  pen.fillRect(0, 0, canvas.width, canvas.height);
  pen.font = "12px sans-serif";
  return draw_chart(pen, canvas.width, canvas.height, content, COLOURS);
}

/** Shows it in a node. @type {(host: Element, content: object) => void} */
export function bench(host, { width, height, packed, knobs, nodes, brdf, sheet }) {
  const camera = { rays: unpacked("f4", packed), width, height };
  const middle = Math.floor(height / 2) * width;
  const row_of = (map) => map.subarray(middle, middle + width);
  const columns = Float32Array.from({ length: width }, (_, u) => u);
  const grid = "display: grid; grid-template-columns: repeat(4, 1fr); gap: 2px 16px";
  const bar = add("div", "", host, { style: grid });
  const state = host.bench = { knobs, brdf, image: null, misread: null, marks: null, drawn: 0 };
  let kept = null, asked = false, cursor = -1; // the pixel under the pointer
  const ask = () => { if (!asked) asked = requestAnimationFrame(draw); };
  for (const one of KNOBS) add_knob(one, knobs, bar, ask);
  const actions = add("div", "", bar, { style: "display: flex; gap: 6px; align-items: center" });
  const act = (textContent, title, change) => {
    const onclick = () => { change(); ask(); };
    add("button", "", actions, { textContent, title, onclick });
  };
  act("keep", "keep this picture, and compare what follows with it",
    () => { kept = state.image.slice(); });
  act("matt", "the same fᵣ at all angles", () => brdf.fill(brdf[0]));
  act("paper", "the sheen of printed paper", () => Object.assign(brdf, sheet));
  const style = "display: flex; align-items: flex-end; gap: 10px; margin-top: 8px";
  const [upper, lower] = [0, 1].map(() => add("div", "", host, { style }));
  const small = Math.round(186 * height / width), tall = Math.round(340 * height / width);
  const panels = FACTORS.map(([title, scale]) => [add_panel(186, small, upper, title), scale]);
  const picture = add_panel(340, tall, lower);
  panels.push([picture, UNIT]);
  const profile = add_panel(300, tall, lower);
  const curve = add_panel(300, tall, lower, "fᵣ(θ): drag its line");
  let places = null; // where the curve's axes lie
  function draw() {
    asked = false;
    const maps = shade(camera, knobs, nodes, brdf), image = state.image = maps[5];
    const marks = state.marks = [largest(maps[1]), largest(maps[4]), cursor];
    panels.forEach(([{ pen, canvas, said }, scale], i) => {
      const drawn = coloured(maps[i], { ...scale, palette: GREYS }, width, height);
      pen.clearRect(0, 0, canvas.width, canvas.height);
      pen.drawImage(drawn, 0, 0, canvas.width, canvas.height);
      pen.lineWidth = 2;
      [CROSS, RING, CURSOR].forEach(([colour, xs, ys], which) => {
        const at = marks[which], one = canvas.width / width;
        const [left, top] = [one * (at % width + 0.5), one * (Math.floor(at / width) + 0.5)];
        pen.strokeStyle = colour;
        if (at >= 0) path(pen, xs, ys, (x, y) => [left + x, top + y]);
      });
      const value = maps[i][cursor];
      said.textContent = value === undefined ? "" : value === value ? digits_of(value) : "no wall";
    });
    if (cursor < 0) picture.said.textContent = LEGEND;
    const lines = [{ x: columns, y: row_of(image), colour: BLUE, name: kept && "now" }];
    let title = "I = L<sup>1/γ</sup>";
    if (kept) {
      const apart = (value, p) => 255 * Math.abs(value - image[p]) || 0;
      const off = kept.reduce((most, value, p) => Math.max(most, apart(value, p)), 0);
      title += `: up to ${off.toFixed(1)} grey levels from the kept one`;
      lines.push({ x: columns, y: row_of(kept), colour: RED, name: "kept" });
    }
    picture.title.innerHTML = title;
    const u = { label: "column u [px]", low: 0, high: width };
    // Whoever takes the lamp to be at the lens misreads d, as light goes with 1/d²: %, at two dots.
    const centred = row_of(shade(camera, { ...knobs, lamp: 0 }, nodes, brdf)[4]);
    const two = [0.25, 0.75].map((share) => Math.round(share * width)), lit = row_of(maps[4]);
    const off = state.misread = two.map((at) => 100 * (Math.sqrt(centred[at] / lit[at]) - 1));
    const both = off.map((one) => (Number.isFinite(one) ? one.toFixed(1) : "–")).join(" and ");
    profile.title.textContent = `As if at the lens: d off by ${both} %`;
    const read = two.map((at) => ({ x: at, y: row_of(image)[at], colour: COLOURS.ink }));
    const stored = { label: "I in the middle row", low: 0, high: 1.05 };
    draw_lines(profile, { x: u, y: stored, lines, dots: read });
    const x = nodes.map((node) => node / DEGREE);
    const theta = { label: "incidence θ [°]", low: -3, high: 83 };
    const dots = x.map((degrees, i) => ({ x: degrees, y: brdf[i], colour: BLUE }));
    const f_r = { label: "fᵣ [1/sr]", low: 0, high: 0.5 };
    places = draw_lines(curve, { x: theta, y: f_r, lines: [{ x, y: brdf, colour: BLUE }], dots });
    state.drawn += 1;
  }
  for (const [{ canvas }] of panels) {
    canvas.onpointermove = ({ offsetX, offsetY }) => {
      const one = width / canvas.clientWidth;
      cursor = Math.floor(one * offsetY) * width + Math.floor(one * offsetX);
      ask();
    };
    canvas.onpointerleave = () => { cursor = -1; ask(); };
  }
  const { canvas } = curve;
  canvas.style.touchAction = "none";
  canvas.onpointermove = canvas.onpointerdown = ({ type, pointerId, offsetX, offsetY }) => {
    const shrunk = canvas.clientWidth / canvas.width, { to_x, to_y } = places;
    const apart = to_x(nodes[1] / DEGREE) - to_x(0), y = offsetY / shrunk;
    const node = Math.round((offsetX / shrunk - to_x(0)) / apart);
    const is_near = Math.abs(y - to_y(brdf[node])) < CATCH;
    canvas.style.cursor = is_near ? "ns-resize" : "";
    if (is_near && type === "pointerdown") canvas.setPointerCapture(pointerId);
    if (!canvas.hasPointerCapture(pointerId) || !(node in brdf)) return;
    const value = 0.5 * (y - to_y(0)) / (to_y(0.5) - to_y(0));
    brdf[node] = Math.min(0.5, Math.max(1e-3, value));
    ask();
  };
  draw();
}
