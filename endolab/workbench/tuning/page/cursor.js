// One cursor reads all maps, the section and 3D; a press lays the section, or takes a λ.
import { short } from "./scales.js";
import { is_wiped, lay_section, leave_out, line_of } from "./sight.js";
import { see, seen, shift, spot, widen } from "./sight.js";

function hover(store, panel, event) {
  const { offsetX, offsetY, buttons, shiftKey, movementX, movementY } = event;
  const is_map = panel.map && !panel.map.empty;
  store.cursor = undefined;
  if (is_map) {
    const [x, y, w, h] = seen(store), [left, top, scale] = spot(store, panel);
    const [u, v] = [x + (offsetX - left) / scale, y + (offsetY - top) / scale];
    const is_in = u >= x && u < x + w && v >= y && v < y + h;
    if (store.wipes) {
      store.wipe = Math.max(0, Math.min(1, (u - x) / w));
      store.tell("compare");
      store.tell("draw");
    }
    store.cursor = is_in ? [Math.floor(u), Math.floor(v)] : undefined;
    const lays = buttons && !shiftKey && !store.corner && !store.wipes;
    if (lays && store.cursor) lay_section(store);
    if (buttons && shiftKey) shift(store, movementX / scale, movementY / scale);
    if (store.corner) store.tell("draw");
  }
  store.tell("point");
}

function press(store, panel, event) {
  const { axes, name } = panel;
  if (event.shiftKey) return;
  if (panel.map && store.cursor) {
    panel.canvas.setPointerCapture(event.pointerId);
    const [left, , scale] = spot(store, panel), [, , w] = seen(store);
    store.wipes = is_wiped(store, name) &&
      Math.abs(left + store.wipe * scale * w - event.offsetX) < 8;
    if (store.wipes) return;
    if (store.covers) store.corner = store.cursor;
    else lay_section(store);
    return;
  }
  if (name === "section") {
    store.cut.is_row = !store.cut.is_row;
    store.tell("draw");
  }
  if (name !== "λ curve" || !axes) return;
  const away = ({ x, y }) => Math.hypot(axes.to_x(x) - event.offsetX, axes.to_y(y) - event.offsetY);
  const [near] = [...panel.dots].sort((a, b) => away(a) - away(b));
  if (near && away(near) < 14) store.turn({ lam: near.x });
}

/** Listens to a panel's canvas. */
export function follow_cursor(store, panel) {
  const { canvas } = panel;
  canvas.onpointermove = (event) => hover(store, panel, event);
  canvas.onpointerleave = () => { store.cursor = undefined; store.tell("point"); };
  canvas.onpointerdown = (event) => press(store, panel, event);
  canvas.onpointerup = () => {
    store.wipes = false;
    if (store.corner) leave_out(store);
  };
  canvas.ondblclick = () => see(store);
  canvas.addEventListener("wheel", (event) => {
    if (!panel.map || !store.cursor) return;
    event.preventDefault();
    widen(store, 1.002 ** event.deltaY);
  }, { passive: false });
}

/** Marks the cursor in all panels, and tells what each map has there. */
export function show_cursor(store, panels, solid) {
  const { cursor, cut, now } = store, { distance, rays } = now.arrays;
  const [j, i] = cursor ?? [], p = cursor && i * now.still.width + j;
  const put = ({ mark }, left, top) => {
    mark.hidden = false;
    Object.assign(mark.style, { left: `${left}px`, top: `${top}px` });
  };
  for (const panel of panels) {
    const { map, name, axes } = panel, is_map = cursor && map && !map.empty;
    panel.said.hidden = !is_map;
    panel.mark.hidden = true;
    if (is_map) {
      const { values, unit = "" } = map, [left, top, scale] = spot(store, panel);
      const [x, y] = seen(store), known = values && values[p] === values[p];
      const told = known ? `: ${short(values[p], 4)} ${unit}` : values ? ": left out" : "";
      panel.said.textContent = `${j}, ${i}${told}`;
      put(panel, left + scale * (j + 0.5 - x), top + scale * (i + 0.5 - y));
    }
    const is_on = cursor?.[cut.is_row ? 1 : 0] === (now.still && line_of(store));
    if (is_on && name === "section" && axes && distance?.[p] > 0) {
      const across = distance[p] * rays[3 * p + (cut.is_row ? 0 : 1)];
      put(panel, axes.to_x(distance[p] * rays[3 * p + 2]), axes.to_y(across));
    }
  }
  solid.point(p);
}
