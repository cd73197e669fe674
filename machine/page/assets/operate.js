// What an operator does: stop, verbs, words, the token, the control lease, and keys that are held.
// Every refusal is the machine's own sentence.

const HEARTBEAT_MS = 50;

/** Keys that push axes: the same as those of `taktil keys`. */
const AXIS_KEYS = { q: [0, 1], a: [0, -1], w: [1, 1], s: [1, -1], e: [2, 1], d: [2, -1], r: [3, 1], f: [3, -1], t: [4, 1], g: [4, -1], y: [5, 1], h: [5, -1] };
const FRAME_KEYS = { z: "joints", x: "base", c: "tool", v: "outer" };
const TOOL_AXES = ["x", "y", "z", "about x", "about y", "about z"];

const find = (id) => document.getElementById(id);

function isTyping(target) {
  return target instanceof HTMLInputElement && target.type !== "range";
}

export class Operator {
  mayCommand = false;
  #frame = "joints";
  #held = new Map();
  #timer = null;
  #asked = 0;
  #verbs = new Map();
  #isOurs = false;

  constructor(connection) {
    this.connection = connection;
    this.#listenStop();
    this.#listenToken();
    this.#makeAxes();
    this.#listenJog();
    find("words-form").addEventListener("submit", (event) => {
      event.preventDefault();
      const words = find("words").value.trim();
      if (words) this.say(words);
    });
    for (const button of document.querySelectorAll("[data-say]")) {
      button.addEventListener("click", () => this.say(button.dataset.say));
    }
    connection.addEventListener("closed", () => {
      this.release();
      this.#setCommand(false);
    });
    connection.addEventListener("jog", (event) => this.#showJog(event.detail.text));
    connection.addEventListener("lost", (event) => {
      this.release();
      this.#show({ outcome: "error", text: event.detail.text }, "");
    });
  }

  /** Says words and shows the answer. */
  async say(words) {
    const answer = await this.connection.say(words);
    this.#show(answer, words);
    return answer;
  }

  #show(answer, words) {
    const element = find("answer");
    const isOk = answer.outcome === "ok";
    const data = answer.data && !answer.text ? ` ${JSON.stringify(answer.data).slice(0, 300)}` : "";
    element.className = isOk ? "ok" : "refused";
    element.textContent = `${words ? `${words} → ` : ""}${answer.outcome}${answer.text ? `${isOk ? "" : ":"} ${answer.text}` : ""}${data}`;
  }

