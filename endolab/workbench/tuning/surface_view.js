// The page's part of surface_view.py, on top of board.js.
function render({ model, el }) {
  const root = add("div", "endolab-surface", el), size = add("div", "endolab-size", root);
  root.style.cssText = "position: relative; height: 360px; overflow: hidden; color: var(--jp-content-font-color1, #222)";
  size.style.cssText = "position: absolute; left: 4px; bottom: 0";
  const surface = new Surface(root, () => surface.draw()), facts = model.get("facts"), { width, height } = facts;
  surface.canvas.style.cssText = "width: 100%; height: 100%; display: block; cursor: grab; touch-action: none; outline: none";
  const bytes = (name) => { const { buffer, byteOffset, byteLength } = facts[name]; return buffer.slice(byteOffset, byteOffset + byteLength); };
  const map = new Float32Array(bytes("far")), rays = new Float32Array(bytes("rays")), box = box_of(map, rays);
  const watch = new ResizeObserver(() => surface.draw());
  if (surface.gl) {
    surface.lay({ rays, cuts: new Uint8Array(bytes("cuts")), width, height }, Math.ceil(Math.max(width, height) / 320));
    surface.dress(as_picture(new Uint8Array(bytes("picture")), width, height));
    surface.show(map, box);
    watch.observe(root);
  }
  size.textContent = said_of(box, facts.unit);
  return () => { watch.disconnect(); surface.free(); };
}
export default { render };
