// Charts of λ, and of a run.
import { draw_chart } from "./chart.js";
import { BLACK, BLUE, GREEN, pen_of, RED } from "./drawing.js";
import { height_of, short } from "./scales.js";

const SHARES = [50, 80, 90, 97, 99, 99.7, 99.9, 99.97]; // %, beside the axis
const RULE = "#009e7388";

/** Draws what each λ explains that was tried, and its error; a dot is clicked to take its λ. */
export function draw_curve({ now: { curve }, facts }, panel, colours) {
  const pen = pen_of(panel);
  panel.title.textContent = curve?.title ?? "";
  panel.axes = undefined; // where there are no dots, none is clicked
  if (!curve?.lams) return;
  const { lams, explained, errors, best, now } = curve;
  const { range } = facts.specs.find((spec) => spec.name === "lam");
  const x = { label: "λ", low: 10 ** range[0], high: 10 ** range[1], log: true };
  const ticks = SHARES.map((share) => [height_of(share / 100), String(share)]);
  const y = { label: "explained [%]", low: 0.2, high: 4.1, ticks }, enough = height_of(0.99);
  const lines = [{ x: lams, y: explained.map(height_of), colour: BLUE, name: "explained" }];
  const rules = [{ y: enough, colour: RULE }];
  let right;
  if (errors.some((one) => one !== null)) {
    const known = errors.map((one) => one ?? NaN);
    lines.push({ x: lams, y: known, colour: BLACK, name: "error [%]", right: true });
    right = { low: 0, high: Math.max(...errors) * 1.15 };
  }
  const dots = panel.dots = lams.map((lam, i) => ({ x: lam, y: height_of(explained[i]),
    ...(lam === now ? { colour: RED, text: short(lam, 2) } : { colour: BLUE }) }));
  if (best) { // the title tells it
    dots.push({ x: best, y: enough, colour: GREEN });
    rules.push({ x: best, colour: RULE });
  }
  const content = { x, y, right, lines, dots, rules };
  panel.axes = draw_chart(pen, panel.wide, panel.tall, content, colours);
}

/** Draws how the energy of a run fell. */
export function draw_energy({ now: { energy } }, panel, colours) {
  const pen = pen_of(panel), none = "with the next answer that is solved";
  panel.title.textContent = energy ? `${energy.k.length - 1} iterations` : none;
  if (!energy) return;
  const names = [["data", BLUE], ["regulariser", RED], ["energy", colours.ink]];
  const lines = names.map(([name, colour]) => ({ x: energy.k, y: energy[name], colour, name }));
  const all = lines.flatMap((one) => one.y).filter((one) => one > 0), [first] = energy.k;
  const x = { label: "iteration", low: first, high: Math.max(energy.k.at(-1), first + 1) };
  const [low, high] = [Math.min(...all) / 1.5, Math.max(...all) * 1.5];
  const y = { label: "energy", low, high, log: true };
  draw_chart(pen, panel.wide, panel.tall, { x, y, lines }, colours);
}
