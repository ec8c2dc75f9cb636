// Six panels: what each shows is chosen in its title.
import { follow_cursor, show_cursor } from "./cursor.js";
import { draw_curve, draw_energy } from "./curve.js";
import { add } from "./drawing.js";
import { draw_map } from "./maps.js";
import { draw_section } from "./section.js";
import { Solid } from "./solid.js";
import { COMPARED, USUAL } from "./store.js";

const CHARTS = { section: draw_section, "λ curve": draw_curve, energy: draw_energy };

// What fills an empty panel.
const FIND = ["find σ", (store) => store.find_sigma()];
const FILLS = { σ: FIND, "what determined each pixel": FIND,
  [COMPARED]: ["keep as A", (store) => store.keep()] };

export class Panels {
  /** @type {(store: Store, root: Element) => void} */
  constructor(store, root) {
    this.store = store;
    this.stage = add("div", "endolab-stage", root);
    this.colours = { ink: "", faint: "#8884" };
    this.solid = new Solid(store);
    this.cells = store.panels.map((_, place) => this.add_panel(place));
    store.on("panels", (place) => this.change(this.cells[place]));
    store.on("draw", (news) => this.draw(news));
    store.on("point", () => show_cursor(store, this.cells, this.solid));
  }

  add_panel(place) {
    const { store } = this, cell = add("div", "endolab-cell", this.stage);
    const head = add("div", "endolab-head", cell);
    const choose = add("select", "", head, { ariaLabel: "panel" });
    for (const one of new Set([...USUAL, "error", COMPARED, "energy", ...store.facts.panels])) {
      choose.add(new Option(one));
    }
    choose.value = store.panels[place];
    choose.onchange = () => store.show_in(place, choose.value);
    const title = add("span", "", head), body = add("div", "endolab-body", cell);
    const canvas = add("canvas", "", body);
    const said = add("div", "endolab-said", body, { hidden: true });
    const mark = add("div", "endolab-mark", body, { hidden: true });
    const onclick = () => FILLS[panel.name][1](store);
    const fill = add("button", "endolab-fill", body, { hidden: true, onclick });
    const parts = { choose, title, body, canvas, said, mark, fill };
    const panel = { ...parts, get name() { return store.panels[place]; } };
    follow_cursor(store, panel);
    return panel;
  }

  change(panel) {
    panel.choose.value = panel.name;
    panel.said.hidden = panel.mark.hidden = panel.fill.hidden = true;
    this.solid.view.remove();
  }

  /** Draws all panels, or those that show what is new. @param {Set<string>} [news] */
  draw(news) {
    const { store } = this, { now } = store;
    if (!now.still) return;
    for (const panel of this.cells) {
      const { name } = panel;
      if (!store.is_new(name, news)) continue;
      delete panel.map;
      if (!now.arrays.distance && name !== "frame") continue;
      if (name === "3D") this.solid.draw(panel);
      else (CHARTS[name] ?? draw_map)(store, panel, this.colours);
      const is_empty = panel.map?.empty && name in FILLS;
      panel.fill.hidden = !is_empty || now.moving || store.facts.alone;
      panel.fill.textContent = FILLS[name]?.[0];
    }
    store.tell("point");
  }

  /** Takes the size that the page leaves for them, px. */
  resize(height) {
    this.stage.style.height = `${height}px`;
    for (const panel of this.cells) {
      [panel.wide, panel.tall] = [panel.body.clientWidth, panel.body.clientHeight];
    }
    this.colours.ink = getComputedStyle(this.stage).color;
    this.draw();
  }

  /** All of them as one picture, as they are seen, under the line: a data link, PNG. */
  board() {
    const ratio = window.devicePixelRatio || 1, outer = this.stage.getBoundingClientRect();
    const canvas = document.createElement("canvas"), pen = canvas.getContext("2d"), above = 22;
    const sides = [outer.width, outer.height + above].map((side) => Math.ceil(ratio * side));
    const { surface, size } = this.solid, { now } = this.store;
    [canvas.width, canvas.height] = sides;
    pen.scale(ratio, ratio);
    pen.fillStyle = getComputedStyle(this.stage.parentNode).backgroundColor;
    pen.fillRect(0, 0, outer.width, outer.height + above);
    if (now.arrays.distance) surface.draw();
    Object.assign(pen, { font: "12px system-ui, sans-serif", textBaseline: "bottom" });
    pen.fillStyle = this.colours.ink;
    pen.fillText([this.store.headline, now.badge].filter(Boolean).join(" · "), 4, above - 3);
    pen.translate(0, above);
    for (const { name, title, body, canvas: drawn } of this.cells) {
      const { left, top, width, height } = body.getBoundingClientRect();
      const x = left - outer.left, y = top - outer.top, is_3d = name === "3D";
      pen.fillText(`${name} ${(is_3d ? size : title).textContent}`, x + 4, y - 3);
      pen.drawImage(is_3d && surface.gl ? surface.canvas : drawn, x, y, width, height);
    }
    return canvas.toDataURL();
  }
}
