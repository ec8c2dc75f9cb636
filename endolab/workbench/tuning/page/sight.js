// Where one looks: what of the frame is seen, where the section lies, what is left out. No DOM.

/** The part of the frame that is seen, px: left, top, width, height. */
export function seen({ now, zoom: [x, y, size] }) {
  const [left, top, right, bottom] = now.still.window, [w, h] = [right - left, bottom - top];
  return [left + x * w, top + y * h, size * w, size * h];
}

/** In a panel, px: the frame's left and top, how long its pixels are, and what is seen of it. */
export function spot(store, { wide, tall }) {
  const part = seen(store), [x, y, w, h] = part, scale = Math.min((wide - 56) / w, tall / h);
  return [(wide - 56 - scale * w) / 2 - scale * x, (tall - scale * h) / 2 - scale * y, scale, part];
}

/** Looks at a part of the frame, as far as there is one: left, top and size. */
export function see(store, x = 0, y = 0, size = 1) {
  const most = Math.min(size, 1), within = (one) => Math.max(0, Math.min(one, 1 - most));
  store.zoom = [within(x), within(y), most];
  store.tell("draw");
}

/** Moves what is seen by so many pixels of the frame. */
export function shift(store, right, down) {
  const [x, y, size] = store.zoom, [, , w, h] = seen(store);
  see(store, x - size * right / w, y - size * down / h, size);
}

/** Looks at so many times as much, about the cursor. */
export function widen(store, times) {
  const [x, y, size] = store.zoom, [left, top, w, h] = seen(store), [u, v] = store.cursor;
  const wider = Math.min(times * size, 1), more = size - wider;
  if (wider > 0.02) see(store, x + more * (u - left) / w, y + more * (v - top) / h, wider);
}

/** Whether a tenth of the surface lies beyond the colours that are held. */
export function has_left({ now: { held, arrays } }) {
  const [low, high] = held.distance ?? [0, Infinity];
  const known = (arrays.distance ?? []).filter((far) => far === far);
  return known.filter((far) => far < low || far > high).length > 0.1 * known.length;
}

/** Whether a map shows A up to the wipe. */
export const is_wiped = ({ kept }, name) =>
  kept && ["distance", "model - frame", "error"].includes(name);

/** The column or row of the section. */
export function line_of({ cut, now }) {
  const count = now.still[cut.is_row ? "height" : "width"];
  return Math.min(Math.floor(cut.share * count), count - 1);
}

/** Lays the section through the cursor. */
export function lay_section(store) {
  const { cut, cursor, now } = store, { width, height } = now.still;
  cut.share = cut.is_row ? (cursor[1] + 0.5) / height : (cursor[0] + 0.5) / width;
  store.tell("draw");
}

/** The rectangle from the corner to the cursor, px: left, top, right, bottom. */
export const covered = ({ corner, cursor }) => [
  ...corner.map((one, i) => Math.min(one, cursor[i])),
  ...corner.map((one, i) => Math.max(one, cursor[i]) + 1),
];

/** Leaves that rectangle out of the frame. */
export function leave_out(store) {
  const { width, height } = store.now.still;
  if (store.cursor) {
    const rectangle = covered(store).map((end, i) => end / (i % 2 ? height : width));
    store.turn({ left_out: [...store.now.knobs.left_out, rectangle] });
  }
  store.corner = undefined;
  store.cover(false);
}
