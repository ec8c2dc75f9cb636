// The tuner's panel in 3D: coarse while pictures come, fine at rest.
import { add, pen_of } from "./drawing.js";
import { canvas_of, map_of } from "./maps.js";
import { box_of, said_of } from "./projection.js";
import { Surface } from "./surface.js";

const RESTS = 250; // ms without a picture, after which the hand rests
// What can lie on it; what is found once the hand rests is asked for.
const LAID = ["frame", "distance", "model - frame", "error", "normals", "contours", "σ"];

export class Solid {
  /** @param {Store} store */
  constructor(store) {
    this.store = store;
    this.laid = []; // the cuts and the step of B and A
    this.view = document.createElement("div");
    this.view.className = "endolab-3d";
    const from = add("button", "", this.view, { title: "V", onclick: () => this.turn_around() });
    this.size = add("div", "endolab-size", this.view);
    const dress = add("select", "", this.view, { title: "What lies on the surface." });
    for (const one of LAID.slice(0, store.facts.alone ? 4 : 7)) dress.add(new Option(one));
    dress.onchange = () => {
      store.dress = dress.value;
      this.laid = [];
      store.choose_maps();
    };
    this.surface = new Surface(this.view, () => {
      from.textContent = this.surface.inside ? "from outside" : "from the camera";
      this.surface.draw();
      store.tell("point");
    });
    from.textContent = "from the camera";
    this.mark = add("div", "endolab-mark", this.view, { hidden: true });
  }

  turn_around() { this.surface.look(!this.surface.inside); }

  /** While pictures come, it has fewer points, so that it follows the hand on software, too. */
  draw(panel) {
    const { store, surface, view } = this, { now, kept } = store;
    if (view.parentNode !== panel.body) {
      pen_of(panel);
      panel.body.append(view);
    }
    const moves = performance.now() < store.came + RESTS;
    clearTimeout(this.rest);
    if (moves) {
      this.rest = setTimeout(() => { if (panel.name === "3D") this.draw(panel); }, RESTS);
    }
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
  lay({ distance, cuts, ...arrays }, step, box, which) {
    const { store, surface } = this, { still } = store.now, { rays } = store.now.arrays;
    const { cuts: laid, step: was } = this.laid[which] ?? {};
    if (laid !== cuts || was !== step) surface.lay({ ...still, rays, cuts }, step, which);
    if (laid !== cuts || store.dress !== "frame") {
      const map = map_of(store, store.dress, { distance, ...arrays });
      surface.dress(canvas_of(map.empty ? map_of(store, "frame") : map, still), which);
    }
    this.laid[which] = { cuts, step };
    surface.show(distance, box, which);
  }

  /** Marks a pixel, or none. @param {number} [p] */
  point(p) {
    const { distance, rays } = this.store.now.arrays, { mark } = this;
    const lies = this.surface.box && distance?.[p] > 0;
    const point = [0, 1, 2].map((axis) => lies && distance[p] * rays[3 * p + axis]);
    const at = lies && this.surface.place(point);
    mark.hidden = !at;
    if (at) Object.assign(mark.style, { left: `${100 * at[0]}%`, top: `${100 * at[1]}%` });
  }
}
