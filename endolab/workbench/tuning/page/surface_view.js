// The page's part of surface_view.py.
import { add, as_picture, unpacked } from "./drawing.js";
import { box_of, said_of } from "./projection.js";
import { Surface } from "./surface.js";

/** Shows one surface in a node. @type {(root: Element, content: object) => void} */
export function show_surface(root, { width, height, unit, maps }) {
  const named = maps.map(([name, kind, text]) => [name, unpacked(kind, text)]);
  const { rays, cuts, picture, far } = Object.fromEntries(named), box = box_of(far, rays);
  const style = "position: absolute; left: 4px; bottom: 0; pointer-events: none";
  const surface = new Surface(root, () => surface.draw());
  add("div", "", root, { style, textContent: said_of(box, unit) });
  surface.canvas.style.cssText = "width: 100%; height: 100%; display: block; cursor: grab; " +
    "touch-action: none; outline: none";
  if (!surface.gl) return;
  surface.lay({ rays, cuts, width, height }, 1);
  surface.dress(as_picture(picture, width, height));
  surface.show(far, box);
  new ResizeObserver(() => surface.draw()).observe(root);
}
