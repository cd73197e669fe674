// Joins the parts of the page: what comes from the machine to what shows it. Values are drawn with
// the screen, however fast they come: only the newest are kept.

import { Connection } from "/socket.js";
import { RobotView } from "/robot.js";
import { TouchView } from "/touch.js";
import { Traces } from "/traces.js";
import { Operator } from "/operate.js";
import { Joints, Parameters, Timing, showFaults, showMachine } from "/panels.js";
import { Scope } from "/scope.js";

const find = (id) => document.getElementById(id);

const connection = new Connection();
const robot = new RobotView(find("robot"));
const touch = new TouchView(find("images"), find("features"));
const traces = new Traces(find("trace-list"));
const operator = new Operator(connection);
const joints = new Joints();
const parameters = new Parameters(operator);
const timing = new Timing();
const scope = new Scope(connection);

let model = null, newest = null, isDrawn = true;
const counts = { arrived: 0, drawn: 0, since: performance.now() };

connection.addEventListener("model", (event) => {
  model = event.detail.data;
  robot.model = model;
  joints.setModel(model);
  operator.setModel(model);
});

connection.addEventListener("signals", (event) => {
  const names = [];
  for (const [signal, fields] of Object.entries(event.detail.data)) {
    for (const field of fields) {
      if (field.count === 1) names.push(`${signal}.${field.name}`);
      else for (let i = 0; i < Math.min(field.count, 8); i++) names.push(`${signal}.${field.name}[${i}]`);
    }
  }
  find("signal-names").replaceChildren(...names.map((value) => Object.assign(document.createElement("option"), { value })));
});

connection.addEventListener("parameters", (event) => parameters.show(event.detail.data));

connection.addEventListener("status", (event) => {
  const status = event.detail.data;
  operator.status(status, model?.states);
  showFaults(status);
  showMachine(status);
  timing.show(status);
  joints.setTorques(status.joints ?? []);
  const world = status.machine?.world;
  if (world && !robot.world) {
    robot.world = world;
    if (robot.model && world.table) robot.model.floor = world.table.z_m;
  }
  const p = status.tool?.p_mm;
  const at = p ? `tool ${p.map((x) => x.toFixed(1)).join(", ")} mm` : "tool –: the joints' zero is not known";
  find("tool").textContent = status.jog ? `${at} · ${status.jog}` : at;
  if (p) robot.canvas.setAttribute("aria-label", `The arm; ${at}; state ${status.state}`);
});

connection.addEventListener("update", (event) => {
  newest = event.detail;
  isDrawn = false;
  counts.arrived++;
  traces.add(newest.watch.values, newest.watch.t_ns / 1e9);
});

connection.addEventListener("link", (event) => {
  const { up, text } = event.detail;
  find("link").hidden = up;
  find("link").textContent = up ? "" : text;
});
connection.addEventListener("closed", () => {
  find("link").hidden = false;
  find("link").textContent = "the page's server has gone; nothing here is live";
});
connection.addEventListener("open", () => {
  if (traces.added.length) connection.ask({ trace: traces.added });
});

function draw() {
  requestAnimationFrame(draw);
  if (isDrawn || !newest) return;
  isDrawn = true;
  counts.drawn++;
  const { values, t_ns } = newest.watch;
  find("time").textContent = `${(t_ns / 1e9).toFixed(2)} s`;
  find("dropped").textContent = String(newest.dropped + (newest.watch.skipped ?? 0));
  if (values["sense.joints.q_rad"]) robot.q = values["sense.joints.q_rad"];
  robot.truth = values["world.truth"] ?? null;
  robot.hasFinger = touch.draw(values);
  robot.draw();
  joints.draw(values);
  traces.draw();
}
requestAnimationFrame(draw);

setInterval(() => {
  const now = performance.now(), seconds = (now - counts.since) / 1000;
  find("rate").textContent = `${(counts.drawn / seconds).toFixed(0)} of ${(counts.arrived / seconds).toFixed(0)} /s`;
  document.body.dataset.arrived = (counts.arrived / seconds).toFixed(1);
  document.body.dataset.drawn = (counts.drawn / seconds).toFixed(1);
  Object.assign(counts, { arrived: 0, drawn: 0, since: now });
}, 2000);

for (const button of document.querySelectorAll("[data-view]")) {
  button.addEventListener("click", () => robot.choose(button.dataset.view));
}

const added = [];
async function trace(paths) {
  const answer = await connection.ask({ trace: paths });
  if (answer.outcome === "ok") {
    traces.setAdded(paths);
    added.splice(0, added.length, ...paths);
  }
  find("answer").className = answer.outcome === "ok" ? "ok" : "refused";
  find("answer").textContent = `trace → ${answer.outcome}${answer.text ? `: ${answer.text}` : ""}`;
}
find("trace-form").addEventListener("submit", (event) => {
  event.preventDefault();
  const path = find("trace-name").value.trim();
  if (path && !added.includes(path)) trace([...added, path]);
});
find("trace-clear").addEventListener("click", () => trace([]));

// Tabs: arrows move between them, as the pattern of the ARIA guide has it.
const tabs = [...document.querySelectorAll('[role="tab"]')];
function choose(tab) {
  for (const other of tabs) {
    const isChosen = other === tab;
    other.setAttribute("aria-selected", String(isChosen));
    other.tabIndex = isChosen ? 0 : -1;
    find(other.getAttribute("aria-controls")).hidden = !isChosen;
  }
  scope.draw();
}
tabs.forEach((tab, i) => {
  tab.addEventListener("click", () => choose(tab));
  tab.addEventListener("keydown", (event) => {
    const step = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
    if (!step) return;
    const next = tabs[(i + step + tabs.length) % tabs.length];
    choose(next);
    next.focus();
  });
});
