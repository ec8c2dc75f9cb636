// What the tuner knows: knobs, answers, and where one looks. No DOM here: who shows any of it
// listens. What Python says and is asked for is listed in messages.json.
import { same } from "./scales.js";

/** @typedef {Object<string, any>} Knobs  values by the knobs' names */

export const USUAL = ["frame", "distance", "model - frame", "section", "3D", "λ curve"];
export const COMPARED = "B / A - 1";
export const WHOLE = [0, 0, 1, 1];
// Where arrays of what a panel shows have another name.
const MADE_OF = { frame: "picture", section: "distance", "λ curve": "curve", error: "distance",
  [COMPARED]: "distance" };

export class Store {
  /**
   * @param {object} facts  what Python says from the start
   * @param {(action: string, ...given: any[]) => void} send  asks Python for something
   */
  constructor(facts, send) {
    this.facts = facts;
    this.send = send;
    this.now = { arrays: {}, maps: {}, knobs: {}, held: {} }; // all that was said
    this.panels = [...USUAL];
    this.dress = "frame"; // on the surface
    this.kept = this.before = undefined; // A; the answer before all was asked anew
    this.wipe = 1; // share of the width that shows A
    this.zoom = WHOLE; // left, top, right, bottom: shares of what of the frame is looked at
    this.cut = { is_row: false, share: 0.5 }; // of the section
    this.cursor = this.corner = undefined; // px of the frame; of a rectangle that is dragged
    this.came = -Infinity; // when the last picture did, ms
    this.covers = false; // whether a drag leaves a rectangle out
    this.listeners = {};
    this.visited = []; // final answers, for undo: their knobs, and the number of what was found
    this.founds = {}; // by the JSON of the knobs, what was found first with them
    this.scales = {}; // what is held of colours and axes, by the number of what was found
    this.newest = -1; // the greatest number of what was found
    this.palettes = {};
    for (const name in facts.palettes) this.palettes[name] = Uint32Array.from(facts.palettes[name]);
  }

  /** Listens to knobs, leave, said, line, maps, draw, point, compare, cover, panels. */
  on(event, action) { (this.listeners[event] ??= []).push(action); }

  tell(event, ...given) { for (const action of this.listeners[event] ?? []) action(...given); }

  // Knobs

  /**
   * Turns knobs. `how`: whether all is to be found anew, and the number of what was found that is
   * to be used.
   * @param {Knobs} values
   */
  turn(values, ...how) {
    this.now.knobs = { ...this.now.knobs, ...values };
    this.here = undefined;
    this.tell("knobs");
    this.send("turn", this.now.knobs, ...how);
  }

  undo() {
    const { visited } = this;
    if (this.here === visited.at(-1) && visited.length > 1) visited.pop();
    const last = visited.at(-1);
    if (!last) return;
    this.turn(last.asked, false, last.found);
    this.here = last;
  }

  /** What these options give by themselves, wherever one comes from. @param {Knobs} options */
  begin_with(options) {
    const knobs = { ...this.now.knobs, ...options }, found = this.founds[JSON.stringify(knobs)];
    this.turn(knobs, found === undefined, found);
  }

  reset() { this.begin_with({ ...this.facts.first, scene: this.now.knobs.scene }); }

  /** Turns to another frame, or another scene, in their order: the next that can be read. */
  step(by, from = this.now.knobs.scene) {
    const { options } = this.facts.specs.find((spec) => spec.name === "scene");
    const scenes = options.map(([, one]) => one), next = scenes[scenes.indexOf(from) + by];
    const is_alike = typeof next === typeof from;
    this.stepped = is_alike ? [by, next] : undefined;
    if (is_alike) this.turn({ scene: next });
  }

  // Answers