  #listenStop() {
    find("stop").addEventListener("click", () => this.stop());
    window.addEventListener("keydown", (event) => {
      if (event.code !== "Space" || (isTyping(event.target) && event.target.hasAttribute("data-words"))) return;
      // The space bar stops wherever the focus is; Enter presses buttons.
      event.preventDefault();
      if (!event.repeat) this.stop();
    }, { capture: true });
    window.addEventListener("keyup", (event) => {
      if (event.code === "Space" && event.target instanceof HTMLButtonElement) event.preventDefault();
    }, { capture: true });
  }

  async stop() {
    this.release();
    this.#show(await this.connection.say("stop"), "stop");
  }

  #listenToken() {
    const field = find("token");
    find("token-form").addEventListener("submit", async (event) => {
      event.preventDefault();
      const token = field.value.trim();
      field.value = "";
      if (!token) return;
      const answer = await this.connection.ask({ token });
      this.#show(answer, "");
      this.#setCommand(answer.outcome === "ok");
    });
  }

  #setCommand(may) {
    this.mayCommand = may;
    find("token-form").hidden = may;
    find("token-note").hidden = may;
    find("lease").hidden = !may;
    this.#showControl(this.control);
  }

  #showControl(control) {
    this.control = control;
    const holder = control?.holder;
    const text = find("control-text");
    if (!this.mayCommand) text.textContent = "This page may watch and stop.";
    else if (!holder) text.textContent = "This page may command; control is free.";
    else text.textContent = `This page may command; process ${holder.pid} of user ${holder.uid} has control.`;
  }

  /** Takes in the machine's status. */
  status(status, states) {
    find("state-name").textContent = status.state;
    find("mode").textContent = `mode ${status.mode}`;
    const list = find("states");
    if (states && list.childElementCount !== states.length) {
      list.replaceChildren(...states.map((name) => {
        const item = document.createElement("li");
        item.textContent = name;
        return item;
      }));
    }
    for (const item of list.children) {
      if (item.textContent === status.state) item.setAttribute("aria-current", "true");
      else item.removeAttribute("aria-current");
    }
    const reasons = new Map();
    for (const [verb, reason] of Object.entries(status.allowed ?? {})) {
      if (verb === "stop") continue;
      this.#verb(verb, reason);
      if (reason !== null) reasons.set(reason, [...(reasons.get(reason) ?? []), verb]);
    }
    this.#showReasons(reasons);
    this.#showControl(status.control);
  }

  #verb(verb, reason) {
    let button = this.#verbs.get(verb);
    if (!button) {
      const item = document.createElement("li");
      button = document.createElement("button");
      button.type = "button";
      button.dataset.verb = verb;
      button.textContent = verb;
      button.addEventListener("click", () => this.say(verb));
      item.append(button);
      find("verbs").append(item);
      this.#verbs.set(verb, button);
    }
    // A refused verb can still be said: the machine then gives its reason as the answer.
    button.setAttribute("aria-disabled", String(reason !== null));
    button.title = reason ?? "";
  }

  #showReasons(reasons) {
    const list = find("reasons");
    const key = JSON.stringify([...reasons]);
    if (list.dataset.key === key) return;
    list.dataset.key = key;
    list.replaceChildren(...[...reasons].map(([reason, verbs]) => {
      const row = document.createElement("div");
      const name = document.createElement("dt"), why = document.createElement("dd");
      name.textContent = verbs.join(", ");
      why.textContent = reason;
      row.append(name, why);
      return row;
    }));
  }

  // Keys that are held.

  /** Names the joints; an arm of seven has a frame for the last six. */
  setModel(model) {
    this.model = model;
    document.querySelector('[data-frame="outer"]').hidden = model.joints.length <= 6;
    this.#nameAxes();
  }

  #makeAxes() {
    const list = find("axes");
    for (let axis = 0; axis < 6; axis++) {
      const row = document.createElement("div");
      row.className = "axis";
      const label = document.createElement("span");
      const make = (sign) => {
        const button = document.createElement("button");
        button.type = "button";
        button.textContent = sign > 0 ? "+" : "−";
        button.dataset.axis = String(axis);
        button.dataset.sign = String(sign);
        this.#listenAxis(button, axis, sign);
        return button;
      };
      row.append(make(-1), label, make(1));
      list.append(row);
    }
    this.#nameAxes();
  }

  #nameAxes() {
    document.querySelectorAll("#axes .axis").forEach((row, axis) => {
      const first = this.#frame === "outer" ? (this.model?.joints.length ?? 6) - 6 : 0;
      const isJoints = this.#frame === "joints" || this.#frame === "outer";
      const name = isJoints ? `J${axis + 1 + first}` : TOOL_AXES[axis];
      row.children[1].textContent = name;
      row.children[0].setAttribute("aria-label", `Push ${name} negative while held`);
      row.children[2].setAttribute("aria-label", `Push ${name} positive while held`);
    });
  }

  #listenAxis(button, axis, sign) {
    const name = `button ${axis} ${sign}`;
    const press = () => {
      button.classList.add("held");
      this.#press(name, axis, sign);
    };
    const release = () => {
      button.classList.remove("held");
      this.#lift(name);
    };
    button.addEventListener("pointerdown", (event) => {
      if (event.button !== 0) return;
      button.setPointerCapture(event.pointerId);
      press();
    });
    for (const end of ["pointerup", "pointercancel", "lostpointercapture", "blur"]) button.addEventListener(end, release);
    button.addEventListener("keydown", (event) => {
      if (event.key === "Enter" && !event.repeat) press();
    });
    button.addEventListener("keyup", (event) => {
      if (event.key === "Enter") release();
    });
    button.addEventListener("contextmenu", (event) => event.preventDefault());
  }

  #listenJog() {
    for (const button of document.querySelectorAll("[data-frame]")) {
      button.addEventListener("click", () => this.#chooseFrame(button.dataset.frame));
    }
    find("push").addEventListener("input", () => {
      find("push-value").textContent = Number(find("push").value).toFixed(2);
    });
    window.addEventListener("keydown", (event) => {
      if (event.repeat || event.ctrlKey || event.altKey || event.metaKey) return;
      if (isTyping(event.target) || event.target instanceof HTMLSelectElement) return;
      const key = event.key.toLowerCase();
      if (AXIS_KEYS[key]) this.#press(`key ${key}`, ...AXIS_KEYS[key]);
      else if (FRAME_KEYS[key]) this.#chooseFrame(FRAME_KEYS[key]);
    });
    window.addEventListener("keyup", (event) => this.#lift(`key ${event.key.toLowerCase()}`));
    for (const name of ["blur", "pagehide"]) window.addEventListener(name, () => this.release());
    document.addEventListener("visibilitychange", () => {
      if (document.hidden) this.release();
    });
  }

  #chooseFrame(frame) {
    this.release();
    this.#frame = frame;
    for (const button of document.querySelectorAll("[data-frame]")) {
      button.setAttribute("aria-pressed", String(button.dataset.frame === frame));
    }
    this.#nameAxes();
  }

  #press(name, axis, sign) {
    this.#held.set(name, [axis, sign]);
    this.#beat();
    this.#timer ??= setInterval(() => this.#beat(), HEARTBEAT_MS);
  }

  #lift(name) {
    if (!this.#held.delete(name)) return;
    if (this.#held.size === 0) this.release();
    else this.#beat();
  }

  /** Lets go of every key. */
  release() {
    const wasHeld = this.#timer !== null;
    clearInterval(this.#timer);
    this.#timer = null;
    this.#held.clear();
    document.querySelectorAll("#axes .held").forEach((button) => button.classList.remove("held"));
    if (wasHeld) {
      this.connection.say("release");
      if (this.#isOurs) this.#showJog("");
    }
  }

  async #beat() {
    if (this.#held.size === 0 || this.#asked > 3) return;
    const axes = [0, 0, 0, 0, 0, 0];
    const push = Number(find("push").value);
    for (const [axis, sign] of this.#held.values()) axes[axis] = Math.max(-1, Math.min(1, axes[axis] + sign * push));
    this.#asked++;
    const answer = await this.connection.say(`jog ${this.#frame} ${axes.join(" ")}`);
    this.#asked--;
    if (answer.outcome !== "ok") {
      this.release();
      this.#show(answer, "jog");
    } else if (this.#held.size) {
      this.#showJog(answer.text ?? "");
    }
  }

  #showJog(text) {
    this.#isOurs = true;
    const element = find("jog-text");
    if (element.textContent !== text) element.textContent = text;
  }
}
