// One cursor reads all maps, the section and 3D; a press lays the section, or takes a λ.
import { short } from "./scales.js";
import { is_wiped, lay_section, leave_out, line_of, see, shift, spot, widen } from "./sight.js";

// What a press does, and, on a map, so long as it is held.
function press(store, { name, axes, dots, map }, [left, , scale, [x, , w]], { offsetX, offsetY }) {
  if (map && store.cursor) {
    const wipe = (at) => {
      store.wipe = Math.max(0, Math.min(1, ((at - left) / scale - x) / w));
      store.tell("draw");
    };
    const edge = left + scale * (x + store.wipe * w);
    if (is_wiped(store, name) && Math.abs(edge - offsetX) < 8) return wipe;
    if (store.covers) store.corner = store.cursor;
    const lay = () => (store.corner ? store.tell("draw") : store.cursor && lay_section(store));
    lay();
    return lay;
  }
  if (name === "section") {
    store.cut.is_row = !store.cut.is_row;
    store.tell("draw");
  } else if (name === "λ curve" && axes) {
    const away = (dot) => Math.hypot(axes.to_x(dot.x) - offsetX, axes.to_y(dot.y) - offsetY);
    const [near] = dots.sort((one, other) => away(one) - away(other));
    if (near && away(near) < 14) store.turn({ lam: near.x });
  }
  return undefined;
}

/** Listens to a panel's canvas. */
export function follow_cursor(store, panel) {
  const { canvas } = panel;
  let drag; // what the pointer does while it is down
  canvas.onpointermove = ({ offsetX, offsetY, buttons, shiftKey, movementX, movementY }) => {
    store.cursor = undefined;
    if (panel.map && !panel.map.empty) {
      const [left, top, scale, [x, y, w, h]] = spot(store, panel);
      const [u, v] = [(offsetX - left) / scale, (offsetY - top) / scale];
      const is_in = u >= x && u < x + w && v >= y && v < y + h;
      if (is_in) store.cursor = [Math.floor(u), Math.floor(v)];
      if (buttons && shiftKey) shift(store, movementX / scale, movementY / scale);
      else if (buttons) drag?.(offsetX);
    }
    store.tell("point");
  };
  canvas.onpointerleave = () => {
    store.cursor = undefined;
    store.tell("point");
  };
  canvas.onpointerdown = (event) => {
    canvas.setPointerCapture(event.pointerId);
    if (!event.shiftKey && store.now.still) drag = press(store, panel, spot(store, panel), event);
  };
  canvas.onpointerup = () => {
    drag = undefined;
    if (store.corner) leave_out(store);
  };
  canvas.ondblclick = () => see(store);
  canvas.addEventListener("wheel", (event) => {
    if (!panel.map || !store.cursor) return;
    event.preventDefault();
    widen(store, 1.002 ** event.deltaY);
  }, { passive: false });
}

/** Shows a mark at a place, px, or hides it. @type {(mark: Element, at?: number[]) => void} */
export function put(mark, at) {
  mark.hidden = !at;
  if (at) Object.assign(mark.style, { left: `${at[0]}px`, top: `${at[1]}px` });
}

/** Marks the cursor in all panels, and tells what each map has there. */
export function show_cursor(store, panels, solid) {
  const { cursor, cut, now } = store, { distance, rays } = now.arrays, across = cut.is_row ? 0 : 1;
  const [j, i] = cursor ?? [], p = cursor && i * now.still.width + j;
  const point = distance?.[p] > 0 && [0, 1, 2].map((axis) => distance[p] * rays[3 * p + axis]);
  const is_on = point && cursor[1 - across] === line_of(store);
  for (const { map, name, axes, said, mark, wide, tall } of panels) {
    const { values, empty, unit = "" } = map ?? {}, is_map = cursor && map && !empty;
    const [left, top, scale] = is_map ? spot(store, { wide, tall }) : [];
    const lies = is_on && name === "section" && [axes.to_x(point[2]), axes.to_y(point[across])];
    put(mark, is_map ? [left + scale * (j + 0.5), top + scale * (i + 0.5)] : lies);
    const value = values?.[p] ?? 0;
    const told = value === value ? `${short(value, 4)} ${unit}` : "left out";
    said.textContent = `${j}, ${i}${values ? `: ${told}` : ""}`;
    said.hidden = !is_map;
  }
  solid.point(point);
}
