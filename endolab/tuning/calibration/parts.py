"""Two parts of the page that live in it: bars to click, and sheets in space to turn with the mouse.

Both are drawn by the browser from a few numbers, so that a hand on them waits for nobody.
"""

from typing import Any

import anywidget
import traitlets as t

# Bars: a click or an arrow key chooses one, a double click or the space bar leaves it out or takes it back.
BARS = """
const NS = "http://www.w3.org/2000/svg";
function ticks(high) {
  const power = 10 ** Math.floor(Math.log10(high / 3));
  const step = power * [1, 2, 5, 10].find((factor) => factor * power >= high / 4);
  const found = [];
  for (let k = 0; k * step <= high * 1.0001; k++) found.push(Number((k * step).toPrecision(6)));
  return found;
}
function render({ model, el }) {
  el.classList.add("endolab-bars");
  el.tabIndex = 0;
  const svg = el.appendChild(document.createElementNS(NS, "svg"));
  const add = (tag, attributes, text, parent = svg) => {
    const made = parent.appendChild(document.createElementNS(NS, tag));
    for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
    if (text !== undefined) made.textContent = text;
    return made;
  };
  const choose = (index) => {
    const count = model.get("bars").length;
    if (!count) return;
    model.set("chosen", Math.min(Math.max(index, 0), count - 1));
    model.save_changes();
  };
  const toggle = (index) => {
    model.set("toggled", [index, performance.now()]);  // when, so that a second time is a change too
    model.save_changes();
  };
  const draw = () => {
    const bars = model.get("bars"), width = Math.max(el.clientWidth, 200), height = model.get("height");
    const left = 52, right = width - 8, top = 22, bottom = height - 24, level = model.get("level");
    svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
    svg.setAttribute("height", height);
    svg.replaceChildren();
    const counted = bars.filter((bar) => bar.value !== null);
    const tallest = Math.max(level, ...counted.map((bar) => bar.value), 1e-9);
    const high = 1.3 * tallest;  // with room for a number above the bar
    const y = (value) => bottom - (bottom - top) * Math.min(value / high, 1);
    add("text", { x: 4, y: 14, class: "endolab-title" }, model.get("title"));
    for (const value of ticks(high)) {
      add("line", { x1: left, x2: right, y1: y(value), y2: y(value), stroke: "#ddd" });
      add("text", { x: left - 6, y: y(value) + 4, "text-anchor": "end" }, value);
    }
    const pitch = (right - left) / Math.max(bars.length, 1), wide = Math.max(0.78 * pitch, 1);
    const letters = Math.max(...bars.map((bar) => bar.label.length), 1);
    const every = Math.max(1, Math.ceil((letters * 7 + 8) / pitch));
    bars.forEach((bar, index) => {
      const x = left + index * pitch + (pitch - wide) / 2, group = add("g", { class: "endolab-bar" });
      const chosen = index === model.get("chosen"), out = bar.state !== "counts";
      if (chosen) add("rect", { x: left + index * pitch, y: top - 2, width: pitch, height: bottom - top + 22,
                                fill: "#FFF1C2" }, undefined, group);
      const shape = (value, fill, more) => add("rect", { x, width: wide, y: y(value),
        height: Math.max(bottom - y(value), 1), fill, ...more }, undefined, group);
      if (bar.value !== null)
        shape(bar.value, out ? "#fff" : "#0072B2",
              out ? { stroke: "#888", "stroke-dasharray": "3 2" } : {});
      if (out) add("text", { x: x + wide / 2, y: bottom - 4, "text-anchor": "middle", class: "endolab-out" },
                   bar.state === "nothing found" ? "–" : "×", group);
      if (index % every === 0 || chosen)
        add("text", { x: x + wide / 2, y: bottom + 15, "text-anchor": "middle",
                      "font-weight": chosen ? "bold" : "normal",
                      opacity: !chosen && Math.abs(index - model.get("chosen")) < every ? 0 : 1 },
            bar.label, group);
      const hit = add("rect", { x: left + index * pitch, y: top, width: pitch, height: bottom - top + 20,
                                fill: "transparent", "data-index": index }, undefined, group);
      add("title", {}, bar.tip, hit);
    });
    if (counted.length && level > 0) {
      add("line", { x1: left, x2: right, y1: y(level), y2: y(level), stroke: "#D55E00",
                    "stroke-width": 1.5, "stroke-dasharray": "6 3" });
      add("text", { x: right, y: 14, "text-anchor": "end", style: "fill: #D55E00" }, model.get("said"));
    }
    bars.forEach((bar, index) => {
      if (bar.value === null || !bar.out || pitch < 8 * String(bar.out).length) return;
      const x = left + (index + 0.5) * pitch;
      add("text", { x, y: y(bar.value) - 3, "text-anchor": "middle", class: "endolab-count" }, bar.out);
    });
  };
  const indexOf = (event) => {
    const found = event.target.closest("[data-index]");
    return found ? Number(found.dataset.index) : null;
  };
  svg.onclick = (event) => {
    const index = indexOf(event);
    if (index !== null) choose(index);
  };
  svg.ondblclick = (event) => {
    const index = indexOf(event);
    if (index !== null) toggle(index);
  };
  el.onkeydown = (event) => {
    const now = model.get("chosen");
    if (event.key === "ArrowLeft") choose(now - 1);
    else if (event.key === "ArrowRight") choose(now + 1);
    else if (event.key === " " || event.key === "Delete") toggle(now);
    else return;
    event.preventDefault();
    event.stopPropagation();  // JupyterLab has other plans with these keys
  };
  const watched = ["bars", "chosen", "title", "said", "level", "height"].map((name) => `change:${name}`);
  watched.forEach((name) => model.on(name, draw));
  const size = new ResizeObserver(draw);
  size.observe(el);
  return () => {
    size.disconnect();
    watched.forEach((name) => model.off(name, draw));
  };
}
export default { render };
"""

