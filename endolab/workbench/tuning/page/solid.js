// The tuner's panel in 3D: coarse while pictures come, fine at rest.
import { put } from "./cursor.js";
import { pen_of } from "./drawing.js";
import { canvas_of, map_of } from "./maps.js";
import { box_of, said_of } from "./projection.js";
import { Surface } from "./surface.js";

const RESTS = 250; // ms without a picture, after which the hand rests

export class Solid {
  laid = []; // the pictures that lie on B and A

  /** @type {(store: Store, view: Element) => void} */
  constructor(store, view) {
    Object.assign(this, { store, view });
    const [from, dress, size, mark] = view.children;
    Object.assign(this, { size, mark });
    if (store.facts.alone) dress.length = 4; // what is found once the hand rests is asked for
    dress.onchange = () => {
      store.dress = dress.value;
      store.choose_maps();
    };
    const surface = this.surface = new Surface(view, () => {
      from.textContent = surface.inside ? "from outside" : "from the camera";
      surface.draw();
      store.tell("point");
    });
  }

  turn_around() { this.surface.look(!this.surface.inside); }

  /** While pictures come, it has fewer points, so that it follows the hand on software, too. */
  draw(panel = this.panel) {
    const { store, surface, view } = this, { now, kept } = store;
    if (!panel) return;
    if (this.panel !== panel) {
      pen_of(this.panel = panel);
      panel.body.append(view);
    }
    const moves = performance.now() < store.came + RESTS;
    clearTimeout(this.rest);
    if (moves) this.rest = setTimeout(() => this.draw(), RESTS);
    if (!surface.gl) return;
    const box = now.held.box ??= box_of(now.arrays.distance, now.arrays.rays);
    const step = Math.ceil(Math.max(now.still.width, now.still.height) / (moves ? 80 : 320));
    this.lay(now.arrays, step, box, 0);
    if (kept) this.lay(kept.arrays, step, box, 1);
    surface.draw(moves ? 0.5 : 1, kept ? store.wipe : 0);
    const how = kept ? "A left of the wipe, B right" : "drag to turn, shift to move";
    panel.title.textContent = `${how}, wheel to zoom once clicked`;
    this.size.textContent = said_of(box, now.still.unit);
  }

  // One of the two, B or A.
  lay(arrays, step, box, which) {
    const { store, surface, laid } = this, { still, arrays: { rays } } = store.now;
    const asked = map_of(store, store.dress, arrays);
    const map = asked.empty ? map_of(store, "frame") : asked;
    surface.lay({ ...still, rays, cuts: arrays.cuts }, step, which);
    if (map.values || laid[which] !== map.picture) surface.dress(canvas_of(map, still), which);
    laid[which] = map.picture;
    surface.show(arrays.distance, box, which);
  }

  /** Leaves a panel that shows something else now. */
  leave() {
    this.panel = undefined;
    this.view.remove();
  }

  /** Marks a point, or none. @param {number[]} [point] */
  point(point) { put(this.mark, point && this.surface.box && this.surface.place(point)); }
}
