// Shows one widget. The widgets' own script was written for the classic notebook: what it asks of that is
// here, a loader of AMD modules, comms over a WebSocket, and the few parts of a notebook that it touches.
"use strict";

// Modules ---------------------------------------------------------------------------------
const urls = { widgets: "widgets.js", anywidget: "anywidget.js" };
const alias = { "@jupyter-widgets/base": "widgets", "@jupyter-widgets/controls": "widgets" };
const modules = new Map();
let defined;

window.define = (...given) => { defined = [given.length > 1 ? given.at(-2) : [], given.at(-1)]; };
window.define.amd = {};

function module(name) {
  const key = alias[name] ?? name;
  if (!modules.has(key)) modules.set(key, fetched(key));
  return modules.get(key);
}

async function fetched(name) {
  if (!(name in urls)) throw new Error(`there is no module ${name}`);
  await new Promise((done, failed) => {
    const script = document.head.appendChild(document.createElement("script"));
    script.onload = done;
    script.onerror = () => failed(new Error(`${name} cannot be loaded`));
    script.src = urls[name];
  });
  const [needs, make] = defined;  // a script's event comes before the next script runs
  return make(...(await Promise.all(needs.map(module))));
}

window.require = window.requirejs = (names, done, failed) => {
  Promise.all(names.map(module)).then((found) => done?.(...found), failed);
};
window.requirejs.config = () => {};

// Messages --------------------------------------------------------------------------------
const channel = new WebSocket(`ws://${location.host}/channel`);
channel.binaryType = "arraybuffer";
const told = new Map();  // by its id, who wants to know that a message was done

function packed(message, buffers = []) {
  const bytes = (b) => (ArrayBuffer.isView(b) ? new Uint8Array(b.buffer, b.byteOffset, b.byteLength)
    : new Uint8Array(b));
  const parts = [new TextEncoder().encode(JSON.stringify(message)), ...buffers.map(bytes)];
  const head = new DataView(new ArrayBuffer(4 * (parts.length + 1)));
  head.setUint32(0, parts.length, true);
  parts.forEach((part, i) => head.setUint32(4 * (i + 1), part.byteLength, true));
  return new Blob([head, ...parts]);
}

function unpacked(content) {
  const head = new DataView(content), count = head.getUint32(0, true), parts = [];
  for (let i = 0, start = 4 * (count + 1); i < count; i += 1) {
    const length = head.getUint32(4 * (i + 1), true);
    parts.push(new DataView(content, start, length));
    start += length;
  }
  return [JSON.parse(new TextDecoder().decode(parts[0])), parts.slice(1)];
}

function send(type, content, callbacks, metadata, buffers) {
  const id = crypto.randomUUID();
  if (callbacks?.iopub?.status) told.set(id, callbacks.iopub.status);
  if (channel.readyState === WebSocket.OPEN) {
    channel.send(packed({ type, id, content, metadata: metadata ?? {} }, buffers));
  }
  return id;
}

class Comm {
  constructor(target_name, comm_id) {
    Object.assign(this, { target_name, comm_id, early: [] });
  }
  open(data, callbacks, metadata, buffers) {
    const { comm_id, target_name } = this;
    return send("comm_open", { comm_id, target_name, data: data ?? {} }, callbacks, metadata, buffers);
  }
  send(data, callbacks, metadata, buffers) {
    return send("comm_msg", { comm_id: this.comm_id, data }, callbacks, metadata, buffers);
  }
  close(data, callbacks, metadata, buffers) {
    comms.known.delete(this.comm_id);
    return send("comm_close", { comm_id: this.comm_id, data: data ?? {} }, callbacks, metadata, buffers);
  }
  on_msg(callback) {
    this.callback = callback;
    this.early.splice(0).forEach(callback);
  }
  on_close(callback) { this.closed = callback; }
  // What comes before its widget is made waits: it is newer than what the widget is made of.
  take(message) { if (this.callback) this.callback(message); else this.early.push(message); }
}