BARS_STYLE = """
.endolab-bars { width: 100%; user-select: none; outline-offset: -2px; }
.endolab-bars svg { display: block; width: 100%; background: white; cursor: pointer; }
.endolab-bars text { font: 12px sans-serif; fill: #222; }
.endolab-bars .endolab-title { font-weight: bold; font-size: 13px; }
.endolab-bars .endolab-count { font-size: 11px; fill: #B03A00; stroke: white; stroke-width: 3px;
  paint-order: stroke; pointer-events: none; }
.endolab-bars .endolab-out { fill: #888; font-weight: bold; }
"""


class Bars(anywidget.AnyWidget):
    """A bar for each frame, of which one is chosen."""

    _esm, _css = BARS, BARS_STYLE
    # Each: label, value (None if unknown), out (a number to stand above it), state, tip.
    bars: t.List[Any] = t.List().tag(sync=True)
    chosen = t.Int(0).tag(sync=True)
    toggled: t.List[Any] = t.List().tag(sync=True)  # the bar that was clicked twice, and when
    title = t.Unicode().tag(sync=True)
    level = t.Float(0.0).tag(sync=True)  # of a line across, which `said` names
    said = t.Unicode().tag(sync=True)
    height = t.Int(130).tag(sync=True)


# Sheets in space: a drag turns them, a click chooses a frame, and then the wheel comes nearer.
SPACE = """
const COLOURS = { "counts": [0, 114, 178], "left out by hand": [136, 136, 136],
                  "left out by the fit": [213, 94, 0] };
function render({ model, el }) {
  el.classList.add("endolab-space");
  const canvas = el.appendChild(document.createElement("canvas")), pen = canvas.getContext("2d");
  canvas.tabIndex = 0;
  let size = [1, 1], drawn = [], held;
  const project = () => {
    const [azimuth, elevation, zoom] = model.get("turn"), centre = model.get("centre");
    const [a, e] = [azimuth, elevation].map((angle) => angle * Math.PI / 180);
    const scale = zoom * 0.46 * Math.min(size[0], 1.5 * size[1]) / model.get("reach");
    return ([x, y, z]) => {  // x right, y down, z forward; seen from the side, the camera looks to the right
      const [u, v, w] = [x - centre[0], y - centre[1], z - centre[2]];
      const across = w * Math.cos(a) + u * Math.sin(a), away = -w * Math.sin(a) + u * Math.cos(a);
      const down = v * Math.cos(e) - away * Math.sin(e), depth = v * Math.sin(e) + away * Math.cos(e);
      return [size[0] / 2 + scale * across, size[1] / 2 + scale * down, depth];
    };
  };
  const path = (points) => {
    pen.beginPath();
    points.forEach(([x, y], i) => (i ? pen.lineTo(x, y) : pen.moveTo(x, y)));
  };
  const write = (text, [x, y], colour = "#222", align = "left") => {
    pen.font = "12px sans-serif";
    pen.textAlign = align;
    pen.lineWidth = 3;
    pen.strokeStyle = "white";
    pen.strokeText(text, x, y);
    pen.fillStyle = colour;
    pen.fillText(text, x, y);
  };
  const draw = () => {
    const sharp = window.devicePixelRatio || 1;
    const wide = Math.max(el.clientWidth, 100);
    size = [wide, Math.round(Math.min(Math.max(0.62 * wide, 220), 460))];
    canvas.width = size[0] * sharp;
    canvas.height = size[1] * sharp;
    canvas.style.height = `${size[1]}px`;
    pen.setTransform(sharp, 0, 0, sharp, 0, 0);
    pen.fillStyle = "white";
    pen.fillRect(0, 0, ...size);
    const at = project(), chosen = model.get("chosen");
    drawn = model.get("sheets").map(([name, state, corners]) => {
      const points = corners.map(at);
      return { name, state, points, depth: points.reduce((sum, p) => sum + p[2], 0) / points.length };
    }).sort((a, b) => b.depth - a.depth);
    const haze = Math.min(0.13, 1.2 / drawn.length);
    const axis = model.get("axis");  // places along the optical axis, every so many mm
    pen.lineWidth = 1;
    pen.strokeStyle = "#999";
    path([at([0, 0, 0]), at([0, 0, axis[axis.length - 1]])]);
    pen.stroke();
    for (const { name, state, points } of drawn) {
      const picked = name === chosen, [r, g, b] = picked ? [230, 159, 0] : COLOURS[state] || [136, 136, 136];
      path([...points, points[0]]);
      const faint = state === "left out by hand" && !picked;
      pen.fillStyle = `rgba(${r}, ${g}, ${b}, ${picked ? 0.55 : faint ? 0 : haze})`;
      pen.fill();
      pen.setLineDash(faint ? [4, 3] : []);
      pen.strokeStyle = `rgba(${r}, ${g}, ${b}, ${picked ? 1 : faint ? 0.7 : Math.max(0.25, 4 * haze)})`;
      pen.lineWidth = picked ? 3 : 1;
      pen.stroke();
      pen.setLineDash([]);
      pen.beginPath();  // the sheet's upper left
      pen.arc(points[0][0], points[0][1], picked ? 4 : 2, 0, 7);
      pen.fillStyle = pen.strokeStyle;
      pen.fill();
    }
    for (const [colour, width] of [["white", 4], ["black", 1.6]]) {
      for (const lines of model.get("camera")) {
        path(lines.map(at));
        pen.strokeStyle = colour;
        pen.lineWidth = width;
        pen.stroke();
      }
    }
    for (const place of axis) {
      const p = at([0, 0, place]);
      pen.fillStyle = "#666";
      pen.fillRect(p[0] - 1.5, p[1] - 1.5, 3, 3);
      write(`${place}${place === axis[axis.length - 1] ? " mm" : ""}`, [p[0], p[1] + 14], "#555", "center");
    }
    const picked = drawn.find((sheet) => sheet.name === chosen);
    if (picked) write(chosen, [picked.points[0][0] + 7, picked.points[0][1] - 5], "#8A5A00");
    write(model.get("title"), [6, 15]);
    const corner = [26, size[1] - 26], origin = at([0, 0, 0]);
    [["x", [1, 0, 0], "#D55E00"], ["y", [0, 1, 0], "#009E73"], ["z", [0, 0, 1], "#0072B2"]].forEach(
      ([name, axis, colour]) => {
        const tip = at(axis.map((one) => one * model.get("reach") / 4));
        const [dx, dy] = [0, 1].map((i) => tip[i] - origin[i]);
        const length = 0.11 * Math.min(size[0], 1.5 * size[1]) * model.get("turn")[2] || 1;
        const end = [corner[0] + 22 * dx / length, corner[1] + 22 * dy / length];
        path([corner, end]);
        pen.strokeStyle = colour;
        pen.lineWidth = 2;
        pen.stroke();
        write(name, [end[0] + 3, end[1] + 3], colour);
      });
  };
  const place = (event) => {
    const box = canvas.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  };
  canvas.onpointerdown = (event) => {
    if (event.button !== 0) return;
    event.preventDefault();
    canvas.setPointerCapture(event.pointerId);
    canvas.focus();
    held = { from: place(event), turn: model.get("turn"), moved: false };
  };
  canvas.onpointermove = (event) => {
    if (!held) return;
    const [dx, dy] = place(event).map((now, i) => now - held.from[i]);
    if (Math.hypot(dx, dy) > 3) held.moved = true;
    if (!held.moved) return;
    const elevation = Math.min(Math.max(held.turn[1] - 0.5 * dy, -90), 90);
    model.set("turn", [held.turn[0] + 0.5 * dx, elevation, held.turn[2]]);
  };
  canvas.onpointerup = (event) => {
    if (held && !held.moved) {
      const [x, y] = place(event);
      const hit = [...drawn].reverse().filter(({ points }) => {
        path(points);
        pen.closePath();
        const sharp = window.devicePixelRatio || 1;
        return pen.isPointInPath(x * sharp, y * sharp);
      });
      if (hit.length) {  // one behind the other: the next one
        const now = hit.findIndex((sheet) => sheet.name === model.get("chosen"));
        model.set("chosen", hit[(now + 1) % hit.length].name);
      }
    }
    held = undefined;
    model.save_changes();
  };
  canvas.onpointercancel = () => { held = undefined; };
  canvas.onwheel = (event) => {
    if (canvas.getRootNode().activeElement !== canvas) return;  // the page scrolls
    event.preventDefault();
    const [azimuth, elevation, zoom] = model.get("turn");
    model.set("turn", [azimuth, elevation, Math.min(Math.max(zoom * 0.999 ** event.deltaY, 0.2), 20)]);
  };
  canvas.ondblclick = () => {
    model.set("turn", model.get("first"));
    model.save_changes();
  };
  const watched = ["sheets", "camera", "axis", "chosen", "title", "turn", "centre", "reach"];
  watched.forEach((name) => model.on(`change:${name}`, draw));
  const watch = new ResizeObserver(draw);
  watch.observe(el);
  return () => {
    watch.disconnect();
    watched.forEach((name) => model.off(`change:${name}`, draw));
  };
}
export default { render };
"""

