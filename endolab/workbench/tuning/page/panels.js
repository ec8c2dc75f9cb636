// Six panels: what each shows is chosen in its title.
import { follow_cursor, show_cursor } from "./cursor.js";
import { draw_curve, draw_energy } from "./curve.js";
import { draw_map } from "./maps.js";
import { draw_section } from "./section.js";
import { Solid } from "./solid.js";
import { COMPARED, USUAL } from "./store.js";

const CHARTS = { section: draw_section, "λ curve": draw_curve, energy: draw_energy };
// What fills an empty panel: words, and what is done.
const FIND = ["find σ", "find_sigma"];
const FILLS = { σ: FIND, "what determined each pixel": FIND, [COMPARED]: ["keep as A", "keep"] };

export class Panels {
  colours = { ink: "", faint: "#8884" };

  /** @type {(store: Store, root: Element) => void} */
  constructor(store, root) {
    const cell = root.querySelector(".endolab-cell"), stage = cell.parentNode, { panels } = store;
    const solid = new Solid(store, root.querySelector(".endolab-3d"));
    Object.assign(this, { store, stage, solid });
    solid.leave();
    for (const one of new Set([...USUAL, "error", COMPARED, "energy", ...store.facts.panels])) {
      cell.querySelector("select").add(new Option(one));
    }
    stage.append(...panels.slice(1).map(() => cell.cloneNode(true)));
    this.cells = panels.map((_, place) => this.add_panel(stage.children[place], place));
    store.on("draw", (is_look) => this.draw(is_look));
    store.on("point", () => show_cursor(store, this.cells, solid));
  }

  add_panel({ children: [head, body] }, place) {
    const { store } = this, [choose, title] = head.children;
    const [canvas, said, mark, fill] = body.children;
    const parts = { choose, title, body, canvas, said, mark, fill };
    const panel = { ...parts, get name() { return store.panels[place]; } };
    choose.onchange = () => store.show_in(place, choose.value);
    choose.value = panel.name;
    follow_cursor(store, panel);
    return panel;
  }

  /** Draws all panels; of a look, what moves with it, and 3D once the others are painted. */
  draw(is_look) {
    const { store, solid } = this, { still, arrays, moving } = store.now;
    if (!store.panels.includes("3D")) solid.leave();
    for (const panel of still ? this.cells : []) {
      const { name, choose, fill } = panel;
      if (is_look && ["frame", "3D"].includes(name)) continue;
      choose.value = name;
      delete panel.map;
      if (!arrays.distance && name !== "frame") continue;
      if (name === "3D") solid.draw(panel);
      else (CHARTS[name] ?? draw_map)(store, panel, this.colours);
      const fills = panel.map?.empty && FILLS[name];
      fill.hidden = !fills || moving || store.facts.alone;
      if (fills) [fill.textContent, fill.dataset.do] = fills;
    }
    store.tell("point");
  }

  /** Takes the size that the page leaves for them, and its colour. */
  resize() {
    for (const panel of this.cells) {
      [panel.wide, panel.tall] = [panel.body.clientWidth, panel.body.clientHeight];
    }
    this.colours.ink = getComputedStyle(this.stage).color;
    this.draw();
  }

  /** All as one picture, as they are seen, under the line: a data link, PNG. */
  board() {
    const ratio = devicePixelRatio, outer = this.stage.getBoundingClientRect();
    const canvas = document.createElement("canvas"), pen = canvas.getContext("2d"), above = 22;
    const { surface, size } = this.solid, { final, now } = this.store, { width, height } = outer;
    [canvas.width, canvas.height] = [width, height + above].map((side) => Math.ceil(ratio * side));
    pen.scale(ratio, ratio);
    pen.fillStyle = getComputedStyle(this.stage).backgroundColor;
    pen.fillRect(0, 0, width, height + above);
    if (now.arrays.distance) surface.draw();
    Object.assign(pen, { font: "12px system-ui, sans-serif", textBaseline: "bottom" });
    pen.fillStyle = this.colours.ink;
    pen.fillText([final?.line, now.badge].filter(Boolean).join(" · "), 4, above - 3);
    pen.translate(-outer.left, above - outer.top);
    for (const { name, title, body, canvas: drawn } of this.cells) {
      const { left, top, width: wide, height: tall } = body.getBoundingClientRect();
      const [words, picture] = name === "3D" ? [size, surface.canvas] : [title, drawn];
      pen.fillText(`${name} ${words.textContent}`, left + 4, top - 3);
      pen.drawImage(picture, left, top, wide, tall);
    }
    return canvas.toDataURL();
  }
}
