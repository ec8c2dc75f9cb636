// The tuner's page, on top of board.js: knobs, one row of words, six panels. Python (or the file itself, see player.js)
// sends numbers, the page draws them. What is said comes as messages of which any part may be missing:
//   maps               of each its title and keys; arrays of the same names. `painted` goes back once it is on the screen, and the
//                      next picture may come
//   still              width, height, unit, has_gain and the window of the frame; arrays picture, rays, cuts, truth
//   asked, moving      the knobs that it is the answer of, and whether it is not final
//   state              which wish it answers: what comes of an older one than the screen's is dropped
//   found              number of the light and contours that it was solved with; what is found anew has a greater one
//   sigma              how many draws are done, of how many
//   line, badge, chips, label, knobs, curve, energy, path
const HELP = { Enter: "ask anew: light, contours, scales as the knobs are now", A: "keep as A, or drop it", V: "3D from the camera, or from outside",
  "P, N": "frame before, frame after", U: "undo", R: "reset all knobs", "?": "these keys", "click on a map": "lay the section",
  "click on a dot": "take its λ", "wheel on a map": "zoom; with shift, drag it; double click for all", "a panel's title": "show something else there" };
const TYPING = "textarea, input:not([type=range]), [contenteditable=true], .cm-editor";
const USUAL = ["frame", "distance", "model - frame", "section", "3D", "λ curve"], COMPARED = "B / A - 1";
const LAID = ["frame", "distance", "model - frame", "error", "normals", "contours", "σ"]; // on the surface
const RED = "#d55e00", GREEN = "#009e73", BLUE = "#0072b2", BLACK = "#888";
const RESTS = 250; // ms without a picture, after which the hand rests
const SHARES = [50, 80, 90, 97, 99, 99.7, 99.9, 99.97];

const same = (some, others) => JSON.stringify(some) === JSON.stringify(others);

// What is typed: a number, a list of them, null where nothing is; undefined if it is none of these.
function typed(text) {
  const parts = text.split(","), values = parts.map(Number);
  if (!text.trim()) return null;
  if (!values.every(Number.isFinite) || parts.some((part) => !part.trim())) return undefined;
  return values.length > 1 ? values : values[0];
}

// Adds one knob; returns what shows a value in it. `turn` is called with another.
function knob({ name, label, tip, options, range, log, hint, first }, to, turn) {
  const box = add("div", `endolab-knob endolab-${name}`, to, { title: tip });
  add("label", "", box, { textContent: label });
  if (options) {
    const select = add("select", "", box, { ariaLabel: label });
    for (const [text, value] of options.map((one) => (Array.isArray(one) ? one : [one, one]))) {
      select.add(new Option(text, JSON.stringify(value)));
    }
    select.onchange = () => turn(JSON.parse(select.value));
    return (value) => { select.value = JSON.stringify(value); };
  }
  const line = add("input", "", box, { ariaLabel: label, placeholder: hint ?? "" });
  line.onkeydown = ({ key }) => { if (key === "Enter") line.blur(); }; // JupyterLab keeps Enter's own effect
  let present; // that is shown
  if (!range) {
    const show = (value) => { present = value; line.value = value ?? ""; };
    line.onchange = () => {
      const value = typed(line.value);
      if (value === undefined) show(present);
      else turn(value);
    };
    return show;
  }
  const [min, max, step] = range, slider = add("input", "", box, { type: "range", min, max, step, ariaLabel: label });
  const give = (value) => turn(value === first ? null : value);
  slider.oninput = () => {
    const value = Number((log ? 10 ** slider.value : Number(slider.value)).toPrecision(log ? 2 : 6));
    line.value = value;
    give(value);
  };
  const show = (value) => {
    present = value ?? first;
    line.value = Number(present.toPrecision(6));
    slider.value = log ? Math.log10(Math.max(present, 10 ** min)) : present;
  };
  line.onchange = () => {
    const value = typed(line.value);
    if (typeof value === "number") give(value);
    else show(present);
  };
  return show;
}

