// The page's part of widget.py: knobs and buttons, a line, and a picture whose maps share a cursor and whose titles
// open a list. Jupyter holds a change back while the kernel works on the last one, and then sends the latest only:
// neither a drag nor a cursor builds up a queue.
const KEYS = { a: ["keep"], b: ["blink"], d: ["show", "A beside B"], n: ["step", 1], p: ["step", -1],
  r: ["reset"], u: ["undo"], x: ["drop"] };
const HELP = { A: "keep as A, once the answer is final", B: "A or B", D: "A beside B", X: "drop A",
  C: "compare five λ, or end that", V: "3D from the camera, or from outside", "P, N": "frame before, frame after",
  U: "undo", R: "reset all knobs", "?": "these keys", "drag on a map": "lay the section",
  "wheel on a map": "zoom; with shift, drag it; double click for all", "click on a title": "show another picture" };
const TYPING = "textarea, input:not([type=range]), [contenteditable=true], .cm-editor";
const COMPARE = { "compare ...": "", "five λ": "lam", regularisers: "regulariser" };

const add = (tag, name, to, more = {}) => {
  const node = to.appendChild(document.createElement(tag));
  node.className = name;
  return Object.assign(node, more);
};

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
  const line = add("input", "", box, { ariaLabel: label, placeholder: hint ?? "" }), digits = log ? 2 : 6;
  line.onkeydown = ({ key }) => { if (key === "Enter") line.blur(); }; // JupyterLab keeps Enter's own effect
  if (!range) {
    line.onchange = () => {
      const values = line.value.split(",").map(Number), known = values.every(Number.isFinite);
      turn(line.value.trim() ? (known && (values.length > 1 ? values : values[0])) || line.value : null);
    };
    return (value) => { line.value = value ?? ""; };
  }
  const [min, max, step] = range, slider = add("input", "", box, { type: "range", min, max, step, ariaLabel: label });
  const give = (value) => turn(value === first ? null : value);
  slider.oninput = () => give(Number((log ? 10 ** slider.value : Number(slider.value)).toPrecision(digits)));
  const show = (value) => {
    line.value = Number((value ?? first).toPrecision(6));
    slider.value = log ? Math.log10(value) : value ?? first;
  };
  line.onchange = () => {
    const value = Number(line.value);
    if (line.value.trim() && Number.isFinite(value) && (!log || value > 0)) give(value);
    else slider.oninput();
  };
  return show;
}

