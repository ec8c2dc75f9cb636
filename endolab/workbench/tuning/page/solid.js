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
    this.view = document.createElement("div");
    this.view.className = "endolab-3d";
    const from = add("button", "", this.view, { title: "V", onclick: () => this.turn_around() });
    this.size = add("div", "endolab-size", this.view);
    const dress = add("select", "", this.view, { title: "What lies on the surface." });
    for (const one of LAID.slice(0, store.facts.alone ? 4 : 7)) dress.add(new Option(one));
    dress.onchange = () => {
      store.dress = dress.value;
      this.laid = undefined; // the cuts and the step of what is on the screen
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
    const { store, surface, view } = this, { now } = store, { distance, rays, cuts } = now.arrays;
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
    const { width, height } = now.still;
    const step = Math.ceil(Math.max(width, height) / (moves ? 80 : 320));
    if (this.laid?.cuts !== cuts || this.laid.step !== step) {
      surface.lay({ rays, cuts, width, height }, step);
    }
    if (this.laid?.cuts !== cuts || store.dress !== "frame") {
      const map = map_of(store, store.dress);
      surface.dress(canvas_of(map.empty ? map_of(store, "frame") : map, now.still));
    }
    this.laid = { cuts, step };
    const box = now.held.box ??= box_of(distance, rays);
    surface.show(distance, box);
    surface.draw(moves ? 0.5 : 1);
    panel.title.textContent = "drag to turn, shift to move, wheel to zoom once clicked";
    this.size.textContent = said_of(box, now.still.unit);
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
