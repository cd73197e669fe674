// The dashboard's server for live viewers, seen by the viewers' own libraries: the client of the protocol's authors, their published
// message definitions, and a decoder of protobuf that knows only what the server advertises.

import assert from "node:assert/strict";
import { spawn } from "node:child_process";
import { mkdtempSync, readFileSync, rmSync } from "node:fs";
import http from "node:http";
import net from "node:net";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { after, before, describe, test } from "node:test";
import published from "@foxglove/schemas/internal.js";
import protocol from "@foxglove/ws-protocol";
import protobuf from "protobufjs";
import descriptor from "protobufjs/ext/descriptor/index.js";
import WebSocket from "ws";

const ROOT = process.env.TAKTIL_ROOT;
const SUBPROTOCOL = protocol.FoxgloveClient.SUPPORTED_SUBPROTOCOL;
/** Longest wait for something that has to come (ms): far more than it takes on a busy machine. */
const PATIENCE_MS = 60_000;
/** Seconds for which messages are counted. */
const COUNTED_S = Number(process.env.TAKTIL_COUNTED_S ?? 4);

const sleep = (ms) => new Promise((resolve) => setTimeout(resolve, ms));

async function eventually(what, found) {
  const until = Date.now() + PATIENCE_MS;
  for (;;) {
    const value = await found();
    if (value) return value;
    if (Date.now() > until) throw new Error(`never: ${what}`);
    await sleep(20);
  }
}

/** A process whose output is kept. */
class Program {
  constructor(program, words, folder) {
    this.output = "";
    this.process = spawn(program, words, { cwd: ROOT, env: { ...process.env, XDG_RUNTIME_DIR: folder } });
    for (const stream of [this.process.stdout, this.process.stderr]) stream.on("data", (text) => { this.output += text; });
    this.ended = new Promise((resolve) => this.process.on("exit", resolve));
  }

  reads(pattern) {
    return eventually(`${pattern} in ${this.output}`, () => this.output.match(pattern)?.[1]);
  }

  async stop() {
    this.process.kill("SIGTERM");
    await this.ended;
  }
}

/** A simulated run, and the dashboard beside it with its server for viewers. */
class Bench {
  static async start(scene, words) {
    const bench = new Bench();
    bench.folder = mkdtempSync(join(tmpdir(), "taktil-foxglove-"));
    bench.socket = join(bench.folder, "op");
    bench.machine = new Program(process.env.TAKTIL, [...words, join("sim/scenes", scene), words[0] === "run" ? "--operator" : "--at", bench.socket], bench.folder);
    await eventually("the operator's socket", () => new Promise((resolve) => {
      const socket = net.connect(bench.socket, () => { socket.destroy(); resolve(true); });
      socket.on("error", () => resolve(false));
    }));
    bench.dashboard = new Program(process.env.TAKTIL_DASHBOARD, ["--at", bench.socket, "--port", "0", "--foxglove"], bench.folder);
    bench.url = await bench.dashboard.reads(/viewers connect to (\S+);/);
    bench.layout = await bench.dashboard.reads(/their layout is (\S+)/);
    return bench;
  }

  /** What the machine itself says. */
  say(words) {
    return new Promise((resolve) => {
      const socket = net.connect(this.socket, () => socket.write(`${JSON.stringify({ id: 1, say: words })}\n`));
      let text = "";
      socket.on("data", (bytes) => {
        text += bytes;
        if (text.includes("\n")) {
          socket.destroy();
          resolve(JSON.parse(text.slice(0, text.indexOf("\n"))));
        }
      });
    });
  }

  async stop() {
    await this.dashboard.stop();
    await this.machine.stop();
    rmSync(this.folder, { recursive: true, force: true });
  }
}

/** The viewer's client, with everything that it is told. */
class Viewer {
  channels = new Map();
  messages = new Map();
  subscriptions = new Map();
  statuses = [];
  errors = [];

  constructor(url, Socket = WebSocket) {
    this.ws = new Socket(url, [SUBPROTOCOL]);
    this.client = new protocol.FoxgloveClient({ ws: this.ws });
    this.client.on("serverInfo", (info) => { this.info = info; });
    this.client.on("status", (status) => this.statuses.push(status));
    this.client.on("error", (error) => this.errors.push(error));
    this.client.on("advertise", (channels) => channels.forEach((channel) => this.channels.set(channel.topic, channel)));
    this.client.on("message", ({ subscriptionId, timestamp, data }) => {
      const topic = this.subscriptions.get(subscriptionId);
      const list = this.messages.get(topic) ?? [];
      list.push({ at_ns: timestamp, data: new Uint8Array(data.buffer, data.byteOffset, data.byteLength) });
      this.messages.set(topic, list);
    });
  }

