
// The page's part of surface_view.py, on top of board.js.
function render({ model, el }) {
  const root = add("div", "endolab-surface", el), size = add("div", "endolab-size", root);
  root.style.cssText = "position: relative; height: 360px; overflow: hidden; color: var(--jp-content-font-color1, #222)";
  size.style.cssText = "position: absolute; left: 4px; bottom: 0";
  const surface = new Surface(root, () => surface.draw());
  surface.canvas.style.cssText = "width: 100%; height: 100%; display: block; cursor: grab; touch-action: none; outline: none";
  const bytes = (name) => { const { buffer, byteOffset, byteLength } = model.get(name); return buffer.slice(byteOffset, byteOffset + byteLength); };
  const follow = () => {
    const { width, height, unit } = model.get("facts"), map = new Float32Array(bytes("far")), rays = new Float32Array(bytes("rays"));
    if (!width || !surface.gl) return;
    surface.lay({ rays, cuts: new Uint8Array(bytes("cuts")), width, height }, Math.ceil(Math.max(width, height) / 320));
    surface.dress(as_picture(new Uint8Array(bytes("picture")), width, height));
    const box = box_of(map, rays);
    surface.show(map, box);
    size.textContent = `${box[0].map((low, axis) => short(box[1][axis] - low, 2)).join(" × ")} ${unit}, the near 95 %`;
    surface.draw();
  };
  const watch = new ResizeObserver(() => surface.draw());
  watch.observe(root);
  model.on("change:far", follow);
  follow();
  return () => { watch.disconnect(); model.off("change:far", follow); surface.free(); };
}
export default { render };