  /** Hears Python. What comes of an older wish than the screen's is dropped. */
  hear(message, buffers) {
    const { now } = this;
    if (message.state < now.state) {
      if (message.maps) this.send("painted");
      return;
    }
    if (message.state > now.state) this.tell("leave");
    if (message.anew) this.before = { label: now.label, arrays: now.arrays };
    const had = message.maps ? Object.keys(now.maps) : [];
    this.take(message, buffers);
    Object.assign(now, message);
    const { stepped } = this;
    if (message.anew) {
      this.stepped = undefined;
      now.held = this.scales[now.found] ?? {};
      const { distance } = this.kept?.arrays ?? now.arrays;
      if (distance?.length !== now.arrays.distance?.length) this.keep();
    }
    if (message.knobs || message.still) this.tell("knobs");
    if (message.asked && !message.moving) {
      this.headline = message.line;
      this.scales[now.found] ??= now.held;
      this.visit(message);
    }
    if (message.maps) this.came = performance.now();
    this.tell("said", message);
    const arrays = (message.names ?? []).map(([name]) => name);
    const maps = Object.keys(message.maps ?? {}), is_still = message.maps && !now.moving;
    const news = [...arrays, ...had, ...(is_still ? ["3D"] : []), ...Object.keys(message), ...maps];
    this.tell("draw", message.still ? undefined : new Set(news));
    if (message.maps) this.tell("maps");
    if (message.knobs && stepped && message.knobs.scene !== stepped[1]) this.step(...stepped);
  }

  // A map belongs to its answer: with the next one's maps all others go.
  take({ names = [], maps }, buffers) {
    const { now } = this;
    const stay = Object.entries(now.arrays).filter(([name]) => !maps || !(name in now.maps));
    const came = names.map(([name, kind], i) => {
      const { buffer, byteOffset, byteLength } = buffers[i];
      const bytes = buffer.slice(byteOffset, byteOffset + byteLength);
      return [name, kind === "f4" ? new Float32Array(bytes) : new Uint8Array(bytes)];
    });
    now.arrays = Object.fromEntries([...stay, ...came]);
  }

  visit({ asked, found, state }) {
    if (state === this.settled) return;
    this.settled = state; // the last that was final
    if (found > this.newest) this.founds[JSON.stringify(asked)] ??= found;
    this.newest = Math.max(this.newest, found);
    const { here } = this; // the one of the visited that is wished for
    if (here && same(here.asked, asked)) here.found = found; // which may have been forgotten
    else this.visited.push(this.here = { asked, found });
  }

  /** Keeps an answer as A, or drops A. */
  keep({ label, arrays } = this.now) {
    const before = this.kept?.third; // what stood where A is compared now
    this.kept = this.kept ? undefined : { label, arrays, third: this.panels[2] };
    this.wipe = this.kept ? 0.5 : 1;
    this.tell("compare");
    if (this.kept && !this.panels.includes(COMPARED)) this.show_in(2, COMPARED);
    else if (before && this.panels[2] === COMPARED) this.show_in(2, before);
    else this.tell("draw");
  }

  // Panels

  cover(does) {
    this.covers = does;
    this.tell("cover");
  }

  /** Takes as A what was shown before all was asked anew. */
  compare_with_before() {
    if (this.kept) this.show_in(2, COMPARED);
    else this.keep(this.before);
  }

  find_sigma() {
    this.tell("line", "finding σ ...");
    this.send("sigma", this.now.state);
  }

  /** Shows something in a panel; 3D, which is there once, moves. */
  show_in(place, name) {
    const other = name === "3D" ? this.panels.indexOf(name) : -1;
    if (other >= 0) this.panels[other] = this.panels[place];
    this.panels[place] = name;
    if (other >= 0) this.tell("panels", other);
    this.tell("panels", place);
    this.choose_maps();
  }

  choose_maps() {
    this.send("panels", [this.dress, ...this.panels]);
    this.tell("draw");
  }

  /** Whether a panel shows what is new; all is, without a set. */
  is_new(name, news) { return !news || news.has(MADE_OF[name] ?? name); }
}
