// Joints, faults, what kind of machine this is, parameters, and timing.

import { fitted, short } from "/traces.js";

const find = (id) => document.getElementById(id);
const make = (name, properties = {}, ...children) => {
  const element = Object.assign(document.createElement(name), properties);
  element.append(...children);
  return element;
};
const setText = (element, text) => {
  if (element.textContent !== text) element.textContent = text;
};
const degrees = (radians) => (radians * 180) / Math.PI;

export class Joints {
  #rows = [];
  #limits = [];

  setModel(model) {
    this.#limits = model.joints.map((joint) => [degrees(joint.low_rad), degrees(joint.high_rad)]);
    this.#rows = model.joints.map((joint, i) => {
      const angle = make("div", { className: "meter" }, make("i"), make("b"));
      const torque = make("div", { className: "meter small" }, make("i"));
      const cells = [
        make("th", { scope: "row", textContent: String(i + 1), title: joint.name }),
        make("td", {}, angle),
        make("td", { className: "value" }),
        make("td", { className: "value" }),
        make("td", {}, torque),
        make("td", { className: "value" }),
      ];
      return { row: make("tr", {}, ...cells), cells, angle, torque };
    });
    find("joint-rows").replaceChildren(...this.#rows.map((row) => row.row));
  }

  setTorques(joints) {
    this.torqueMax = joints.map((joint) => joint.torque_max_nm);
  }

  draw(values) {
    const q = values["sense.joints.q_rad"], desired = values["setpoint.desired.q_rad"];
    const torque = values["actuate.applied.tau_nm"];
    this.#rows.forEach((row, i) => {
      const [low, high] = this.#limits[i];
      const share = (angle) => Math.min(1, Math.max(0, (angle - low) / (high - low)));
      if (Number.isFinite(q?.[i])) {
        const at = degrees(q[i]);
        row.angle.firstChild.style.width = `${(100 * share(at)).toFixed(2)}%`;
        const margin = Math.min(at - low, high - at);
        row.angle.classList.toggle("near", margin < 10);
        setText(row.cells[2], at.toFixed(2));
        row.angle.title = `${low.toFixed(0)} to ${high.toFixed(0)} deg`;
      }
      if (Number.isFinite(q?.[i]) && Number.isFinite(desired?.[i])) {
        row.angle.lastChild.style.left = `${(100 * share(degrees(desired[i]))).toFixed(2)}%`;
        setText(row.cells[3], degrees(desired[i] - q[i]).toFixed(3));
      }
      if (Number.isFinite(torque?.[i])) {
        const most = this.torqueMax?.[i] || 1;
        const part = Math.min(1, Math.abs(torque[i]) / most);
        const bar = row.torque.firstChild.style;
        bar.width = `${(50 * part).toFixed(2)}%`;
        bar.left = torque[i] < 0 ? `${(50 - 50 * part).toFixed(2)}%` : "50%";
        row.torque.classList.toggle("near", part > 0.9);
        setText(row.cells[5], torque[i].toFixed(2));
      }
    });
  }
}

export function showFaults(status) {
  const banner = find("fault");
  const faults = status.faults ?? [];
  banner.hidden = faults.length === 0;
  const key = JSON.stringify(faults);
  if (banner.dataset.key === key) return;
  banner.dataset.key = key;
  const items = faults.map((fault) =>
    make("li", {}, make("strong", { textContent: `${fault.first ? "first: " : ""}${fault.name}` }),
      `: ${fault.text}. Reaction: ${fault.reaction}. To clear: ${fault.clear}.`));
  banner.replaceChildren(make("strong", { textContent: faults.length === 1 ? "A fault is latched" : `${faults.length} faults are latched` }),
    make("ul", {}, ...items));
}

function badge(id, text, kind, title = "") {
  const element = find(id);
  element.hidden = !text;
  element.className = `badge ${kind}`;
  setText(element, text);
  element.title = title;
}

/** What this machine is, and what its kernel granted. */
export function showMachine(status) {
  const machine = status.machine ?? {}, kernel = status.kernel ?? {};
  badge("badge-machine", machine.simulated ? "SIMULATED" : "REAL BOARDS", machine.simulated ? "note" : "good",
    machine.simulated ? "the robot and its world are computed" : "drives and sensors are real");
  setText(find("title"), machine.title ?? "");
  const facts = kernel.facts ?? {};
  const version = facts.kernel ? `Linux ${facts.kernel}` : "";
  badge("badge-kernel", version && `${version}${kernel.preempt_rt ? " PREEMPT_RT" : ", no PREEMPT_RT"}`, kernel.preempt_rt ? "good" : "note");
  const isVirtual = (kernel.notes ?? []).some((note) => note.includes("virtual machine"));
  badge("badge-host", isVirtual ? "VIRTUAL MACHINE" : "", "note", "timing figures say nothing about another machine");
  const missing = kernel.missing ?? [];
  const isKnown = Object.keys(kernel).length > 0;
  badge("badge-grant", isKnown ? (kernel.granted ? "real time granted" : `not real time: ${missing.length} missing`) : "",
    kernel.granted ? "good" : "bad", missing.join("; "));
  const list = (title, texts) => (texts.length ? [make("h3", { textContent: title }), make("ul", {}, ...texts.map((textContent) => make("li", { textContent })))] : []);
  const shown = [
    ...list("Refused by the kernel", missing),
    ...list("Notes", kernel.notes ?? []),
    ...list("Lanes", (kernel.lanes ?? []).map((lane) => `${lane.lane}: ${lane.policy} ${lane.priority ?? ""} on CPUs ${(lane.cpus ?? []).join(", ")}`)),
    ...list("Facts", Object.entries(facts).map(([name, value]) => `${name}: ${value}`)),
  ];
  const key = JSON.stringify([missing, kernel.notes, kernel.lanes, facts]);
  const panel = find("kernel");
  if (panel.dataset.key !== key) {
    panel.dataset.key = key;
    panel.replaceChildren(...(shown.length ? shown : ["the kernel has not been asked yet"]));
  }
}

