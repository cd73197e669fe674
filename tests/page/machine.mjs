// A simulated machine with its page, a client of its socket, and what of a picture can be checked.

import { spawn } from "node:child_process";
import { mkdtempSync, readFileSync, rmSync } from "node:fs";
import net from "node:net";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { chromium } from "playwright-core";

const ROOT = process.env.TAKTIL_ROOT;
/** Longest wait for something that has to come (ms): far more than it takes on a busy machine. */
const PATIENCE_MS = 30_000;

export const sleep = (ms) => new Promise((resolve) => setTimeout(resolve, ms));

/** Waits until a function gives something true, and returns that. */
export async function eventually(what, found) {
  const until = Date.now() + PATIENCE_MS;
  for (;;) {
    const value = await found();
    if (value) return value;
    if (Date.now() > until) throw new Error(`never: ${what}`);
    await sleep(30);
  }
}

/** A run or a rehearsal of a scene, with its page. */
export class Machine {
  static async start(words, scene) {
    const machine = new Machine();
    machine.folder = mkdtempSync(join(tmpdir(), "taktil-page-"));
    machine.socket = join(machine.folder, "op");
    const at = words[0] === "rehearse" ? ["--at", machine.socket] : ["--operator", machine.socket];
    machine.output = "";
    machine.process = spawn(process.env.TAKTIL, [words[0], join(ROOT, "sim/scenes", scene), ...words.slice(1), ...at, "--page", "0"],
      { env: { ...process.env, XDG_RUNTIME_DIR: machine.folder } });
    for (const stream of [machine.process.stdout, machine.process.stderr]) {
      stream.on("data", (text) => { machine.output += text; });
    }
    machine.ended = new Promise((resolve) => machine.process.on("exit", resolve));
    const read = (pattern) => eventually(`${pattern} in ${machine.output}`, () => machine.output.match(pattern)?.[1]);
    machine.url = await read(/the page is at (\S+)/);
    machine.tokenFile = await read(/the token in (\S+)/);
    machine.token = readFileSync(machine.tokenFile, "utf8").trim();
    return machine;
  }

  client() {
    return new Client(this.socket);
  }

  async stop() {
    this.process.kill("SIGTERM");
    await this.ended;
    rmSync(this.folder, { recursive: true, force: true });
  }
}

/** A client of the operator's socket, as a program is one. */
export class Client {
  #next = 1;
  #waiting = new Map();

  constructor(path) {
    this.socket = net.connect(path);
    let text = "";
    this.socket.on("data", (bytes) => {
      text += bytes;
      for (let end = text.indexOf("\n"); end >= 0; end = text.indexOf("\n")) {
        const value = JSON.parse(text.slice(0, end));
        text = text.slice(end + 1);
        this.#waiting.get(value.id)?.(value);
      }
    });
    this.socket.on("error", () => {});
  }

  say(words) {
    const id = this.#next++;
    return new Promise((resolve) => {
      this.#waiting.set(id, resolve);
      this.socket.write(`${JSON.stringify({ id, say: words })}\n`);
    });
  }

  async status() {
    return (await this.say("status")).data;
  }

  /** Waits until the machine is in a state. */
  reaches(state) {
    return eventually(state, async () => {
      const status = await this.status();
      return status.state === state && status;
    });
  }

  close() {
    this.socket.destroy();
  }
}

export const launch = () =>
  chromium.launch({ executablePath: process.env.TAKTIL_BROWSER, args: ["--no-sandbox", "--disable-gpu"] });

/** A page that has got its first values; with the token it may command. */
export async function open(browser, machine, options = {}) {
  const page = await browser.newPage({ viewport: options.viewport ?? { width: 1280, height: 800 } });
  page.problems = [];
  page.on("pageerror", (error) => page.problems.push(String(error)));
  page.on("console", (message) => message.type() === "error" && page.problems.push(message.text()));
  await page.goto(machine.url);
  await page.waitForFunction(() => document.getElementById("time").textContent !== "–", null, { timeout: PATIENCE_MS });
  if (options.token) {
    await page.fill("#token", options.token);
    await page.press("#token", "Enter");
    await page.waitForFunction(() => document.getElementById("token-form").hidden, null, { timeout: PATIENCE_MS });
  }
  return page;
}