function render({ model, el }) {
  const root = add("div", "endolab-tuner", el);
  const lost = add("div", "endolab-lost", root, { hidden: true });
  lost.textContent = "The kernel that drew this is gone: run the cell again.";
  const bars = add("div", "endolab-bars", root), stage = add("div", "endolab-stage", root);
  const image = add("img", "endolab-picture", stage, { draggable: false });
  const keys = add("div", "endolab-keys", root, { hidden: true });
  for (const [key, does] of Object.entries(HELP)) {
    add("b", "", keys, { textContent: key });
    add("span", "", keys, { textContent: does });
  }
  const show_keys = () => { keys.hidden = !keys.hidden; };
  keys.onclick = show_keys;
  const marks = add("div", "endolab-marks", stage), place3d = add("div", "endolab-3d", stage);
  const act = (...action) => model.send(action);
  const tell = (name, value) => { model.set(name, value); model.save_changes(); };
  const listen = [["comm_live_update", () => { lost.hidden = false; }]];
  const follow = (names, action) => {
    for (const name of names) listen.push([`change:${name}`, action]);
    action();
  };

  // Above the panels
  const rows = ["knobs", "actions", "advanced endolab-knobs"].map((name) => add("div", `endolab-${name}`, bars));
  const [sight, actions, advanced] = rows;
  const button = (name, title, action, to) => add("button", "", to, { textContent: name, title, onclick: action });
  const shown = model.get("specs").map((spec) => [spec.name, knob(spec, spec.hidden ? advanced : sight, (value) => {
    model.set("knobs", { ...model.get("knobs"), [spec.name]: value });
    model.save_changes();
  })]);
  follow(["knobs"], () => {
    for (const [name, show] of shown) show(model.get("knobs")[name]);
  });
  button("reset", "All knobs as they were at first.", () => act("reset"), sight);
  const status = add("div", "endolab-status", bars);
  follow(["line"], () => {
    const { text, warnings, wrong, low } = model.get("line");
    const open = [...status.querySelectorAll("[open] summary")].map((one) => one.textContent);
    status.replaceChildren();
    add("span", wrong ? "endolab-wrong" : low ? "endolab-low" : "", status, { textContent: text ?? "solving ..." });
    for (const { chip, text: sentence } of warnings ?? []) {
      const details = add("details", "endolab-chip", status, { open: open.includes(chip) });
      add("summary", "", details, { textContent: chip });
      add("div", "", details, { textContent: sentence });
    }
  });
  button("undo", "Back to the answer before; Ctrl-Z.", () => act("undo"), actions);
  const keep = button("keep as A", "Keep this answer, to compare it with what comes; key A, and X drops it.",
    () => act(model.get("shows") ? "drop" : "keep"), actions);
  const sides = ["A", "B", "A beside B"].map((side) => button(side, "What is shown; B blinks, D is both.",
    () => act("show", side), actions));
  follow(["shows"], () => {
    const shows = model.get("shows");
    keep.textContent = shows ? "drop A" : "keep as A";
    for (const side of sides) {
      side.hidden = !shows;
      side.ariaPressed = String(side.textContent === shows);
    }
  });
  const compare = add("select", "", actions, { title: "Answers side by side on one scale; a click takes one over." });
  for (const [text, what] of Object.entries(COMPARE)) compare.add(new Option(text, what));
  compare.onchange = () => act("compare", compare.value);
  follow(["compared"], () => { compare.value = model.get("compared"); });
  const preset = add("select", "", actions, { title: "All options at once." });
  for (const name of ["preset ...", ...model.get("presets")]) preset.add(new Option(name, name));
  preset.onchange = () => {
    if (preset.selectedIndex) act("preset", preset.value);
    preset.selectedIndex = 0;
  };
  const path = add("label", "endolab-path", actions, { title: "The iterates of the last run: drag to see its path." });
  const scrub = add("input", "", path, { type: "range", min: 1, ariaLabel: "iterate" }), place_in = add("span", "", path);
  scrub.oninput = () => tell("scrub", Number(scrub.value));
  follow(["path", "path_place", "path_text"], () => {
    path.hidden = model.get("path") < 2;
    scrub.max = model.get("path");
    scrub.value = model.get("path_place");
    place_in.textContent = model.get("path_text");
  });
  advanced.hidden = true;
  button("advanced", "All other knobs, and the code.", () => { advanced.hidden = !advanced.hidden; }, actions);
  const folder = add("input", "endolab-folder", actions, { value: "tuned", title: "The folder that is exported into." });
  button("export", "Write what is shown: pictures, cloud, depth, settings, code and recording.",
    () => act("export_aside", folder.value), actions);
  button("?", "All keys.", show_keys, actions);
  button("find σ", "Find how far this answer can be trusted, pixel by pixel.", () => act("find_uncertainty"), advanced);
  const code = add("textarea", "", advanced, { readOnly: true, title: "What makes the answer that is shown." });
  follow(["code"], () => { code.value = model.get("code"); });

  // JupyterLab leaves arrows to who has the focus.
  for (const one of bars.querySelectorAll("input, select, button")) one.dataset.lmSuppressShortcuts = "true";

  // The panels
  let url, cursor, held = false;
  let reads = false, waits = false; // a picture is being read; a newer one is there
  const show = () => {
    const [width, height, ratio] = model.get("size"), old = url;
    waits = reads;
    if (!width || reads) return;
    reads = true;
    url = URL.createObjectURL(new Blob([model.get("picture")], { type: "image/jpeg" }));
    image.onload = image.onerror = () => {
      URL.revokeObjectURL(old);
      reads = false;
      if (waits) show();
    };
    image.src = url;
    Object.assign(stage.style, { width: `${width / ratio}px`, height: `${height / ratio}px` });
  };
  follow(["picture"], show);
  const put = (node, [left, top, right, bottom]) => {
    const [x, y, width, height] = [left, top, right - left, bottom - top].map((share) => `${100 * share}%`);
    Object.assign(node.style, { left: x, top: y, width, height });
  };
  const point = () => {
    marks.replaceChildren();
    model.get("cells").forEach(({ spot, name }, i) => {
      if (!spot || !cursor || name === "3D") return;
      const [left, top, right, bottom] = spot, text = model.get("cursor_texts")[i];
      const x = left + cursor[0] * (right - left), y = top + cursor[1] * (bottom - top);
      put(add("div", "endolab-cross", marks), [left, y, right, y]);
      put(add("div", "endolab-cross", marks), [x, top, x, bottom]);
      if (text) put(add("div", "endolab-said", marks, { textContent: text }), [left, bottom, right, bottom]);
    });
    if (!cursor) return;
    model.get("cursor_marks").forEach(([x, y], i) => {
      if (x === undefined) return;
      put(add("div", "endolab-mark", marks), [x, y, x, y]);
      put(add("div", "endolab-said", marks, { textContent: model.get("cursor_texts")[i] }), [x, y, x, y]);
    });
  };
  follow(["cursor_texts", "cursor_marks"], point);
  follow(["cells"], () => {
    const cells = model.get("cells");
    stage.querySelectorAll("select").forEach((one) => one.remove());
    stage.dataset.cells = JSON.stringify(cells);
    place3d.hidden = true;
    cells.forEach(({ box, spot, name }, i) => {
      if (!name) return; // several answers are compared
      const select = add("select", "endolab-choose", stage, { title: "choose what this panel shows" });
      select.ariaLabel = `panel ${i + 1}`;
      for (const choice of model.get("choices")) select.add(new Option(choice, choice));
      select.value = name;
      put(select, [box[0], box[1], box[2], box[1]]);
      select.onchange = () => act("choose", i, select.value);
      if (name !== "3D") return;
      put(place3d, spot);
      place3d.hidden = false;
    });
  });
  (async () => {
    const manager = model.widget_manager, id = model.get("surface").replace("IPY_MODEL_", "");
    place3d.append((await manager.create_view(await manager.get_model(id))).el);
  })();

  const place = ({ clientX, clientY }) => {
    const box = image.getBoundingClientRect();
    return [(clientX - box.left) / box.width, (clientY - box.top) / box.height];
  };
  // What of all maps is seen: left, top, right, bottom, shares of what is seen at first.
  let part = [0, 0, 1, 1], pulled, active = !el.closest(".jp-Notebook");
  const see = (next) => {
    const sides = [0, 1].map((axis) => Math.min(next[axis + 2] - next[axis], 1));
    const start = [0, 1].map((axis) => Math.min(Math.max(next[axis], 0), 1 - sides[axis]));
    part = [...start, start[0] + sides[0], start[1] + sides[1]];
    tell("window", part);
  };
  const zoom = (event) => {
    if (!cursor || !active) return; // who only scrolls by is not held up
    event.preventDefault();
    const times = Math.max(1.002 ** event.deltaY, 0.05 / (part[2] - part[0]));
    see(part.map((end, i) => {
      const fixed = part[i % 2] + cursor[i % 2] * (part[i % 2 + 2] - part[i % 2]);
      return fixed + times * (end - fixed);
    }));
  };
  follow(["window"], () => {
    part = model.get("window");
    stage.dataset.window = part[2] - part[0];
  });
  image.addEventListener("wheel", zoom, { passive: false });
  image.ondblclick = () => see([0, 0, 1, 1]);
  image.onpointerdown = (event) => {
    active = true;
    if (event.button !== 0) return;
    image.setPointerCapture(event.pointerId);
    pulled = event.shiftKey && cursor && { at: cursor, from: part };
    held = !pulled;
    if (held) act("press", ...place(event));
  };
  image.onpointermove = (event) => {
    const [x, y] = place(event);
    const { spot } = model.get("cells").find(({ spot: one }) => one
      && one[0] <= x && x <= one[2] && one[1] <= y && y <= one[3]) ?? {};
    cursor = spot && [(x - spot[0]) / (spot[2] - spot[0]), (y - spot[1]) / (spot[3] - spot[1])];
    if (pulled && cursor) {
      const { at, from } = pulled;
      see(from.map((end, i) => end - (cursor[i % 2] - at[i % 2]) * (from[i % 2 + 2] - from[i % 2])));
    }
    point();
    tell("hover", cursor ?? []);
    if (held) tell("drag", [x, y]);
  };
  image.onpointerup = image.onpointercancel = () => { held = false; pulled = undefined; };
  image.onpointerleave = () => { cursor = undefined; point(); };

  // Keys work wherever the focus is but in a text field; in a notebook, as long as this cell is the active one.
  const press = (event) => {
    const cell = el.closest(".jp-Cell"), held_too = event.ctrlKey || event.metaKey || event.altKey;
    if (cell && !cell.classList.contains("jp-mod-active")) return;
    if (event.target.closest?.(TYPING) || !el.isConnected) return;
    let action = held_too ? undefined : KEYS[event.key];
    if (event.key === "z" && (event.ctrlKey || event.metaKey)) action = ["undo"];
    if (event.key === "c" && !held_too) action = ["compare", model.get("compared") ? "" : "lam"];
    let does = action && (() => act(...action));
    if (event.key === "v" && !held_too) does = () => place3d.querySelector("button")?.click();
    if (event.key === "?" || (event.key === "Escape" && !keys.hidden)) does = show_keys;
    if (!does) return;
    event.preventDefault();
    event.stopPropagation(); // to a notebook V means: paste a cell
    does();
  };
  document.addEventListener("keydown", press, true);

  let known = "";
  const night = window.matchMedia("(prefers-color-scheme: dark)");
  const measure = () => {
    const page = el.closest(".jp-WindowedPanel-outer, .jp-Notebook");
    const above = stage.getBoundingClientRect().top - root.getBoundingClientRect().top;
    const height = (page ? page.clientHeight - 24 : window.innerHeight - 16) - above;
    const theme = document.body.dataset.jpThemeLight;
    const dark = theme ? theme === "false" : night.matches;
    root.classList.toggle("endolab-dark", dark);
    const room = [Math.floor(el.clientWidth), Math.floor(height), window.devicePixelRatio || 1, dark];
    if (room[0] < 1 || known === room.join()) return;
    known = room.join();
    act("measure", ...room);
  };
  const watch = new ResizeObserver(measure);
  watch.observe(el);
  watch.observe(bars);
  const themes = new MutationObserver(() => measure());
  themes.observe(document.body, { attributeFilter: ["data-jp-theme-light"] });
  night.addEventListener("change", measure);
  window.addEventListener("resize", measure);
  for (const [event, action] of listen) model.on(event, action);
  return () => {
    for (const [event, action] of listen) model.off(event, action);
    watch.disconnect();
    themes.disconnect();
    night.removeEventListener("change", measure);
    window.removeEventListener("resize", measure);
    document.removeEventListener("keydown", press, true);
    URL.revokeObjectURL(url);
  };
}
export default { render };
