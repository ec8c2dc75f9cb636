// The tuner's page: knobs, one row of words, six panels. Python (or the file itself, see player.js)
// sends numbers, the page draws them.
import { add_actions, add_help } from "./actions.js";
import { add } from "./drawing.js";
import { add_knobs } from "./knobs.js";
import { Panels } from "./panels.js";
import { add_status } from "./status.js";
import { Store } from "./store.js";

/** Shows an AnyWidget; returns what ends it. @param {{model: object, el: Element}} place */
export function render({ model, el }) {
  const root = add("div", "endolab-tuner", el), night = matchMedia("(prefers-color-scheme: dark)");
  const send = (action, ...given) => model.send({ do: action, given });
  const store = new Store(model.get("facts"), send), { now } = store;
  root.endolab = now; // tests read it here
  const lost = add("div", "endolab-lost", root, { hidden: true,
    textContent: "The tuner has ended: run its cell again, or endolab tune." });
  const names = ["knobs", "advanced endolab-knobs", "actions", "status"];
  const rows = names.map((name) => add("div", `endolab-${name}`, root));
  const [sight, advanced, actions, status] = rows, help = add_help(root);
  advanced.hidden = true;
  add_knobs(store, sight, advanced);
  add_status(store, status);
  const panels = new Panels(store, root);
  const resize = () => {
    const page = el.closest(".jp-WindowedPanel-outer, .jp-Notebook");
    const theme = document.body.dataset.jpThemeLight;
    root.classList.toggle("endolab-dark", theme ? theme === "false" : night.matches);
    const tops = [panels.stage, root].map((part) => part.getBoundingClientRect().top);
    const all = page ? page.clientHeight - 24 : window.innerHeight - 16;
    const wide = root.clientWidth, room = Math.min(all - (tops[0] - tops[1]), 0.62 * wide);
    const is_narrow = wide < 700; // two columns, to be scrolled
    root.classList.toggle("endolab-narrow", is_narrow);
    panels.resize(is_narrow ? 1.4 * wide : Math.max(300, room));
  };
  const stop = add_actions(store, actions, { el, help, advanced, panels, resize });
  store.on("maps", () => requestAnimationFrame(() => setTimeout(() => {
    send("painted");
    root.dispatchEvent(new CustomEvent("painted", { detail: now }));
    if (now.moving) panels.draw(new Set(["3D"])); // while the next picture is solved
  }, 0)));

  // The page's size and theme
  const watch = new ResizeObserver(resize), themes = new MutationObserver(resize);
  watch.observe(el);
  themes.observe(document.body, { attributeFilter: ["data-jp-theme-light"] });
  night.addEventListener("change", resize);
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
    themes.disconnect();
    night.removeEventListener("change", resize);
    window.removeEventListener("resize", resize);
    panels.solid.surface.free();
  };
}
