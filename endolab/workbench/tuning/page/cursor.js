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
    if (store.covers) {
      store.corner = store.cursor;
      return () => store.tell("draw");
    }
    lay_section(store);
    return () => { if (store.cursor) lay_section(store); };
  }
  if (name === "section") {
    store.cut.is_row = !store.cut.is_row;
    store.tell("draw");
  }
  if (name !== "λ curve" || !axes) return undefined;
  const away = ({ x: lam, y }) => Math.hypot(axes.to_x(lam) - offsetX, axes.to_y(y) - offsetY);
  const [near] = dots.sort((a, b) => away(a) - away(b));
  if (near && away(near) < 14) store.turn({ lam: near.x });
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

/** Shows a mark at a place in a panel, or in 3D. @type {(mark: Element, at?: number[]) => void} */
export function put(mark, at) {
  mark.hidden = !at;
  if (at) Object.assign(mark.style, { left: `${at[0]}px`, top: `${at[1]}px` });
}

/** Marks the cursor in all panels, and tells what each map has there. */
export function show_cursor(store, panels, solid) {
  const { cursor, cut, now } = store, { distance, rays } = now.arrays;
  const [j, i] = cursor ?? [], p = cursor && i * now.still.width + j, known = distance?.[p] > 0;
  const point = known && [0, 1, 2].map((axis) => distance[p] * rays[3 * p + axis]);
  const is_on = known && cursor[cut.is_row ? 1 : 0] === line_of(store);
  for (const { map, name, axes, said, mark, wide, tall } of panels) {
    const is_map = cursor && map && !map.empty;
    said.hidden = !is_map;
    put(mark);
    if (is_map) {
      const { values, unit = "" } = map, [left, top, scale] = spot(store, { wide, tall });
      const here = values ? values[p] : 0, known_here = here === here;
      const told = known_here ? `: ${short(here, 4)} ${unit}` : ": left out";
      said.textContent = `${j}, ${i}${values ? told : ""}`;
      put(mark, [left + scale * (j + 0.5), top + scale * (i + 0.5)]);
    }
    if (is_on && name === "section") {
      put(mark, [axes.to_x(point[2]), axes.to_y(point[cut.is_row ? 0 : 1])]);
    }
  }
  solid.point(point);
}
