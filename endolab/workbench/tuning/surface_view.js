// The page's part of surface_view.py, on top of board.js.
function show_surface(root, { width, height, unit, maps }) {
  const { rays, cuts, picture, far } = Object.fromEntries(maps.map(([name, kind, text]) => [name, unpacked(kind, text)]));
  const size = add("div", "", root, { style: "position: absolute; left: 4px; bottom: 0" });
  const surface = new Surface(root, () => surface.draw()), box = box_of(far, rays);
  surface.canvas.style.cssText = "width: 100%; height: 100%; display: block; cursor: grab; touch-action: none; outline: none";
  size.textContent = said_of(box, unit);
  if (!surface.gl) return;
  surface.lay({ rays, cuts, width, height }, 1);
  surface.dress(as_picture(picture, width, height));
  surface.show(far, box);
  new ResizeObserver(() => surface.draw()).observe(root);
}