export class Parameters {
  #rows = new Map();

  constructor(operator) {
    this.operator = operator;
  }

  show(parameters) {
    for (const parameter of parameters) {
      const row = this.#rows.get(parameter.name) ?? this.#make(parameter);
      row.value = parameter.value;
      if (document.activeElement !== row.slider) row.slider.value = String(parameter.value);
      if (document.activeElement !== row.text) row.text.value = short(parameter.value);
    }
    const list = find("parameters");
    if (!parameters.length && !list.textContent) list.textContent = "this machine has no parameters";
  }

  #make({ name, low, high, value }) {
    const id = `parameter-${this.#rows.size}`;
    const label = make("label", { htmlFor: id, textContent: name, title: `${name}: ${low} to ${high}` });
    const slider = make("input", { type: "range", min: String(low), max: String(high), step: String((high - low) / 200) });
    slider.setAttribute("aria-label", `${name}, slider from ${low} to ${high}`);
    const text = make("input", { type: "text", id, inputMode: "decimal", title: `${low} to ${high}` });
    text.dataset.parameter = name;
    const row = { slider, text, value };
    const set = async (wanted) => {
      const answer = await this.operator.say(`set ${name} ${wanted}`);
      if (answer.outcome !== "ok") {
        slider.value = String(row.value);
        text.value = short(row.value);
      }
    };
    slider.addEventListener("input", () => { text.value = short(Number(slider.value)); });
    slider.addEventListener("change", () => set(slider.value));
    text.addEventListener("change", () => set(text.value.trim()));
    find("parameters").append(make("div", { className: "parameter" }, label, slider, text));
    this.#rows.set(name, row);
    return row;
  }
}

export class Timing {
  #last = null;
  #rates = {};

  show(status) {
    const lanes = status.timing ?? [];
    const isSimulated = status.machine?.simulated;
    setText(find("timing-note"), isSimulated ? "On the simulated robot the world waits: these figures are not those of a robot." : "");
    const t = performance.now();
    if (this.#last && t - this.#last.t > 900) {
      for (const lane of lanes) {
        const before = this.#last.jobs[lane.lane];
        if (before !== undefined && lane.jobs !== null) this.#rates[lane.lane] = ((lane.jobs - before) * 1000) / (t - this.#last.t);
      }
      this.#last = null;
    }
    this.#last ??= { t, jobs: Object.fromEntries(lanes.map((lane) => [lane.lane, lane.jobs])) };
    find("lanes").replaceChildren(...lanes.map((lane) => {
      const late = lane.lateness?.max_ns;
      const cells = [
        `${lane.period_ns / 1e6} ms`, lane.jobs ?? "–", this.#rates[lane.lane]?.toFixed(1) ?? "–", lane.missed ?? "–",
        late === undefined || late === null ? "–" : `${(late / 1e3).toFixed(0)} us`,
      ];
      return make("tr", {}, make("th", { scope: "row", textContent: lane.lane + (lane.silent ? " (others stand still)" : "") }),
        ...cells.map((text) => make("td", { textContent: String(text) })));
    }));
    this.#histograms(lanes);
    setText(find("records-lost"), `records lost on the way to the operator: ${status.records_lost ?? 0}; clients: ${status.clients ?? 0}`);
  }

  #histograms(lanes) {
    const list = find("histograms");
    const told = lanes.filter((lane) => lane.lateness?.counts?.some((n) => n > 0));
    for (const lane of told) {
      let figure = list.querySelector(`[data-lane="${CSS.escape(lane.lane)}"]`);
      if (!figure) {
        const canvas = make("canvas");
        canvas.setAttribute("role", "img");
        figure = make("figure", {}, make("figcaption", { textContent: `${lane.lane}: how late jobs began` }), canvas);
        figure.dataset.lane = lane.lane;
        list.append(figure);
      }
      const canvas = figure.lastChild;
      canvas.setAttribute("aria-label", `Histogram of the lateness of lane ${lane.lane}, most ${lane.lateness.max_ns} ns`);
      if (canvas.getClientRects().length) drawHistogram(canvas, lane.lateness);
    }
  }
}

/** Bars over bins whose upper edges are told, counts on a logarithmic scale. */
function drawHistogram(canvas, { edges_ns: edges, counts }) {
  const { context, width, height } = fitted(canvas);
  const most = Math.log10(Math.max(...counts) + 1) || 1;
  const n = counts.length, base = height - 16;
  counts.forEach((count, i) => {
    const h = (Math.log10(count + 1) / most) * (base - 12);
    context.fillStyle = "#0072b2";
    context.fillRect((i * width) / n + 1, base - h, width / n - 2, h);
    if (i % 3 === 0) {
      context.fillStyle = "#4c5863";
      context.font = "10px sans-serif";
      const edge = edges[i];
      const label = edge === undefined || edge === null ? "more" : edge >= 1e6 ? `${edge / 1e6} ms` : `${edge / 1e3} us`;
      context.fillText(label, (i * width) / n + 2, height - 4);
    }
  });
  context.fillStyle = "#4c5863";
  context.font = "10px sans-serif";
  context.fillText(`jobs, logarithmic; most ${Math.max(...counts)}`, 2, 10);
}
