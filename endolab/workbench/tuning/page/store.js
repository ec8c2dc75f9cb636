// What the tuner knows: knobs, answers, and where one looks. No DOM here: who shows it listens.
// What Python says and is asked for is listed in messages.json.

/** @typedef {Object<string, any>} Knobs  values by the knobs' names */

export const USUAL = ["frame", "distance", "model - frame", "section", "3D", "λ curve"];
export const COMPARED = "B / A - 1";

export class Store {
  now = { arrays: {}, maps: {}, knobs: {}, held: {} }; // all that was said
  panels = [...USUAL];
  dress = "frame"; // on the surface
  wipe = 1; // share of the width that shows A
  zoom = [0, 0, 1]; // left, top and size of what is looked at: shares of the frame
  cut = { is_row: false, share: 0.5 }; // of the section
  came = -Infinity; // when the last picture did, ms
  listeners = {};
  visited = []; // final answers, for undo: their knobs, and the number of what was found
  founds = {}; // by the JSON of the knobs, what was found with them first
  scales = {}; // what is held of colours and axes, by the number of what was found
  newest = -1; // the greatest number of what was found
  // Unknown at first: `kept`, which is A; the last `final` answer, and the one `before`; the
  // `cursor` and the `corner` of a rectangle that is dragged, px; whether a drag `covers`.

  /**
   * @param {object} facts  what Python says from the start
   * @param {(action: string, ...given: any[]) => void} send  asks Python for something
   */
  constructor(facts, send) {
    Object.assign(this, { facts, send });
    const { palettes } = facts;
    for (const name in palettes) palettes[name] = Uint32Array.from(palettes[name]);
  }

  /** Listens to knobs, leave, said, line, maps, draw, point. */
  on(event, action) { (this.listeners[event] ??= []).push(action); }

  tell(event, ...given) { for (const action of this.listeners[event] ?? []) action(...given); }

  // Knobs

  /** Turns knobs; `how`: whether all is found anew, or else with what. @param {Knobs} values */
  turn(values, ...how) {
    this.now.knobs = { ...this.now.knobs, ...values };
    this.here = undefined;
    this.tell("knobs");
    this.send("turn", this.now.knobs, ...how);
  }

  ask_anew() {
    this.tell("line", "asking anew ...");
    this.turn({}, true);
  }

  undo() {
    const { visited, here } = this;
    if (here === visited.at(-1) && visited.length > 1) visited.pop();
    const last = visited.at(-1);
    if (last) this.turn(last.asked, false, last.found);
    this.here = last;
  }

  /** What these options give by themselves, wherever one comes from. @param {Knobs} options */
  begin_with(options) {
    const found = this.founds[JSON.stringify({ ...this.now.knobs, ...options })];
    this.turn(options, found === undefined, found);
  }

  reset() { this.begin_with({ ...this.facts.first, scene: this.now.knobs.scene }); }

  /** Turns to another frame, or another scene, in their order: the next that can be read. */
  step(by, from = this.now.knobs.scene) {
    const { options } = this.facts.specs.find((spec) => spec.name === "scene");
    const scenes = options.map(([, one]) => one), next = scenes[scenes.indexOf(from) + by];
    this.stepped = typeof next === typeof from ? [by, next] : undefined;
    if (this.stepped) this.turn({ scene: next });
  }

  // Answers

  /** Hears Python. What comes of an older wish than the screen's is dropped. */
  hear(message, buffers) {
    const { now, stepped } = this, { state, maps, anew, knobs, still } = message;
    if (state < now.state) {
      if (maps) this.send("painted");
      return;
    }
    if (state > now.state) this.tell("leave");
    this.take(message, buffers);
    Object.assign(now, message);
    if (anew) {
      this.stepped = undefined;
      now.held = this.scales[now.found] ?? {};
      const size = now.arrays.distance?.length;
      if (this.kept && this.kept.arrays.distance.length !== size) this.keep();
    }
    if (knobs || still) this.tell("knobs");
    if (message.asked && !message.moving) this.visit(message);
    if (maps) this.came = performance.now();
    this.tell("said", message);
    this.tell("draw", now.moving && !still);
    if (maps) this.tell("maps");
    if (knobs && stepped && knobs.scene !== stepped[1]) this.step(...stepped);
  }

  // A map belongs to its answer: with the next one's maps all others go.
  take({ names = [], maps }, buffers) {
    const { now } = this, arrays = { ...now.arrays };
    if (maps) for (const name in now.maps) delete arrays[name];
    names.forEach(([name, kind], i) => {
      const { buffer, byteOffset, byteLength } = buffers[i];
      const bytes = buffer.slice(byteOffset, byteOffset + byteLength);
      arrays[name] = kind === "f4" ? new Float32Array(bytes) : new Uint8Array(bytes);
    });
    now.arrays = arrays;
  }

  visit({ asked, found, state, line }) {
    const { now, here } = this; // `here`: the one of the visited that is wished for
    this.scales[found] ??= now.held;
    if (state === this.settled) return;
    this.settled = state; // the last that was final
    this.before = this.final;
    this.final = { label: now.label, arrays: now.arrays, line };
    const knobs = JSON.stringify(asked);
    if (found > this.newest) this.founds[knobs] ??= found;
    this.newest = Math.max(this.newest, found);
    if (here && JSON.stringify(here.asked) === knobs) here.found = found; // maybe found again
    else if (JSON.stringify(now.knobs) === knobs) this.visited.push(this.here = { asked, found });
  }

  /** Keeps an answer as A, or drops A. */
  keep({ label, arrays } = this.now) {
    const { panels } = this, third = this.kept?.third; // what stood where A is compared now
    this.kept = third ? undefined : { label, arrays, third: panels[2] };
    this.wipe = third ? 1 : 0.5;
    if (!third && !panels.includes(COMPARED)) this.show_in(2, COMPARED);
    else if (third && panels[2] === COMPARED) this.show_in(2, third);
    else this.tell("draw");
  }

  /** Takes as A the final answer before the last one, which was found by the same knobs. */
  compare_with_before() {
    if (this.kept) this.keep();
    if (this.before) this.keep(this.before);
  }

  find_sigma() {
    this.tell("line", "finding σ ...");
    this.send("sigma", this.now.state);
  }

  // Panels

  /** Whether a drag leaves a rectangle out. */
  cover(does = !this.covers) {
    this.covers = does;
    this.tell("draw");
  }

  /** Lets section, box and colours fit what is shown, and holds these. */
  fit() {
    this.now.held = this.scales[this.now.found] = {};
    this.tell("draw");
  }

  /** Shows something in a panel; 3D, which is there once, moves. */
  show_in(place, name) {
    const { panels } = this, other = name === "3D" ? panels.indexOf(name) : -1;
    if (other >= 0) panels[other] = panels[place];
    panels[place] = name;
    this.choose_maps();
  }

  choose_maps() {
    this.send("panels", [this.dress, ...this.panels]);
    this.tell("draw");
  }
}
