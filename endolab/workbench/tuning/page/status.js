// One row of words: what is held, what the answer is worth, and chips for what asks for a look.
import { add } from "./drawing.js";
import { fit, has_left } from "./sight.js";
import { COMPARED } from "./store.js";

const LEFT = { chip: "beyond the scales", fits: true,
  text: "A tenth of the surface lies beyond the colours that are held; click, or F, to fit them." };

/** Adds it. @type {(store: Store, to: Element) => void} */
export function add_status(store, to) {
  const badge = add("span", "endolab-badge", to);
  const nominal = add("span", "endolab-nominal", to, { hidden: true });
  const line = add("span", "endolab-line", to);
  nominal.textContent = "nominal camera: shape only";
  const chips = add("span", "endolab-chips", to);
  const say = (text, tone = "") =>
    Object.assign(line, { textContent: text, title: text, className: `endolab-line ${tone}` });
  const add_chip = ({ chip, text, panel, lam, fits }) => {
    const onclick = () => {
      line.textContent = text;
      if (panel === COMPARED) store.compare_with_before();
      else if (panel) store.show_in(2, panel);
      if (lam) store.turn({ lam });
      if (fits) fit(store);
    };
    const name = fits ? "endolab-chip endolab-fits" : "endolab-chip";
    add("button", name, chips, { textContent: chip, title: text, onclick });
  };
  store.on("line", say);
  store.on("leave", () => chips.replaceChildren());
  store.on("fit", () => chips.querySelector(".endolab-fits")?.remove());
  store.on("said", (message) => {
    if (message.line !== undefined) say(message.line, message.tone);
    if (message.sigma) say(`finding σ: ${message.sigma.done} of ${message.sigma.of}`);
    badge.textContent = store.now.badge ?? "";
    badge.hidden = !store.now.badge;
    nominal.hidden = !store.now.nominal;
    nominal.title = store.now.nominal ?? "";
    if (!message.chips) return;
    chips.replaceChildren();
    const all = has_left(store) ? [LEFT, ...message.chips] : message.chips;
    all.forEach(add_chip);
    let left = 0; // what finds no room is counted
    while (chips.scrollWidth > chips.clientWidth && chips.children.length > 1) {
      if (left) chips.lastChild.remove();
      chips.lastChild.remove();
      left += 1;
      const text = all.slice(-left).map((one) => one.text).join(" ");
      add_chip({ chip: `+ ${left}`, text });
    }
  });
}