const comms = {
  known: new Map(),
  early: new Map(),
  targets: {},
  register_target(name, callback) { this.targets[name] = callback; },
  register_comm(comm) {
    comm.kernel = kernel;
    this.known.set(comm.comm_id, comm);
    comm.early.push(...(this.early.get(comm.comm_id) ?? []));
    this.early.delete(comm.comm_id);
    return comm.comm_id;
  },
  // With all six names, for the widgets' script counts them.
  new_comm(target_name, data, callbacks, metadata, comm_id, buffers) {
    const comm = new Comm(target_name, comm_id);
    this.register_comm(comm);
    comm.open(data, callbacks, metadata, buffers);
    return comm;
  },
  take(message) {
    const { comm_id, target_name } = message.content, comm = this.known.get(comm_id);
    if (message.msg_type === "comm_open") {
      const made = new Comm(target_name, comm_id);
      this.register_comm(made);
      this.targets[target_name]?.(made, message);
    } else if (message.msg_type === "comm_close") {
      this.known.delete(comm_id);
      comm?.closed?.(message);
    } else if (comm) {
      comm.take(message);
    } else {
      if (!this.early.has(comm_id)) this.early.set(comm_id, []);
      this.early.get(comm_id).push(message);
    }
  },
};

const kernel = { comm_manager: comms, is_connected: () => true };
comms.kernel = kernel;

// A notebook ------------------------------------------------------------------------------
const nothing = () => {};
const events = { on: nothing };
const shell = document.createElement("div");  // where the script puts a menu
shell.innerHTML = '<ul hidden><li><a id="help_menu"></a></li></ul>';
document.body.append(shell);
window.Jupyter = {
  version: "6.5.0",
  notification_area: { widget: nothing },
  menubar: { actions: { register: nothing, get: nothing } },
  keyboard_manager: { actions: { register: nothing } },
  notebook: { kernel, events, metadata: {}, container: { on: nothing }, get_cells: () => [],
    keyboard_manager: { actions: { register: nothing }, register_events: nothing } },
};
const area = { OutputArea: class { register_mime_type() {} } };
for (const [name, value] of Object.entries({
  "base/js/namespace": window.Jupyter, "base/js/events": events, "notebook/js/outputarea": area,
  "services/kernels/comm": { Comm }, module: { id: "widgets", uri: location.href },
})) modules.set(name, Promise.resolve(value));

async function show(model_id) {
  await (await module("widgets")).load_ipython_extension();
  const manager = kernel.widget_manager;
  for (let tries = 0; !manager.has_model(model_id); tries += 1) {
    if (tries > 3000) throw new Error("the widgets did not come");
    await new Promise((done) => setTimeout(done, 10));
  }
  const view = await manager.create_view(await manager.get_model(model_id));
  const place = document.getElementById("widget");
  place.replaceChildren();
  // As Lumino attaches: what is told before and after, so that a widget can measure itself.
  view.luminoWidget.processMessage({ type: "before-attach" });
  place.append(view.el);
  view.luminoWidget.processMessage({ type: "after-attach" });
}

channel.onmessage = ({ data }) => {
  const [message, buffers] = unpacked(data);
  const whole = { ...message, buffers, msg_type: message.type, parent_header: { msg_id: message.parent } };
  whole.header = { msg_type: message.type };
  if (message.type === "ready") {
    show(message.content.model_id).catch((error) => {
      document.getElementById("widget").textContent = `The page cannot be shown: ${error.message}`;
      throw error;
    });
  } else if (message.type === "idle") {
    const tell = told.get(message.parent);
    told.delete(message.parent);
    tell?.({ ...whole, content: { execution_state: "idle" } });
  } else {
    comms.take(whole);
  }
};

// After the end; if it was but a pause, the page is loaded again.
channel.onclose = () => {
  document.body.className = "lost";
  const again = setInterval(() => fetch("/").then(({ ok }) => {
    if (ok) { clearInterval(again); location.reload(); }
  }).catch(nothing), 5000);
};
// A tab that is left says so; one that the browser puts to sleep, or that dies, does not.
window.addEventListener("pagehide", () => channel.close(1000));
window.addEventListener("pageshow", ({ persisted }) => { if (persisted) location.reload(); });
history.replaceState(null, "", "/");  // the token is in a cookie from now on
