// Shows the tuner as Jupyter would: what Python says comes over a WebSocket, a message as JSON and
// each of its buffers behind it, and what is done here goes back.
import { render } from "./tuner.js";

const channel = new WebSocket(new URL("channel", location.href.replace(/^http/, "ws")));
channel.binaryType = "arraybuffer";
const listeners = {};
const model = {
  get: () => message.state.facts,
  send(content) {
    if (channel.readyState === WebSocket.OPEN) channel.send(JSON.stringify(content));
  },
  on: (event, action) => { listeners[event] = action; },
};
let message, buffers;
channel.onmessage = ({ data }) => {
  if (typeof data === "string") [message, buffers] = [JSON.parse(data), []];
  else buffers.push(new DataView(data));
  if (buffers.length < message.buffers) return;
  const el = document.getElementById("widget");
  if (message.content) return listeners["msg:custom"](message.content, buffers);
  el.textContent = "";
  return render({ model, el });
};
// After the end; if it was but a pause, the page is loaded again.
channel.onclose = () => {
  const load_again = ({ ok }) => { if (ok) location.reload(); };
  listeners.comm_live_update?.();
  setInterval(() => fetch(location.href).then(load_again, () => {}), 5000);
};
// A tab that is left says so; one that the browser puts to sleep, or that dies, does not.
window.addEventListener("pagehide", () => channel.close(1000));
window.addEventListener("pageshow", ({ persisted }) => { if (persisted) location.reload(); });