  ready() {
    return eventually("channels", () => this.channels.size && this.info);
  }

  subscribe(topic) {
    assert.ok(this.channels.has(topic), `${topic} is advertised`);
    const id = this.client.subscribe(this.channels.get(topic).id);
    this.subscriptions.set(id, topic);
    return id;
  }

  count(topic) {
    return this.messages.get(topic)?.length ?? 0;
  }

  /** The type of a channel's messages by nothing but what the server advertises. */
  type(topic) {
    const { schema, schemaName } = this.channels.get(topic);
    const set = descriptor.FileDescriptorSet.decode(Buffer.from(schema, "base64"));
    return protobuf.Root.fromDescriptor(set).lookupType(schemaName);
  }

  newest(topic) {
    const { data } = this.messages.get(topic).at(-1);
    const type = this.type(topic);
    return type.toObject(type.decode(data), { longs: Number, defaults: true });
  }

  close() {
    this.client.close();
  }
}

/** The definitions that the authors of the messages publish, as protobuf. */
function publishedRoot() {
  const root = new protobuf.Root();
  root.addJSON(protobuf.common.get("google/protobuf/timestamp.proto").nested);
  root.addJSON(protobuf.common.get("google/protobuf/duration.proto").nested);
  for (const schema of Object.values(published.foxgloveMessageSchemas)) {
    const enums = Object.values(published.foxgloveEnumSchemas).filter((one) => one.parentSchemaName === schema.name);
    protobuf.parse(published.generateProto(schema, enums), root, { keepCase: true });
  }
  return root;
}

const WELL_KNOWN = {
  "/viewer/joints": "JointStates", "/viewer/frames": "FrameTransforms", "/viewer/scene": "SceneUpdate",
  "/viewer/arm": "SceneUpdate", "/viewer/tactile_scan/image": "RawImage",
};

/** The product of two frames, each a rotation as a quaternion and a place. */
function placed(frame, point) {
  const { x, y, z, w } = frame.rotation;
  const [a, b, c] = point;
  const [tx, ty, tz] = [2 * (y * c - z * b), 2 * (z * a - x * c), 2 * (x * b - y * a)];
  return [
    a + w * tx + y * tz - z * ty + frame.translation.x,
    b + w * ty + z * tx - x * tz + frame.translation.y,
    c + w * tz + x * ty - y * tx + frame.translation.z,
  ];
}

