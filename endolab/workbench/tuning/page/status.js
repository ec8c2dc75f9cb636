// One row of words: what is held, what the answer is worth, and chips for what asks for a look.
import { add } from "./drawing.js";
import { has_left } from "./sight.js";
import { COMPARED } from "./store.js";

/** Lets it say what comes. @type {(store: Store, row: Element) => void} */
export function follow_status(store, row) {
  const [badge, nominal, line, fits, chips] = row.children;
  const say = (text, tone = "") =>
    Object.assign(line, { textContent: text, title: text, className: `endolab-line ${tone}` });
  const add_chip = ({ chip, text, panel, lam }) => {
    const onclick = () => {
      line.textContent = text;
      if (panel === COMPARED) store.compare_with_before();
      else if (panel) store.show_in(2, panel);
      if (lam) store.turn({ lam });
    };
    add("button", "endolab-chip", chips, { textContent: chip, title: text, onclick });
  };
  store.on("line", say);
  store.on("leave", () => chips.replaceChildren());
  store.on("draw", () => { fits.hidden = store.now.moving || !has_left(store); });
  store.on("said", (message) => {
    const { now } = store;
    if (message.line !== undefined) say(message.line, message.tone);
    if (message.sigma) say(`finding σ: ${message.sigma.done} of ${message.sigma.of}`);
    Object.assign(badge, { textContent: now.badge ?? "", hidden: !now.badge });
    Object.assign(nominal, { title: now.nominal ?? "", hidden: !now.nominal });
    const all = message.chips;
    if (!all) return;
    // What finds no room is counted.
    let some = all.length;
    do {
      chips.replaceChildren();
      all.slice(0, some).forEach(add_chip);
      const left = all.slice(some), text = left.map((one) => one.text).join(" ");
      if (left.length) add_chip({ chip: `+ ${left.length}`, text });
    } while (chips.scrollWidth > chips.clientWidth && --some > 0);
  });
}
