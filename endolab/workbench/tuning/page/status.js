// One row of words: what is held, what the answer is worth, and chips for what asks for a look.
import { add } from "./drawing.js";

/** Adds it; returns what says a sentence there. @type {(store: Store, to: Element) => Function} */
export function add_status(store, to) {
  const badge = add("span", "endolab-badge", to), line = add("span", "endolab-line", to);
  const chips = add("span", "endolab-chips", to);
  const say = (text, tone = "") =>
    Object.assign(line, { textContent: text, title: text, className: `endolab-line ${tone}` });
  const add_chip = ({ chip, text, panel, lam }) => {
    const onclick = () => {
      line.textContent = text;
      if (panel) store.show_in(2, panel);
      if (lam) store.turn({ lam });
    };
    add("button", "endolab-chip", chips, { textContent: chip, title: text, onclick });
  };
  store.on("leave", () => chips.replaceChildren());
  store.on("said", (message) => {
    if (message.line !== undefined) say(message.line, message.tone);
    if (message.sigma) say(`finding σ: ${message.sigma.done} of ${message.sigma.of}`);
    badge.textContent = store.now.badge ?? "";
    badge.hidden = !store.now.badge;
    if (!message.chips) return;
    chips.replaceChildren();
    message.chips.forEach(add_chip);
    let left = 0; // what finds no room is counted
    while (chips.scrollWidth > chips.clientWidth && chips.children.length > 1) {
      if (left) chips.lastChild.remove();
      chips.lastChild.remove();
      left += 1;
      const text = message.chips.slice(-left).map((one) => one.text).join(" ");
      add_chip({ chip: `+ ${left}`, text });
    }
  });
  return say;
}
