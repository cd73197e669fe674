// Sixteen pages, one of which reads nothing, beside a live run: the lanes do the same jobs to the same bits as without them, and
// what the slow page did not take is left out, not kept. Usage: node lanes.mjs SECONDS REPEATS.

import assert from "node:assert/strict";
import { spawn } from "node:child_process";
import { randomBytes } from "node:crypto";
import { mkdtempSync, rmSync } from "node:fs";
import net from "node:net";
import { tmpdir } from "node:os";
import { join } from "node:path";

const ROOT = process.env.TAKTIL_ROOT;
const PAGES = 16;
const [seconds, repeats] = process.argv.slice(2).map(Number);

/** A page without a browser: it takes updates and says so, or reads nothing from its first values on. */
class Page {
  updates = 0;
  dropped = 0;
  #input = Buffer.alloc(0);

  constructor(port, isSlow) {
    this.isSlow = isSlow;
    this.socket = net.connect(port, "127.0.0.1", () => {
      const host = `127.0.0.1:${port}`;
      const head = ["GET /machine HTTP/1.1", `Host: ${host}`, `Origin: http://${host}`, "Upgrade: websocket", "Connection: Upgrade",
        "Sec-WebSocket-Version: 13", "Sec-WebSocket-Protocol: taktil.page.v1", `Sec-WebSocket-Key: ${randomBytes(16).toString("base64")}`];
      this.socket.write(`${head.join("\r\n")}\r\n\r\n`);
    });
    this.isPage = false;
    this.socket.on("data", (bytes) => {
      this.#input = Buffer.concat([this.#input, bytes]);
      if (!this.isPage) {
        const end = this.#input.indexOf("\r\n\r\n");
        if (end < 0) return;
        this.isPage = this.#input.subarray(0, 12).toString() === "HTTP/1.1 101";
        this.#input = this.#input.subarray(end + 4);
      }
      for (let frame = this.#frame(); frame; frame = this.#frame()) this.#take(frame);
    });
    this.socket.on("error", () => {});
    this.closed = new Promise((resolve) => this.socket.on("close", resolve));
  }

  /** The next frame of the server: its kind and its content. */
  #frame() {
    const input = this.#input;
    if (input.length < 2) return null;
    let length = input[1], head = 2;
    if (length === 126) [length, head] = [input.length >= 4 ? input.readUInt16BE(2) : Infinity, 4];
    else if (length === 127) [length, head] = [input.length >= 10 ? Number(input.readBigUInt64BE(2)) : Infinity, 10];
    if (input.length < head + length) return null;
    const frame = { kind: input[0] & 15, data: input.subarray(head, head + length) };
    this.#input = input.subarray(head + length);
    return frame;
  }

  #send(kind, data) {
    const mask = randomBytes(4);
    const masked = Buffer.from(data.map((byte, i) => byte ^ mask[i % 4]));
    this.socket.write(Buffer.concat([Buffer.from([128 | kind, 128 | masked.length]), mask, masked]));
  }

  #take({ kind, data }) {
    if (kind === 9) this.#send(10, data);
    if (kind !== 1 || !data.subarray(0, 17).equals(Buffer.from("{\"event\":\"update\""))) return;
    const { number, dropped } = JSON.parse(data);
    this.updates++;
    this.dropped = dropped;
    if (this.isSlow) this.socket.pause();
    else this.#send(1, Buffer.from(JSON.stringify({ seen: number })));
  }
}

/** A live run; the summary of its lanes and its digest, and what its pages got. */
async function run(withPages) {
  const folder = mkdtempSync(join(tmpdir(), "taktil-lanes-"));
  const words = ["run", join(ROOT, "sim/scenes/roll-pin.toml"), "--for", String(seconds), "--json", ...(withPages ? ["--page", "0"] : [])];
  const machine = spawn(process.env.TAKTIL, words, { env: { ...process.env, XDG_RUNTIME_DIR: folder } });
  let out = "", told = "";
  machine.stdout.on("data", (text) => { out += text; });
  const pages = [];
  machine.stderr.on("data", (text) => {
    told += text;
    const port = told.match(/the page is at http:\/\/127\.0\.0\.1:(\d+)/)?.[1];
    if (port && !pages.length) for (let i = 0; i < PAGES; i++) pages.push(new Page(Number(port), i === 0));
  });
  const code = await new Promise((resolve) => machine.on("exit", resolve));
  // What waited for the page that did not read comes now, with the end of the connection.
  const slow = pages[0];
  const before = slow?.updates;
  if (slow) {
    slow.isSlow = false;
    slow.socket.resume();
  }
  await Promise.all(pages.map((page) => page.closed));
  rmSync(folder, { recursive: true, force: true });
  assert.equal(code, 0, told);
  const { digest, faults, lanes } = JSON.parse(out);
  return { digest, faults, lanes, pages, waiting: slow && slow.updates - before };
}

const sum = (lanes, count) => lanes.reduce((total, lane) => total + count(lane), 0);
const counted = ({ digest, faults, lanes }) => ({ digest, faults, lanes: lanes.map(({ name, jobs, allocations, page_faults, records_dropped }) =>
  ({ name, jobs, allocations, page_faults, records_dropped })) });

const alone = [], watched = [];
for (let i = 0; i < repeats; i++) {
  alone.push(await run(false));
  watched.push(await run(true));
  const { pages, waiting } = watched.at(-1);
  assert.deepEqual(counted(watched.at(-1)), counted(alone[0]), "the lanes do the same with pages as without");
  for (const lane of watched.at(-1).lanes) assert.deepEqual([lane.allocations, lane.page_faults, lane.records_dropped], [0, 0, 0], lane.name);
  assert.equal(pages.filter((page) => page.isPage).length, PAGES, "every page was served");
  const least = Math.min(...pages.slice(1).map((page) => page.updates));
  assert.ok(least > 5 * seconds, `a page that reads got ${least} updates`);
  assert.ok(waiting <= 2, `${waiting} updates waited for the page that did not read`);
  const misses = (runs) => runs.map(({ lanes }) => sum(lanes, (lane) => Object.values(lane.misses).reduce((a, b) => a + b, 0)));
  console.log(`run ${i + 1}: ${sum(watched.at(-1).lanes, (lane) => lane.jobs)} jobs, digest ${watched.at(-1).digest}; updates of a page that reads `
    + `${least} or more; waiting for the other ${waiting}; misses without ${misses(alone).at(-1)}, with ${misses(watched).at(-1)}`);
}
const median = (values) => values.sort((a, b) => a - b)[Math.floor(values.length / 2)];
for (const [i, { name }] of alone[0].lanes.entries()) {
  const of = (runs, figure) => median(runs.map(({ lanes }) => figure(lanes[i])));
  const ratio = (figure) => (of(watched, figure) / of(alone, figure)).toFixed(2);
  console.log(`${name}: with pages to without, medians of ${repeats}: job p50 x ${ratio((lane) => lane.exec_us.p50)}, p99 x ${ratio((lane) => lane.exec_us.p99)}; `
    + `release lateness p50 x ${ratio((lane) => lane.release_late_us.p50)}, p99 x ${ratio((lane) => lane.release_late_us.p99)}`);
}
