// The model's bench, on top of board.js: a plane before an endoscope, its picture, and the factors that make it.
const KNOBS = [
  ["k", "k′ of the lens", 0, 6, 0.05, "its vignetting: cos^k′ α"],
  ["m", "m of the lamp", 0, 6, 0.05, "how it spreads its light: cosᵐ ψ"],
  ["gamma", "γ", 1, 3, 0.02, "the response: I = L^(1/γ)"],
  ["gain", "gain g [mm²]", 2, 6, 0.01, "brightness of the lamp times exposure", true],
  ["lamp", "lamp beside the lens [mm]", -10, 10, 0.1, "to the right of the optical centre"],
  ["tilt", "tilt of the wall [°]", -60, 60, 0.5, "about the vertical"],
  ["depth", "distance of the wall [mm]", 10, 150, 0.5, "along the optical axis"],
];
const GREYS = Uint32Array.from({ length: 256 }, (_, i) => 0xFF000000 | (i << 16) | (i << 8) | i);
const FACTORS = [
  ["cos^k′ α · cosᵐ ψ", { low: 0, high: 1 }],
  ["1/d² [1/mm²], logarithmic", { low: 1 / 150 ** 2, high: 1 / 10 ** 2, log: true }],
  ["f_r(θ) [1/sr]", { low: 0, high: 0.5 }],
  ["cos θ", { low: 0, high: 1 }],
  ["L = their product times g", { low: 0, high: 1 }],
];

// L = g cos^k′ α cosᵐ ψ / d² f_r cos θ, I = L^(1/γ), of each ray that meets the plane; d from the lamp, f_r at the half
// angle of lamp and lens.
function shade({ rays, width, height }, { k, m, gamma, gain, lamp, tilt, depth }, nodes, brdf) {
  const [across, , ahead] = turned([tilt, 0])[2], size = width * height; // the normal's, away from the camera
  const maps = [0, 1, 2, 3, 4, 5].map(() => new Float32Array(size).fill(NaN)), [light, fall, f_r, slant, linear, image] = maps;
  const apart = nodes[1] - nodes[0], last = nodes.length - 1;
  for (let p = 0; p < size; p++) {
    const x = rays[3 * p], y = rays[3 * p + 1], z = rays[3 * p + 2], facing = x * across + z * ahead;
    if (!(z > 0 && facing > 0)) continue;
    const distance = depth * ahead / facing, right = distance * x - lamp, down = distance * y, far = distance * z;
    const reach = Math.sqrt(right * right + down * down + far * far), cosine = (right * across + far * ahead) / reach;
    const half = [x + right / reach, y + down / reach, z + far / reach]; // between lamp and lens
    const halfway = Math.acos(Math.min(1, Math.max(0, (half[0] * across + half[2] * ahead) / Math.hypot(...half))));
    const place = halfway / apart, node = Math.min(last - 1, Math.floor(place));
    light[p] = z ** k * (far / reach) ** m;
    fall[p] = 1 / reach ** 2;
    f_r[p] = brdf[node] + Math.min(1, place - node) * (brdf[node + 1] - brdf[node]);
    slant[p] = Math.max(0, cosine);
    linear[p] = gain * light[p] * fall[p] * f_r[p] * slant[p];
    image[p] = Math.min(1, linear[p] ** (1 / gamma));
  }
  return maps;
}