SPACE_STYLE = """
.endolab-space { width: 100%; }
.endolab-space canvas { display: block; width: 100%; cursor: grab; touch-action: none; outline-offset: -2px; }
.endolab-space canvas:active { cursor: grabbing; }
"""
FIRST_TURN = [-35.0, 25.0, 1.0]  # from the right and a little above


class Space(anywidget.AnyWidget):
    """Sheets of paper before a camera, in its frame: x right, y down, z forward; mm."""

    _esm, _css = SPACE, SPACE_STYLE
    sheets: t.List[Any] = t.List().tag(sync=True)  # each: name of the frame, its state, corners
    camera: t.List[Any] = t.List().tag(sync=True)  # lines
    axis: t.List[Any] = t.List([0]).tag(sync=True)  # places along the optical axis that are named
    centre: t.List[Any] = t.List([0.0, 0.0, 0.0]).tag(sync=True)  # what it turns about
    reach = t.Float(1.0).tag(sync=True)  # half of what is shown
    chosen = t.Unicode().tag(sync=True)
    title = t.Unicode().tag(sync=True)
    turn: t.List[Any] = t.List(FIRST_TURN).tag(sync=True)  # azimuth and elevation, degrees; zoom
    first: t.List[Any] = t.List(FIRST_TURN).tag(sync=True)
