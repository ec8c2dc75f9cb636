// The tuner's page: knobs, one row of words, six panels. Python (or the file itself, see player.js)
// sends numbers, the page draws them.
import { add_actions } from "./actions.js";
import { add } from "./drawing.js";
import { add_knobs } from "./knobs.js";
import { Panels } from "./panels.js";
import { follow_status } from "./status.js";
import { Store } from "./store.js";

/** Shows an AnyWidget; returns what ends it. @param {{model: object, el: Element}} place */
export function render({ model, el }) {
  const send = (action, ...given) => model.send({ do: action, given });
  const store = new Store(model.get("facts"), send), { now, facts } = store;
  const more = { innerHTML: facts.html, endolab: now }; // which tests read there
  const root = add("div", "endolab-tuner", el, more);
  const [lost, sight, advanced, , status] = root.firstChild.children;
  const panels = new Panels(store, root);
  add_knobs(store, sight, advanced);
  follow_status(store, status);
  const resize = () => {
    const page = el.closest(".jp-WindowedPanel-outer, .jp-Notebook");
    if (page) root.style.setProperty("--room", `${page.clientHeight - 24}px`);
    panels.resize();
  };
  const stop = add_actions(store, root, panels);
  store.on("maps", () => requestAnimationFrame(() => setTimeout(() => {
    send("painted");
    root.dispatchEvent(new CustomEvent("painted", { detail: now }));
    if (now.moving) panels.solid.draw(); // while the next picture is solved
  }, 0)));

  const watch = new ResizeObserver(resize);
  watch.observe(panels.stage);
  panels.stage.ontransitionend = resize; // of its colour: another theme
  window.addEventListener("resize", resize);
  const hear = (message, buffers) => store.hear(message, buffers);
  model.on("msg:custom", hear);
  model.on("comm_live_update", () => { lost.hidden = false; });
  // Arrows turn knobs, and fold no heading of the notebook.
  for (const one of root.querySelectorAll("input, select, button")) {
    one.dataset.lmSuppressShortcuts = "true";
  }
  resize();
  send("ready");
  return () => {
    stop();
    model.off("msg:custom", hear);
    watch.disconnect();
    window.removeEventListener("resize", resize);
    panels.solid.surface.free();
  };
}