function bench(host, { width, height, packed, knobs, nodes, brdf, sheet }) {
  const bytes = Uint8Array.from(atob(packed), (letter) => letter.charCodeAt(0));
  const camera = { rays: new Float32Array(bytes.buffer), width, height }, half = Math.floor(height / 2) * width;
  const columns = Float32Array.from({ length: width }, (_, u) => u), radian = Math.PI / 180, ink = { ink: "#212121", faint: "#DDD" };
  const bar = add("div", "", host, { style: "display: grid; grid-template-columns: repeat(4, 1fr); gap: 2px 16px" });
  const state = host.bench = { knobs, brdf, image: null, misread: null, drawn: 0 };
  let kept = null, asked = false;
  const ask = () => { if (!asked) asked = requestAnimationFrame(draw); };
  for (const [name, label, low, high, step, title, log] of KNOBS) {
    const box = add("label", "", bar, { title }), line = add("div", "", box, { style: "display: flex; justify-content: space-between" });
    add("span", "", line, { textContent: label });
    const said = add("output", "", line), slider = add("input", "", box, { type: "range", min: low, max: high, step, name, style: "width: 100%" });
    slider.value = log ? Math.log10(knobs[name]) : knobs[name];
    const tell = () => { said.textContent = log ? knobs[name].toExponential(2) : String(knobs[name]); };
    slider.oninput = () => { knobs[name] = log ? 10 ** slider.value : slider.valueAsNumber; tell(); ask(); };
    tell();
  }
  const actions = add("div", "", bar, { style: "display: flex; gap: 6px; align-items: center" });
  const act = (textContent, title, onclick) => add("button", "", actions, { textContent, title, onclick: () => { onclick(); ask(); } });
  act("keep", "keep this picture, and compare what follows with it", () => { kept = state.image.slice(); });
  act("matt", "the same f_r at all angles", () => brdf.fill(brdf[0]));
  act("paper", "the sheen of printed paper", () => sheet.forEach((value, i) => { brdf[i] = value; }));
  const panel = (wide, tall, to) => {
    const box = add("div", "", to, { style: "min-width: 0" }), title = add("div", "", box, { style: "font-weight: bold" });
    const canvas = add("canvas", "", box, { width: wide, height: tall, style: "background: #B8B8B8; max-width: 100%" });
    return { title, canvas, pen: canvas.getContext("2d") };
  };
  const row = () => add("div", "", host, { style: "display: flex; align-items: flex-end; gap: 10px; margin-top: 8px" });
  const upper = row(), lower = row(), small = Math.round(186 * height / width), tall = Math.round(340 * height / width);
  const factors = FACTORS.map(([title, scale]) => {
    const one = panel(186, small, upper);
    one.title.textContent = title;
    return { ...one, scale: { ...scale, palette: GREYS } };
  });
  const picture = panel(340, tall, lower), profile = panel(300, tall, lower), curve = panel(300, tall, lower);
  curve.title.textContent = "f_r(θ): drag its nodes";
  let places = null; // where the curve's axes lie
  const chart = ({ pen, canvas }, content) => {
    pen.fillStyle = "white";
    pen.fillRect(0, 0, canvas.width, canvas.height);
    pen.font = "12px sans-serif";
    return draw_chart(pen, canvas.width, canvas.height, content, ink);
  };
  function draw() {
    asked = false;
    const maps = shade(camera, knobs, nodes, brdf), image = state.image = maps[5];
    [...factors, { ...picture, scale: { low: 0, high: 1, palette: GREYS } }].forEach(({ pen, canvas, scale }, i) => {
      pen.clearRect(0, 0, canvas.width, canvas.height);
      pen.drawImage(coloured(maps[i], scale, width, height), 0, 0, canvas.width, canvas.height);
    });
    const lines = [{ x: columns, y: image.subarray(half, half + width), colour: "#0072B2", name: kept && "now" }];
    let title = "I = L^(1/γ)";
    if (kept) {
      const off = kept.reduce((most, value, p) => Math.max(most, 255 * Math.abs(value - image[p]) || 0), 0);
      title += `: up to ${off.toFixed(1)} grey levels from the kept one`;
      lines.push({ x: columns, y: kept.subarray(half, half + width), colour: "#D55E00", name: "kept" });
    }
    picture.title.textContent = title;
    // Whoever takes the lamp to be at the lens misreads d, as light goes with 1/d²: in %, at two dots of the middle row.
    const centred = shade(camera, { ...knobs, lamp: 0 }, nodes, brdf)[4], two = [0.25, 0.75].map((share) => Math.round(share * width));
    state.misread = two.map((u) => 100 * (Math.sqrt(centred[half + u] / maps[4][half + u]) - 1));
    profile.title.textContent = `As if at the lens: d off by ${state.misread.map((off) => (Number.isFinite(off) ? off.toFixed(1) : "–")).join(" and ")} %`;
    const read = two.map((x) => ({ x, y: image[half + x], colour: "#212121" }));
    chart(profile, { x: { label: "column u [px]", low: 0, high: width }, y: { label: "I in the middle row", low: 0, high: 1.05 }, lines, dots: read });
    const angles = nodes.map((node) => node / radian), dots = angles.map((x, i) => ({ x, y: brdf[i], colour: "#0072B2" }));
    places = chart(curve, { x: { label: "incidence θ [°]", low: -3, high: 83 }, y: { label: "f_r [1/sr]", low: 0, high: 0.5 }, lines: [{ x: angles, y: brdf, colour: "#0072B2" }], dots });
    state.drawn += 1;
  }
  curve.canvas.style.touchAction = "none";
  curve.canvas.onpointerdown = (event) => { curve.canvas.setPointerCapture(event.pointerId); curve.canvas.onpointermove(event); };
  curve.canvas.onpointermove = (event) => {
    if (!curve.canvas.hasPointerCapture(event.pointerId)) return;
    const shrunk = curve.canvas.clientWidth / curve.canvas.width, { to_x, to_y } = places, [x, y] = [event.offsetX / shrunk, event.offsetY / shrunk];
    const node = Math.round((x - to_x(0)) / (to_x(nodes[1] / radian) - to_x(0)));
    if (node >= 0 && node < nodes.length) brdf[node] = Math.min(0.5, Math.max(1e-3, 0.5 * (y - to_y(0)) / (to_y(0.5) - to_y(0))));
    ask();
  };
  draw();
}
