// Where one looks: what of the frame is seen, where the section lies, what is left out. No DOM.
import { WHOLE } from "./store.js";

/** The part of the frame that is seen, px: left, top, width, height. */
export function seen({ now, zoom }) {
  const [left, top, right, bottom] = now.still.window, [w, h] = [right - left, bottom - top];
  return [left + zoom[0] * w, top + zoom[1] * h, (zoom[2] - zoom[0]) * w, (zoom[3] - zoom[1]) * h];
}

/** Where that lies in a panel, px: left, top, and pixels of the panel for one of the frame. */
export function spot(store, { wide, tall }) {
  const [, , w, h] = seen(store), scale = Math.min((wide - 56) / w, tall / h);
  return [(wide - 56 - scale * w) / 2, (tall - scale * h) / 2, scale];
}

/** Looks at a part of the frame, as far as there is one. */
export function see(store, [left, top, right, bottom] = WHOLE) {
  const [w, h] = [Math.min(right - left, 1), Math.min(bottom - top, 1)];
  const x = Math.max(0, Math.min(left, 1 - w)), y = Math.max(0, Math.min(top, 1 - h));
  store.zoom = [x, y, x + w, y + h];
  store.tell("draw");
}

/** Moves what is seen by so many pixels of the frame. */
export function shift(store, right, down) {
  const { zoom } = store, [, , w, h] = seen(store);
  const by = [right / w * (zoom[2] - zoom[0]), down / h * (zoom[3] - zoom[1])];
  see(store, zoom.map((end, i) => end - by[i % 2]));
}

/** Looks at so many times as much, about the cursor. */
export function widen(store, times) {
  const { zoom, cursor } = store, [x, y, w, h] = seen(store);
  const share = [(cursor[0] - x) / w, (cursor[1] - y) / h];
  const by = Math.min(times, 1 / (zoom[2] - zoom[0]));
  const at = [0, 1].map((i) => zoom[i] + share[i] * (zoom[i + 2] - zoom[i]));
  const ends = zoom.map((end, i) => at[i % 2] + by * (end - at[i % 2]));
  if (ends[2] - ends[0] > 0.02) see(store, ends);
}

/** Lets section, box and colours fit what is shown, and holds these. */
export function fit(store) {
  store.now.held = store.scales[store.now.found] = {};
  store.tell("fit");
  store.tell("draw");
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
  store.tell("draw");
}