/** Presses the button of a verb, and returns the answer that the page shows. A verb that is refused now can be pressed all the same. */
export async function press(page, verb) {
  await page.click(`[data-verb="${verb}"]`, { force: true });
  await page.waitForFunction((v) => document.getElementById("answer").textContent.startsWith(`${v} →`), verb, { timeout: PATIENCE_MS });
  return page.textContent("#answer");
}

/** Where a point of the base frame (m) stands on the canvas by the camera that the page names. */
export function projected(camera, point) {
  const dot = (a, b) => a.reduce((sum, x, i) => sum + x * b[i], 0);
  const from = point.map((x, i) => x - camera.centre[i]);
  const near = camera.far / (camera.far - dot(from, camera.toward));
  return [
    camera.width / 2 + dot(from, camera.right) * camera.pixels * near,
    camera.height / 2 - dot(from, camera.up) * camera.pixels * near,
  ];
}

/** The colour of the drawing at a place on the canvas. */
export const pixel = (page, [x, y]) =>
  page.evaluate(([px, py]) => {
    const canvas = document.getElementById("robot");
    const ratio = canvas.width / canvas.getBoundingClientRect().width;
    return [...canvas.getContext("2d").getImageData(Math.round(px * ratio), Math.round(py * ratio), 1, 1).data];
  }, [x, y]);

/** Whether something is painted at a place and three pixels around it: an arm, not a line of the floor. Edges of faces may shine through a little. */
export const isSolid = (page, [x, y]) =>
  page.evaluate(([px, py]) => {
    const canvas = document.getElementById("robot");
    const ratio = canvas.width / canvas.getBoundingClientRect().width;
    const { data } = canvas.getContext("2d").getImageData(Math.round(px * ratio) - 3, Math.round(py * ratio) - 3, 7, 7);
    for (let i = 3; i < data.length; i += 4) if (data[i] < 128) return false;
    return true;
  }, [x, y]);

/** Where the joints and the tool of an arm are (m), from the frames that the machine tells and angles (rad). */
export function chain(model, q) {
  let turn = [[1, 0, 0], [0, 1, 0], [0, 0, 1]], at = [0, 0, 0];
  const times = (a, b) => a.map((row) => [0, 1, 2].map((j) => row.reduce((sum, x, k) => sum + x * b[k][j], 0)));
  const step = (frame) => {
    const rows = [0, 1, 2].map((i) => frame.slice(4 * i, 4 * i + 4));
    at = at.map((x, i) => x + turn[i].reduce((sum, y, k) => sum + y * rows[k][3], 0));
    turn = times(turn, rows.map((row) => row.slice(0, 3)));
  };
  const places = model.joints.map((joint, i) => {
    step(joint.origin);
    const [s, c] = [Math.sin(q[i]), Math.cos(q[i])];
    turn = times(turn, [[c, -s, 0], [s, c, 0], [0, 0, 1]]);
    return at;
  });
  step(model.tool);
  return [...places, at];
}

export const camera = (page) => page.evaluate(() => JSON.parse(document.getElementById("robot").dataset.camera));

/** How many pixels of a canvas fulfil a condition on red, green and blue. */
export const count = (page, selector, condition) =>
  page.evaluate(([s, c]) => {
    const canvas = document.querySelector(s);
    const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
    const fits = { orange: (r, g, b) => r > 120 && g > 45 && g < 115 && b < 40, blue: (r, g, b) => b > 130 && g > 90 && r < 110,
      yellow: (r, g, b) => r > 180 && g > 150 && b < 130, dark: (r, g, b) => r + g + b < 130, ink: (r, g, b, a) => a > 0 }[c];
    let n = 0;
    for (let i = 0; i < data.length; i += 4) n += fits(data[i], data[i + 1], data[i + 2], data[i + 3]) ? 1 : 0;
    return n;
  }, [selector, condition]);