function render({ model, el }) {
  const root = add("div", "endolab-tuner", el), facts = model.get("facts");
  const palettes = Object.fromEntries(Object.entries(facts.palettes).map(([name, colours]) => [name, Uint32Array.from(colours)]));
  const now = root.endolab = { arrays: {}, maps: {}, knobs: {}, chips: [], held: {} }; // all that is known; tests read it here
  let kept, cursor, corner, zoom = [0, 0, 1, 1], laid, wipe = 1, cut = { is_row: false, share: 0.5 };
  const send = (action, ...given) => model.send({ do: action, given });
  const tell = (text, tone = "") => Object.assign(line, { textContent: text, title: text, className: `endolab-line ${tone}` });
  // Why a knob that needs something has nothing to turn, if so.
  const lacks = {
    energy: () => !facts.with_energy.includes(now.knobs.solver) &&
      "Off: this solver minimises no energy, which this is a part of.",
    mm: () => !now.still?.metric &&
      "Nothing says how many millimetres a distance is: give a length, behind more ....",
    gain: () => !now.still?.has_gain &&
      "Off: the gain of this endoscope is unknown, so that there is nothing to multiply.",
  };
  const show_knobs = () => {
    for (const { name, tip, needs, show, box } of shown) {
      const typing = document.activeElement; // what is being typed stays
      const is_typed = box.contains(typing) && typing.matches("input:not([type=range])");
      if (name in now.knobs && !is_typed) show(now.knobs[name]);
      const why = needs && lacks[needs]();
      box.title = why || tip;
      for (const part of box.querySelectorAll("input, select")) part.disabled = Boolean(why);
    }
  };

  // Final answers, for undo: their knobs, and the number of what was found.
  const visited = [], founds = {}; // founds: by the JSON of the knobs, what was found first with them
  let here; // the one of the visited that is wished for
  let settled, newest = -1; // the last state that was final, the greatest number
  const visit = ({ asked, found, state }) => {
    if (state === settled) return;
    settled = state;
    if (found > newest) founds[JSON.stringify(asked)] ??= found;
    newest = Math.max(newest, found);
    if (here && same(here.asked, asked)) here.found = found; // which may have been forgotten
    else visited.push(here = { asked, found });
  };
  // `how`: whether all is to be found anew, and the number of what was found that is to be used.
  const turn = (values, ...how) => {
    now.knobs = { ...now.knobs, ...values };
    here = undefined;
    show_knobs();
    send("turn", now.knobs, ...how);
  };
  const undo = () => {
    if (here === visited.at(-1) && visited.length > 1) visited.pop();
    const last = visited.at(-1);
    if (!last) return;
    turn(last.asked, false, last.found);
    here = last;
  };
  // What these options give by themselves, wherever one comes from.
  const begin_with = (options) => {
    const knobs = { ...now.knobs, ...options }, found = founds[JSON.stringify(knobs)];
    turn(knobs, found === undefined, found);
  };

  // Above the panels
  const lost = add("div", "endolab-lost", root, { hidden: true, textContent: "The tuner has ended: run its cell again, or endolab tune." });
  const [sight, advanced, actions, status] = ["knobs", "advanced endolab-knobs", "actions", "status"].map((name) => add("div", `endolab-${name}`, root));
  const keys = add("div", "endolab-keys", root, { hidden: true });
  for (const [key, does] of Object.entries(HELP)) {
    add("b", "", keys, { textContent: key });
    add("span", "", keys, { textContent: does });
  }
  keys.onclick = () => { keys.hidden = true; };
  const shown = facts.specs.map((spec) => {
    const to = spec.hidden ? advanced : sight;
    const show = knob(spec, to, (value) => turn({ [spec.name]: value }));
    return { ...spec, show, box: to.lastChild };
  });
  advanced.hidden = true;
  const button = (name, title, action, to = actions) => add("button", "", to, { textContent: name, title, onclick: action });
  const live = add("span", "endolab-live", actions, { hidden: facts.alone });
  button("ask anew", "Find light, contours and scales again, with the knobs as they are; Enter.", () => own.Enter(), live).className = "endolab-anew";
  button("undo", "Back to the knobs before; U.", () => own.u(), live);
  button("reset", "All knobs as they were at first; R.", () => own.r(), live);
  const preset = add("select", "", live, { ariaLabel: "preset",
    title: "All options at once; frame, width and what is believed of the endoscope stay." });
  for (const name of ["preset ...", ...Object.keys(facts.presets)]) preset.add(new Option(name));
  preset.onchange = () => { begin_with(facts.presets[preset.value]); preset.selectedIndex = 0; };
  const keep = button("keep as A", "Keep what is shown, to compare it with what comes; A.", () => keep_or_drop());
  button("find σ", "How far each distance can be trusted; the panel σ shows it.", () => { tell("finding σ ..."); send("sigma", now.state); }, live);
  const folder = add("input", "endolab-folder", live, { value: "tuned", ariaLabel: "folder to export into" });
  button("export", "Write what is shown into that folder: board, result, settings, recording, code.",
    () => { tell(`exporting into ${folder.value} ...`); send("export", folder.value, board()); }, live);
  const cover = button("leave out", "Then drag a rectangle on a map: what it covers is no wall, and all is asked anew; undo takes it back.",
    () => cover.classList.toggle("endolab-on"), live);
  button("more ...", "All other options.", () => { advanced.hidden = !advanced.hidden; resize(); }, live);
  button("?", "Keys.", () => { keys.hidden = !keys.hidden; });
  // What comes and goes stands behind what stays.
  const side = add("input", "endolab-wipe", actions, { type: "range", min: 0, max: 1, step: 0.01, value: 0.5, hidden: true, ariaLabel: "wipe",
    title: "Left of this the maps show A, right of it B." });
  side.oninput = () => { wipe = Number(side.value); draw(); };
  const film = add("span", "endolab-film", actions, { hidden: true });
  const play = button("▶", "Play the way of the solver to this answer, once.", () => toggle(), film);
  const place = add("input", "", film, { type: "range", min: 1, step: 1, ariaLabel: "iterate" }), says = add("span", "", film);
  const say_iterate = () => { // which of the last run is shown
    says.textContent = `iterate ${now.path[place.value - 1]} of ${now.path.at(-1)}${place.value < now.path.length ? ", still falls" : ""}`;
  };
  place.oninput = () => { say_iterate(); send("iterate", Number(place.value), now.state); };
  let playing = 0;
  const toggle = (on = !playing) => {
    clearInterval(playing);
    playing = on ? setInterval(go_on, 120) : 0;
    play.textContent = on ? "⏸" : "▶";
  };
  // To the next iterate: from the last to the first, and at the last, which is the answer, no farther.
  const go_on = () => {
    place.value = Number(place.value) % place.max + 1;
    place.oninput();
    if (place.value === place.max) toggle(false);
  };
  const offer_film = (path) => {
    film.hidden = path.length < 2;
    Object.assign(place, { max: path.length, value: path.length, disabled: false });
    play.disabled = false;
    if (!film.hidden) say_iterate();
  };
  // What belongs to an answer that goes.
  const leave_answer = () => {
    toggle(false);
    play.disabled = place.disabled = true;
    says.textContent = "";
    chips.replaceChildren();
  };
  const badge = add("span", "endolab-badge", status), line = add("span", "endolab-line", status), chips = add("span", "endolab-chips", status);

  // Panels
  const stage = add("div", "endolab-stage", root);
  const panels = USUAL.map((name) => {
    const cell = add("div", "endolab-cell", stage), head = add("div", "endolab-head", cell), choose = add("select", "", head, { ariaLabel: "panel" });
    for (const one of new Set([...USUAL, "error", COMPARED, "energy", ...facts.panels])) choose.add(new Option(one));
    choose.value = name;
    const title = add("span", "", head), body = add("div", "endolab-body", cell), canvas = add("canvas", "", body);
    const panel = { name, choose, title, body, canvas, said: add("div", "endolab-said", body, { hidden: true }), mark: add("div", "endolab-mark", body, { hidden: true }) };
    choose.onchange = () => show_in(panel, choose.value);
    canvas.onpointermove = (event) => hover(panel, event);
    canvas.onpointerleave = () => { cursor = undefined; point(); };
    canvas.onpointerdown = (event) => press(panel, event);
    canvas.onpointerup = () => { if (corner) leave_out(); };
    canvas.ondblclick = () => { zoom = [0, 0, 1, 1]; draw(); };
    canvas.addEventListener("wheel", (event) => wheel(panel, event), { passive: false });
    return panel;
  });
  const view = document.createElement("div"), from = button("from the camera", "V", () => surface.look(!surface.inside), view);
  view.className = "endolab-3d";
  const size_of_box = add("div", "endolab-size", view), dress = add("select", "", view, { title: "What lies on the surface." });
  for (const one of LAID.slice(0, facts.alone ? 4 : 7)) dress.add(new Option(one));
  dress.onchange = () => { laid = undefined; choose_maps(); };
  const surface = new Surface(view, () => { from.textContent = surface.inside ? "from outside" : "from the camera"; surface.draw(); point(); });
  const choose_maps = () => {
    send("panels", [dress.value, ...panels.map((one) => one.name)]);
    draw();
  };
  const show_in = (panel, name) => {
    panel.name = panel.choose.value = name;
    panel.said.hidden = panel.mark.hidden = true;
    view.remove();
    choose_maps();
  };
  const keep_or_drop = () => {
    const before = kept?.third; // what stood where A is compared now
    kept = kept ? undefined : { label: now.label, arrays: now.arrays, cuts: now.arrays.cuts, third: panels[2].name };
    side.hidden = !kept;
    wipe = kept ? 0.5 : 1;
    side.value = 0.5;
    keep.textContent = kept ? "drop A" : "keep as A";
    if (kept && !panels.some((one) => one.name === COMPARED)) show_in(panels[2], COMPARED);
    else if (before && panels[2].name === COMPARED) show_in(panels[2], before);
    else draw();
  };

  // What a map shows: numbers with a scale, or a picture
  let colours = { ink: "", faint: "#8884" };
  // Where colours end is held until all is asked anew; of B / A - 1, while the hand moves.
  const scaled = (name, more) => {
    const { palette, kind, unit } = facts.scales[name] ?? facts.scales.error;
    if (!now.held[name] || (name === COMPARED && !now.moving)) {
      const [first, last] = [0.01, 0.99].map((share) => percentile(more.values, share)), end = Math.max(1, percentile(more.values.map(Math.abs), 0.98)), low = Math.max(first, 1e-3 * last);
      now.held[name] = { log: [low, Math.max(last, 1.01 * low)], signed: [-end, end] }[kind] ?? [0, end];
    }
    const [low, high] = now.held[name];
    return { unit: unit ?? now.still.unit, palette: palettes[palette], low, high, log: kind === "log", ...more };
  };
  const map_of = (name, arrays = now.arrays) => {
    const { truth, distance } = arrays, spec = now.maps[name];
    if (name === "frame") return { picture: arrays.picture };
    if (name === "error") {
      if (!truth?.length) return { empty: "the truth is unknown" };
      const values = distance.map((far, p) => 100 * (far / truth[p] - 1));
      return scaled(name, { values, title: `of the distance [%], median ${short(percentile(values.map(Math.abs), 0.5), 2)}` });
    }
    if (name === COMPARED) {
      if (!kept) return { empty: "keep an answer as A first" };
      const ratio = distance.map((far, p) => far / kept.arrays.distance[p]), common = now.still.metric ? 1 : percentile(ratio, 0.5);
      return scaled(name, { values: ratio.map((one) => 100 * (one / common - 1)), title: `[%], A: ${kept.label}` });
    }
    if (!spec || spec.empty || !arrays[name]) return { empty: spec?.empty ?? "with the next answer" };
    return facts.scales[name] ? scaled(name, { ...spec, values: arrays[name] }) : { ...spec, picture: arrays[name] };
  };

  // The part of the frame that is seen, px: left, top, width, height; and where it lies in a panel.
  const seen = () => {
    const [left, top, right, bottom] = now.still.window, [w, h] = [right - left, bottom - top];
    return [left + zoom[0] * w, top + zoom[1] * h, (zoom[2] - zoom[0]) * w, (zoom[3] - zoom[1]) * h];
  };
  const spot = ({ wide, tall }) => {
    const [, , w, h] = seen(), beside = wide - 56, scale = Math.min(beside / w, tall / h);
    return [(beside - scale * w) / 2, (tall - scale * h) / 2, scale];
  };
  const pen_of = ({ canvas, wide, tall }) => {
    const ratio = window.devicePixelRatio || 1, size = [wide, tall].map((side) => Math.round(ratio * side));
    if (canvas.width !== size[0] || canvas.height !== size[1]) [canvas.width, canvas.height] = size;
    const pen = canvas.getContext("2d");
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, wide, tall);
    Object.assign(pen, { font: "11px system-ui, 'DejaVu Sans', sans-serif", lineWidth: 1, imageSmoothingEnabled: false });
    return [pen, wide, tall];
  };
  const draw_map = (panel) => {
    const { name } = panel, [pen, wide, tall] = pen_of(panel), { width, height } = now.still, { ink } = colours;
    const map = map_of(name), [left, top, scale] = spot(panel), [x, y, w, h] = seen();
    panel.map = map;
    panel.title.textContent = map.title ?? map.empty ?? "";
    if (map.empty) return;
    const canvas = (one) => (one.picture ? as_picture(one.picture, width, height) : coloured(one.values, one, width, height));
    pen.drawImage(canvas(map), x, y, w, h, left, top, scale * w, scale * h);
    if (kept && wipe < 1 && ["distance", "model - frame", "error"].includes(name)) {
      const share = wipe * w;
      pen.drawImage(canvas({ ...map, ...map_of(name, kept.arrays), low: map.low, high: map.high }), x, y, share, h, left, top, scale * share, scale * h);
      const x_wipe = left + scale * share;
      Object.assign(pen, { strokeStyle: GREEN, fillStyle: GREEN, lineWidth: 2, textBaseline: "top", textAlign: "center" });
      pen.strokeRect(x_wipe, top, 0, scale * h);
      pen.fillRect(x_wipe - 16, top, 32, 15);
      pen.fillStyle = "white";
      pen.fillText("A   B", x_wipe, top + 2);
    }
    const at = (u, v) => [left + scale * (u - x), top + scale * (v - y)];
    pen.save();
    pen.beginPath();
    pen.rect(left, top, scale * w, scale * h);
    pen.clip();
    if (name === "distance") {
      const lines = isolines(map.values, width, height, rounds(map.low, map.high, 12, true), now.moving ? 2 : 1);
      Object.assign(pen, { strokeStyle: "#fffb", lineWidth: 1 });
      pen.beginPath();
      for (let i = 0; i < lines.length; i += 4) { pen.moveTo(...at(lines[i], lines[i + 1])); pen.lineTo(...at(lines[i + 2], lines[i + 3])); }
      pen.stroke();
    }
    if (["frame", "distance"].includes(name)) {
      const place = line_of();
      Object.assign(pen, { strokeStyle: RED, lineWidth: 1.5 });
      path(pen, cut.is_row ? [0, width] : [place + 0.5, place + 0.5], cut.is_row ? [place + 0.5, place + 0.5] : [0, height], at);
    }
    if (corner && cursor) {
      const [l, t, r, b] = covered();
      Object.assign(pen, { strokeStyle: GREEN, lineWidth: 2 });
      pen.strokeRect(...at(l, t), scale * (r - l), scale * (b - t));
    }
    pen.restore();
    if (map.values) draw_bar(pen, [wide - 50, 8, 10, tall - 16], map, ink);
    (map.keys ?? []).forEach(([text, colour], i) => {
      Object.assign(pen, { fillStyle: "#000a", textBaseline: "top", textAlign: "left" }); // as the cursor's words
      pen.fillRect(0, 16 * i, pen.measureText(text).width + 24, 16);
      pen.fillStyle = `rgb(${colour})`;
      pen.fillRect(4, 3 + 16 * i, 10, 10);
      pen.fillStyle = "white";
      pen.fillText(text, 18, 3 + 16 * i);
    });
  };
  const line_of = () => Math.min(Math.floor(cut.share * (cut.is_row ? now.still.height : now.still.width)), (cut.is_row ? now.still.height : now.still.width) - 1);

  // Charts
  const brief = ({ label }) => label.split(", ").slice(0, -1).join(", ");
  const draw_section = (panel) => {
    const grid = { ...now.still, ...now.arrays }, index = line_of(), axis = "xy"[cut.is_row ? 0 : 1], { unit } = now.still;
    const lines = [{ ...section(now.arrays.distance, grid, cut.is_row, index), colour: RED, name: kept ? `B: ${brief(now)}` : "result" }];
    if (kept) lines.unshift({ ...section(kept.arrays.distance, { ...grid, cuts: kept.cuts }, cut.is_row, index), colour: GREEN, name: `A: ${brief(kept)}` });
    if (now.arrays.truth?.length) lines.unshift({ ...section(now.arrays.truth, grid, cut.is_row, index), colour: BLACK, name: "truth" });
    panel.title.textContent = `along ${cut.is_row ? "row" : "column"} ${index}`;
    const fit = lines[0];
    now.held[`${cut.is_row} ${index}`] ??= [fit.x, fit.y].map((some) => [percentile(some, 0.005), percentile(some, 0.98)]); // held as scales are
    const [[x_low, x_high], [y_low, y_high]] = now.held[`${cut.is_row} ${index}`], [more, beside] = [0.06 * (x_high - x_low), 0.1 * (y_high - y_low)];
    const [pen, wide, tall] = pen_of(panel);
    panel.axes = draw_chart(pen, wide, tall, { x: { label: `z [${unit}]`, low: x_low - more, high: x_high + 2 * more },
      y: { label: `${axis} [${unit}]`, low: y_low - beside, high: y_high + beside }, lines, equal: true, down: !cut.is_row }, colours);
  };
  const height_of = (explained) => -Math.log10(Math.min(Math.max(1 - explained, 1e-4), 0.9));
  const draw_curve = (panel) => {
    const [pen, wide, tall] = pen_of(panel), { curve } = now;
    panel.title.textContent = curve?.title ?? "";
    panel.axes = undefined; // where there are no dots, none is clicked
    if (!curve?.lams) return;
    const range = facts.specs.find((spec) => spec.name === "lam").range, has_errors = curve.errors.some((one) => one !== null);
    const most = Math.max(...curve.errors) * 1.15, y = { label: "explained [%]", low: 0.2, high: 4.1, ticks: SHARES.map((share) => [height_of(share / 100), String(share)]) };
    const lines = [{ x: curve.lams, y: curve.explained.map(height_of), colour: BLUE, name: "explained" }];
    if (has_errors) lines.push({ x: curve.lams, y: curve.errors.map((one) => one ?? NaN), colour: BLACK, name: "error [%]", right: true });
    panel.dots = curve.lams.map((lam, i) => ({ x: lam, y: height_of(curve.explained[i]), colour: lam === curve.now ? RED : BLUE,
      text: lam === curve.now ? short(lam, 2) : "" }));
    if (curve.best) panel.dots.push({ x: curve.best, y: height_of(0.99), colour: GREEN }); // the title tells it
    const rules = [{ y: height_of(0.99), colour: "#009e7388" }, ...(curve.best ? [{ x: curve.best, colour: "#009e7388" }] : [])];
    panel.axes = draw_chart(pen, wide, tall, { x: { label: "λ", low: 10 ** range[0], high: 10 ** range[1], log: true }, y, lines, dots: panel.dots, rules,
      right: has_errors ? { low: 0, high: most } : undefined }, colours);
  };
  const draw_energy = (panel) => {
    const [pen, wide, tall] = pen_of(panel), { energy } = now;
    panel.title.textContent = energy ? `${energy.k.length - 1} iterations` : "with the next answer that is solved";
    if (!energy) return;
    const lines = [["data", BLUE], ["regulariser", RED], ["energy", colours.ink]].map(([name, colour]) => ({ x: energy.k, y: energy[name], colour, name }));
    const all = lines.flatMap((one) => one.y).filter((one) => one > 0);
    draw_chart(pen, wide, tall, { x: { label: "iteration", low: energy.k[0], high: Math.max(energy.k.at(-1), energy.k[0] + 1) },
      y: { label: "energy", low: Math.min(...all) / 1.5, high: Math.max(...all) * 1.5, log: true }, lines }, colours);
  };

  // While pictures come, it has fewer points, so that it follows the hand without a graphics card, too; it is fine at rest.
  let came = 0, rest;
  const draw_surface = (panel) => {
    if (view.parentNode !== panel.body) { pen_of(panel); panel.body.append(view); }
    const moves = performance.now() < came + RESTS, { width, height } = now.still, { distance, rays, cuts } = now.arrays;
    clearTimeout(rest);
    if (moves) rest = setTimeout(() => { if (panel.name === "3D") draw_surface(panel); }, RESTS);
    if (!surface.gl) return;
    const step = Math.ceil(Math.max(width, height) / (moves ? 80 : 320)), on = dress.value;
    if (laid?.cuts !== cuts || laid.step !== step) surface.lay({ rays, cuts, width, height }, step);
    if (laid?.cuts !== cuts || on !== "frame") {
      const map = map_of(on), one = map.empty ? map_of("frame") : map;
      surface.dress(one.picture ? as_picture(one.picture, width, height) : coloured(one.values, one, width, height));
    }
    laid = { cuts, step };
    const box = now.held.box ??= box_of(distance, rays);
    surface.show(distance, box);
    surface.draw(moves ? 0.5 : 1);
    panel.title.textContent = "drag to turn, shift to move, wheel to zoom once clicked";
    size_of_box.textContent = said_of(box, now.still.unit);
  };
  const CHARTS = { section: draw_section, "λ curve": draw_curve, energy: draw_energy, "3D": draw_surface };
  const MADE_OF = { frame: "picture", section: "distance", "λ curve": "curve", error: "distance", [COMPARED]: "distance" };
  // All panels, or those that show what is new.
  const draw = (news) => {
    if (!now.still) return;
    for (const panel of panels) {
      if (news && !news.has(MADE_OF[panel.name] ?? panel.name)) continue;
      delete panel.map;
      if (now.arrays.distance || panel.name === "frame") (CHARTS[panel.name] ?? draw_map)(panel);
    }
    point();
  };

  // The cursor
  const hover = (panel, event) => {
    const [x, y, w, h] = seen(), [left, top, scale] = spot(panel);
    if (!panel.map || panel.map.empty) { cursor = undefined; point(); return; }
    const [u, v] = [x + (event.offsetX - left) / scale, y + (event.offsetY - top) / scale];
    cursor = u >= x && u < x + w && v >= y && v < y + h ? [Math.floor(u), Math.floor(v)] : undefined;
    if (event.buttons && !event.shiftKey && cursor && !corner) lay_section();
    if (event.buttons && event.shiftKey) {
      const by = [event.movementX / scale / w * (zoom[2] - zoom[0]), event.movementY / scale / h * (zoom[3] - zoom[1])];
      see(zoom.map((end, i) => end - by[i % 2]));
    }
    if (corner) draw();
    point();
  };
  const point = () => {
    const [j, i] = cursor ?? [], { width } = now.still ?? {}, p = i * width + j, { distance, rays } = now.arrays;
    for (const panel of panels) {
      const is_map = cursor && panel.map && !panel.map.empty;
      panel.said.hidden = !is_map;
      panel.mark.hidden = true;
      if (is_map) {
        const { values, unit, title } = panel.map, [left, top, scale] = spot(panel), [x, y] = seen();
        const told = !values ? "" : values[p] === values[p] ? `: ${short(values[p], 4)} ${unit ?? ""}` : ": left out";
        panel.said.textContent = `${j}, ${i}${told}`;
        Object.assign(panel.mark, { hidden: false });
        Object.assign(panel.mark.style, { left: `${left + scale * (j + 0.5 - x)}px`, top: `${top + scale * (i + 0.5 - y)}px` });
      }
      if (cursor && panel.name === "section" && panel.axes && distance?.[p] > 0) {
        const [z, across] = [distance[p] * rays[3 * p + 2], distance[p] * rays[3 * p + (cut.is_row ? 0 : 1)]];
        panel.mark.hidden = false;
        Object.assign(panel.mark.style, { left: `${panel.axes.to_x(z)}px`, top: `${panel.axes.to_y(across)}px` });
      }
      if (cursor && panel.name === "3D" && surface.box && distance?.[p] > 0) {
        const at = surface.place([0, 1, 2].map((axis) => distance[p] * rays[3 * p + axis]));
        spot3d.hidden = !at;
        if (at) Object.assign(spot3d.style, { left: `${100 * at[0]}%`, top: `${100 * at[1]}%` });
      }
    }
    if (!cursor) spot3d.hidden = true;
  };
  const spot3d = add("div", "endolab-mark", view, { hidden: true });
  const lay_section = () => {
    cut.share = cut.is_row ? (cursor[1] + 0.5) / now.still.height : (cursor[0] + 0.5) / now.still.width;
    draw();
  };
  // The rectangle from the corner to the cursor, px: left, top, right, bottom.
  const covered = () => [0, 1].map((i) => Math.min(corner[i], cursor[i])).concat([0, 1].map((i) => Math.max(corner[i], cursor[i]) + 1));
  const leave_out = () => {
    if (cursor) {
      const { width, height } = now.still, rectangle = covered().map((end, i) => end / (i % 2 ? height : width));
      turn({ left_out: [...now.knobs.left_out, rectangle] });
    }
    corner = undefined;
    cover.classList.remove("endolab-on");
    draw();
  };
  const press = (panel, event) => {
    if (event.shiftKey) return;
    if (panel.map && cursor) {
      panel.canvas.setPointerCapture(event.pointerId);
      if (cover.classList.contains("endolab-on")) corner = cursor;
      else lay_section();
      return;
    }
    if (panel.name === "section") { cut.is_row = !cut.is_row; draw(); }
    if (panel.name !== "λ curve" || !panel.axes) return;
    const away = ({ x, y }) => Math.hypot(panel.axes.to_x(x) - event.offsetX, panel.axes.to_y(y) - event.offsetY);
    const [near] = [...panel.dots].sort((a, b) => away(a) - away(b));
    if (near && away(near) < 14) turn({ lam: near.x });
  };
  const see = ([left, top, right, bottom]) => {
    const [w, h] = [Math.min(right - left, 1), Math.min(bottom - top, 1)], x = Math.max(0, Math.min(left, 1 - w)), y = Math.max(0, Math.min(top, 1 - h));
    zoom = [x, y, x + w, y + h];
    draw();
  };
  const wheel = (panel, event) => {
    if (!panel.map || !cursor) return;
    event.preventDefault();
    const [x, y, w, h] = seen(), share = [(cursor[0] - x) / w, (cursor[1] - y) / h], by = Math.min(1.002 ** event.deltaY, 1 / (zoom[2] - zoom[0]));
    const at = [0, 1].map((i) => zoom[i] + share[i] * (zoom[i + 2] - zoom[i]));
    if (by * (zoom[2] - zoom[0]) > 0.02) see(zoom.map((end, i) => at[i % 2] + by * (end - at[i % 2])));
  };

  // What is said
  const scales = {}; // what is held of colours and axes, by the number of what was found
  // Arrays of a message. A map belongs to its answer: with the next one's maps all others go.
  const take = ({ names = [], maps }, buffers) => {
    const stay = Object.entries(now.arrays).filter(([name]) => !maps || !(name in now.maps));
    const came = names.map(([name, kind], i) => {
      const { buffer, byteOffset, byteLength } = buffers[i];
      const bytes = buffer.slice(byteOffset, byteOffset + byteLength);
      return [name, kind === "f4" ? new Float32Array(bytes) : new Uint8Array(bytes)];
    });
    now.arrays = Object.fromEntries([...stay, ...came]);
  };
  const hear = (message, buffers) => {
    if (message.state < now.state) { // of another position of the knobs than the screen's
      if (message.maps) send("painted");
      return;
    }
    if (message.state > now.state) leave_answer();
    const had = message.maps ? Object.keys(now.maps) : [];
    take(message, buffers);
    Object.assign(now, message);
    if (message.anew) {
      now.held = scales[now.found] ?? {};
      if (kept && kept.arrays.distance.length !== now.arrays.distance?.length) keep_or_drop();
    }
    if (message.knobs || message.still) show_knobs();
    if (message.line !== undefined) tell(message.line, message.tone);
    if (message.sigma) tell(`finding σ: ${message.sigma.done} of ${message.sigma.of}`);
    if (message.asked && !message.moving) {
      scales[now.found] ??= now.held;
      visit(message);
    }
    badge.textContent = now.badge ?? "";
    badge.hidden = !now.badge;
    if (message.chips) {
      chips.replaceChildren(...message.chips.map(({ chip, text, panel, lam }) => {
        const one = document.createElement("button");
        Object.assign(one, { className: "endolab-chip", textContent: chip, title: text });
        one.onclick = () => {
          line.textContent = text;
          if (panel) show_in(panels[2], panel);
          if (lam) turn({ lam });
        };
        return one;
      }));
    }
    if (message.path) { toggle(false); offer_film(message.path); }
    if (message.maps) came = performance.now();
    const arrays = (message.names ?? []).map(([name]) => name);
    const is_still = message.maps && !now.moving ? ["3D"] : [];
    const news = [...arrays, ...had, ...is_still, ...Object.keys(message)];
    draw(message.still ? undefined : new Set([...news, ...Object.keys(message.maps ?? {})]));
    if (message.maps) requestAnimationFrame(() => setTimeout(() => {
      send("painted");
      root.dispatchEvent(new CustomEvent("painted", { detail: now }));
      if (now.moving) draw(new Set(["3D"])); // while the next picture is solved
    }, 0));
  };

  // The whole board as one picture, as it is seen.
  const board = () => {
    const ratio = window.devicePixelRatio || 1, outer = stage.getBoundingClientRect(), { ink } = colours;
    const canvas = document.createElement("canvas"), pen = canvas.getContext("2d");
    [canvas.width, canvas.height] = [outer.width, outer.height].map((side) => Math.ceil(ratio * side));
    pen.scale(ratio, ratio);
    pen.fillStyle = getComputedStyle(root).backgroundColor;
    pen.fillRect(0, 0, outer.width, outer.height);
    if (now.arrays.distance) surface.draw();
    for (const panel of panels) {
      const { left, top, width, height } = panel.body.getBoundingClientRect(), x = left - outer.left, y = top - outer.top;
      Object.assign(pen, { fillStyle: ink, font: "12px system-ui, sans-serif", textBaseline: "bottom" });
      pen.fillText(`${panel.name} ${panel.name === "3D" ? size_of_box.textContent : panel.title.textContent}`, x + 4, y - 3);
      pen.drawImage(panel.name === "3D" && surface.gl ? surface.canvas : panel.canvas, x, y, width, height);
    }
    return canvas.toDataURL();
  };

  // Keys work wherever the focus is but in a text field; in a notebook, as long as this cell is the active one.
  const step = (by) => {
    const scenes = facts.specs.find((spec) => spec.name === "scene").options.map(([, scene]) => scene), scene = scenes[scenes.indexOf(now.knobs.scene) + by];
    if (typeof scene === typeof now.knobs.scene) turn({ scene });
  };
  const live_keys = { Enter: () => { tell("asking anew ..."); turn({}, true); },
    n: () => step(1), p: () => step(-1), u: undo,
    r: () => begin_with({ ...facts.first, scene: now.knobs.scene }) };
  const own = { a: keep_or_drop, v: () => surface.look(!surface.inside), "?": () => { keys.hidden = !keys.hidden; }, Escape: () => { keys.hidden = true; },
    ...(facts.alone ? {} : live_keys) };
  const on_key = (event) => {
    const cell = el.closest(".jp-Cell"), with_control = event.ctrlKey || event.metaKey;
    if ((cell && !cell.classList.contains("jp-mod-active")) || event.target.closest?.(TYPING) || !el.isConnected) return;
    const does = with_control ? event.key === "z" && own.u : !event.altKey && own[event.key];
    if (!does || (event.key === "Enter" && event.target.closest?.("button, select"))) return;
    event.preventDefault();
    event.stopPropagation(); // to a notebook V means: paste a cell
    does();
  };
  document.addEventListener("keydown", on_key, true);

  // The page's size and theme
  const night = window.matchMedia("(prefers-color-scheme: dark)");
  const resize = () => {
    const page = el.closest(".jp-WindowedPanel-outer, .jp-Notebook"), theme = document.body.dataset.jpThemeLight;
    root.classList.toggle("endolab-dark", theme ? theme === "false" : night.matches);
    const above = stage.getBoundingClientRect().top - root.getBoundingClientRect().top;
    const room = (page ? page.clientHeight - 24 : window.innerHeight - 16) - above, wide = root.clientWidth;
    stage.style.height = `${Math.max(300, Math.min(room, 0.62 * wide))}px`;
    for (const panel of panels) [panel.wide, panel.tall] = [panel.body.clientWidth, panel.body.clientHeight];
    colours.ink = getComputedStyle(root).color;
    draw();
  };
  const watch = new ResizeObserver(resize), themes = new MutationObserver(resize);
  watch.observe(el);
  themes.observe(document.body, { attributeFilter: ["data-jp-theme-light"] });
  night.addEventListener("change", resize);
  window.addEventListener("resize", resize);
  model.on("msg:custom", hear);
  model.on("comm_live_update", () => { lost.hidden = false; });
  // Arrows turn knobs, and fold no heading of the notebook.
  for (const one of root.querySelectorAll("input, select, button")) one.dataset.lmSuppressShortcuts = "true";
  resize();
  send("ready");
  return () => {
    toggle(false);
    model.off("msg:custom", hear);
    watch.disconnect();
    themes.disconnect();
    night.removeEventListener("change", resize);
    window.removeEventListener("resize", resize);
    document.removeEventListener("keydown", on_key, true);
    surface.free();
  };
}
export default { render };