describe("a rolling pin, seen by a live viewer", () => {
  let bench, viewer;
  before(async () => {
    bench = await Bench.start("roll-pin.toml", ["run", "--for", "600"]);
    viewer = new Viewer(bench.url);
    await viewer.ready();
  });
  after(async () => {
    viewer?.close();
    await bench?.stop();
  });

  test("the server names itself, offers no capability, and advertises robot, image and every signal", async () => {
    assert.equal(viewer.ws.protocol, SUBPROTOCOL);
    assert.equal(viewer.info.name, "Taktil");
    assert.deepEqual(viewer.info.capabilities, []);
    for (const [topic, name] of Object.entries(WELL_KNOWN)) {
      assert.equal(viewer.channels.get(topic)?.schemaName, `foxglove.${name}`, topic);
    }
    const { data: signals } = await bench.say("signals");
    for (const signal of Object.keys(signals)) assert.ok(viewer.channels.has(`/${signal.replaceAll(".", "/")}`), signal);
  });

  test("every advertised message has the fields, numbers and types that its authors publish", () => {
    const root = publishedRoot();
    let fields = 0;
    for (const topic of Object.keys(WELL_KNOWN)) {
      const seen = new Set();
      const compare = (ours) => {
        if (seen.has(ours.fullName)) return;
        seen.add(ours.fullName);
        const theirs = root.lookupType(ours.fullName);
        for (const field of ours.fieldsArray) {
          const other = theirs.fields[field.name];
          assert.ok(other, `${ours.fullName}.${field.name}`);
          assert.deepEqual([field.id, field.repeated], [other.id, other.repeated], `${ours.fullName}.${field.name}`);
          field.resolve();
          other.resolve();
          if (field.resolvedType) {
            assert.equal(field.resolvedType.fullName, other.resolvedType.fullName);
            compare(field.resolvedType);
          } else {
            assert.equal(field.type, other.type, `${ours.fullName}.${field.name}`);
          }
          fields++;
        }
      };
      compare(viewer.type(topic));
    }
    assert.ok(fields > 60, `${fields} fields compared`);
  });

  test("messages come at the page's rate, stamped by the wall clock, and decode", async () => {
    for (const topic of [...Object.keys(WELL_KNOWN), "/robot_description", "/sense/joints", "/tactile_servo/features"]) viewer.subscribe(topic);
    await eventually("touch", async () => (await bench.say("status")).data.state === "TACTILE-SERVO");
    await eventually("every channel", () => [...viewer.subscriptions.values()].every((topic) => viewer.count(topic) > 0));
    const before = Object.fromEntries([...viewer.messages].map(([topic, list]) => [topic, list.length]));
    const from = Date.now();
    await sleep(1000 * COUNTED_S);
    const took_s = (Date.now() - from) / 1000;
    const rates = {};
    for (const topic of ["/viewer/joints", "/viewer/frames", "/viewer/tactile_scan/image", "/sense/joints", "/tactile_servo/features"]) {
      rates[topic] = ((viewer.count(topic) - before[topic]) / took_s).toFixed(1);
      // The page's rate is 32 a second; a busy machine has less.
      assert.ok(rates[topic] > 5 && rates[topic] < 40, `${topic}: ${rates[topic]} a second`);
    }
    console.log(`messages a second: ${JSON.stringify(rates)}`);
    for (const [topic, list] of viewer.messages) {
      for (let i = 1; i < list.length; i++) assert.ok(list[i].at_ns >= list[i - 1].at_ns, `${topic}: stamps rise`);
    }
    for (const topic of ["/viewer/scene", "/viewer/arm", "/robot_description"]) assert.ok(viewer.count(topic) <= 3, `${topic} is told once`);
    const late_s = Date.now() / 1000 - Number(viewer.messages.get("/viewer/joints").at(-1).at_ns) / 1e9;
    assert.ok(Math.abs(late_s) < 3, `the newest stamp is ${late_s} s old`);
  });

  test("the joints, frames, image and bodies are those of the machine", async () => {
    const { joints } = viewer.newest("/viewer/joints");
    assert.equal(joints.length, 6);
    assert.ok(joints.every((one) => Number.isFinite(one.position) && Number.isFinite(one.velocity) && Number.isFinite(one.effort)));
    assert.ok(joints.some((one) => one.effort !== 0), "the arm bears itself");
    await eventually("the tool where the machine has it", async () => {
      const { tool } = (await bench.say("status")).data;
      const chain = viewer.newest("/viewer/frames").transforms.filter((frame) => !["pin", "table"].includes(frame.child_frame_id));
      assert.deepEqual([chain[0].parent_frame_id, chain.at(-1).child_frame_id], ["base", "tool"]);
      const point = chain.reduceRight((at, frame) => placed(frame, at), [0, 0, 0]);
      return Math.hypot(...tool.p_mm.map((x, i) => x / 1e3 - point[i])) < 0.01;
    });
    const frames = viewer.newest("/viewer/frames").transforms.map((frame) => frame.child_frame_id);
    assert.ok(frames.includes("pin") && frames.includes("table"), `${frames}`);
    const image = viewer.newest("/viewer/tactile_scan/image");
    assert.equal(image.encoding, "mono8");
    assert.equal(image.data.length, image.width * image.height);
    assert.ok(image.data.some((grey) => grey > 100), "a pressed pin is bright");
    const ids = viewer.newest("/viewer/scene").entities.map((entity) => entity.id);
    assert.deepEqual(ids.sort(), ["array", "pin", "table"]);
    assert.ok(viewer.newest("/viewer/arm").entities.length >= 3, "links are drawn");
    const text = Buffer.from(viewer.messages.get("/robot_description")[0].data).toString();
    assert.ok(text.includes("<robot name=\"PUMA 260\">") && text.trimEnd().includes("</robot>"));
    const trace = JSON.parse(Buffer.from(viewer.messages.get("/sense/joints").at(-1).data));
    assert.equal(trace.q_rad.length, 6);
    assert.deepEqual(Object.keys(JSON.parse(viewer.channels.get("/sense/joints").schema).properties).sort(), Object.keys(trace).sort());
    assert.deepEqual(viewer.errors, []);
  });

  test("a viewer that does not read gets the newest values afterwards, not those that it missed", async () => {
    const slow = new Viewer(bench.url);
    await slow.ready();
    const id = slow.subscribe("/viewer/joints");
    await eventually("values", () => slow.count("/viewer/joints") > 5);
    slow.ws.pause();
    await sleep(3000);
    const before = slow.count("/viewer/joints");
    slow.ws.resume();
    await eventually("values again", () => slow.count("/viewer/joints") > before + 3);
    const list = slow.messages.get("/viewer/joints").map(({ at_ns }) => Number(at_ns) / 1e9);
    const gaps = list.slice(1).map((at, i) => at - list[i]);
    assert.ok(Math.max(...gaps) > 1.5, `what was missed is left out: ${Math.max(...gaps)} s`);
    const kept = list.slice(before, before + 4).filter((at) => at - list[before] < 1.0).length;
    assert.ok(kept <= 4);
    slow.client.unsubscribe(id);
    await sleep(300);
    const silent = slow.count("/viewer/joints");
    await sleep(400);
    assert.equal(slow.count("/viewer/joints"), silent, "what is given up comes no longer");
    slow.close();
  });

  test("a viewer that would command is told that it watches, and the machine stays as it was", async () => {
    const parameters = JSON.stringify((await bench.say("parameters")).data);
    viewer.client.setParameters([{ name: "tactile_servo.m0_counts", value: 1 }]);
    viewer.client.advertise({ topic: "/cmd", encoding: "json", schemaName: "x" });
    viewer.client.sendMessage(1, new Uint8Array([1, 2, 3]));
    viewer.client.subscribe(4_000_000_000);
    await eventually("four warnings", () => viewer.statuses.filter((status) => status.level === 1).length >= 4);
    assert.equal(JSON.stringify((await bench.say("parameters")).data), parameters);
    assert.equal(viewer.ws.readyState, WebSocket.OPEN);
  });

  test("foreign pages, names and protocols are refused", async () => {
    const { port } = new URL(bench.url);
    const ask = (headers) => new Promise((resolve) => {
      const request = http.get({ host: "127.0.0.1", port, path: "/foxglove", headers: {
        Connection: "Upgrade", Upgrade: "websocket", "Sec-WebSocket-Version": "13", "Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ==",
        "Sec-WebSocket-Protocol": SUBPROTOCOL, Host: `127.0.0.1:${port}`, ...headers } });
      request.on("response", (answer) => resolve(answer.statusCode));
      request.on("upgrade", (answer, socket) => { socket.destroy(); resolve(answer.headers["sec-websocket-protocol"]); });
      request.on("error", () => resolve(0));
    });
    assert.equal(await ask({}), SUBPROTOCOL);
    assert.equal(await ask({ Origin: "file://" }), SUBPROTOCOL);
    assert.equal(await ask({ "Sec-WebSocket-Protocol": "foxglove.sdk.v1" }), "foxglove.sdk.v1");
    assert.equal(await ask({ "Sec-WebSocket-Protocol": "foxglove.sdk.v1, foxglove.websocket.v1" }), SUBPROTOCOL);
    assert.equal(await ask({ Origin: "https://evil.test" }), 403);
    assert.equal(await ask({ Origin: "null" }), 403);
    assert.equal(await ask({ Host: `evil.test:${port}` }), 403);
    assert.equal(await ask({ "Sec-WebSocket-Protocol": "chat" }), 400);
  });

  test("the layout that is shipped names channels that are there", async () => {
    const layout = await (await fetch(bench.layout)).json();
    assert.deepEqual(layout, JSON.parse(readFileSync(join(ROOT, "machine/page/assets/foxglove-layout.json"), "utf8")));
    const text = JSON.stringify(layout);
    const topics = new Set([...text.matchAll(/"(\/[a-z_/]+)/g)].map((found) => found[1]));
    assert.ok(topics.size >= 4, `${[...topics]}`);
    for (const topic of topics) assert.ok(viewer.channels.has(topic), topic);
    const panels = new Set();
    const walk = (node) => (typeof node === "string" ? panels.add(node) : [node.first, node.second].forEach(walk));
    walk(layout.layout);
    assert.deepEqual([...panels].sort(), Object.keys(layout.configById).sort());
  });

  test("a browser's kind of WebSocket connects as well", { skip: typeof globalThis.WebSocket === "undefined" && "this node has none" }, async () => {
    const other = new Viewer(bench.url, globalThis.WebSocket);
    await other.ready();
    other.subscribe("/viewer/joints");
    await eventually("values", () => other.count("/viewer/joints") > 5);
    other.close();
  });
});

describe("an arm of seven joints from a URDF file", () => {
  let bench;
  before(async () => { bench = await Bench.start("seven-lines.toml", ["rehearse"]); });
  after(() => bench?.stop());

  test("has seven joints, eight frames and links", async () => {
    const viewer = new Viewer(bench.url);
    await viewer.ready();
    for (const topic of ["/viewer/joints", "/viewer/frames", "/viewer/arm", "/robot_description"]) viewer.subscribe(topic);
    await eventually("values", () => viewer.count("/viewer/frames") > 2 && viewer.count("/viewer/arm") && viewer.count("/robot_description"));
    assert.equal(viewer.newest("/viewer/joints").joints.length, 7);
    assert.equal(viewer.newest("/viewer/frames").transforms.length, 8);
    assert.ok(viewer.newest("/viewer/arm").entities.length >= 4);
    viewer.close();
  });
});
