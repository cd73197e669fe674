// A capture around an event, as an oscilloscope shows it, and its values as a table.

import { COLOURS, curves, fitted, range, short } from "/traces.js";

const find = (id) => document.getElementById(id);

export class Scope {
  #capture = null;

  constructor(connection) {
    this.connection = connection;
    find("scope-form").addEventListener("submit", (event) => {
      event.preventDefault();
      this.#arm();
    });
    find("scope-off").addEventListener("click", async () => this.#tell(await connection.say("scope off"), "off"));
    find("scope-csv").addEventListener("click", () => this.#save());
    connection.addEventListener("scope", (event) => this.#show(event.detail));
    new ResizeObserver(() => this.draw()).observe(find("scope"));
  }

  async #arm() {
    const value = (name) => find(`scope-${name}`).value.trim();
    const words = `scope ${value("channels")} trigger ${value("trigger")} ${value("condition")} ${value("level")} before ${value("before")} after ${value("after")}`;
    this.#tell(await this.connection.say(words), "armed: waiting for the event");
  }

  #tell(answer, done) {
    find("scope-text").textContent = answer.outcome === "ok" ? done : `${answer.outcome}: ${answer.text}`;
  }

  #show(capture) {
    this.#capture = capture;
    find("scope-csv").disabled = false;
    const count = capture.channels.reduce((sum, channel) => sum + channel.t_s.length, 0);
    const cut = capture.channels.some((channel) => channel.truncated) ? "; the oldest values found no room" : "";
    find("scope-text").textContent = `captured at ${(capture.at_ns / 1e9).toFixed(4)} s: ${count} values${cut}`;
    find("scope").setAttribute("aria-label", `Capture of ${capture.channels.map((channel) => channel.name).join(", ")} with ${count} values`);
    this.draw();
  }

  draw() {
    const canvas = find("scope");
    if (!canvas.getClientRects().length) return;
    const { context, width, height } = fitted(canvas);
    if (!this.#capture) {
      context.fillStyle = "#4c5863";
      context.font = "12px sans-serif";
      context.fillText("arm a capture: it is drawn when its event has come", 12, 24);
      return;
    }
    const lines = this.#capture.channels.map((channel, i) => ({
      points: channel.t_s.map((t, k) => [t, channel.values[k]]),
      colour: COLOURS[i % COLOURS.length],
      name: channel.name,
    }));
    const times = lines.flatMap((line) => (line.points.length ? [line.points[0][0], line.points[line.points.length - 1][0]] : []));
    const [t0, t1] = [Math.min(0, ...times), Math.max(0, ...times)];
    const [low, high] = range(lines);
    const area = { x: 60, y: 18, width: width - 72, height: height - 40 };
    const px = (t) => area.x + ((t - t0) / (t1 - t0 || 1)) * area.width;
    context.strokeStyle = "#d5dce1";
    context.fillStyle = "#4c5863";
    context.font = "10px sans-serif";
    for (let k = 0; k <= 4; k++) {
      const y = area.y + (area.height * k) / 4;
      context.strokeRect(area.x, y, area.width, 0);
      context.fillText(short(high - ((high - low) * k) / 4), 6, y + 4);
      const t = t0 + ((t1 - t0) * k) / 4;
      const label = `${t.toFixed(3)} s`;
      // The last one would stand beyond the edge.
      context.fillText(label, Math.min(px(t) - 14, width - 4 - context.measureText(label).width), height - 8);
    }
    context.strokeStyle = "#1b2229";
    context.setLineDash([4, 3]);
    context.strokeRect(px(0), area.y, 0, area.height);
    context.setLineDash([]);
    curves(context, area, [t0, t1, low, high], lines);
    let x = area.x;
    context.font = "11px sans-serif";
    for (const { name, colour } of lines) {
      context.fillStyle = colour;
      context.fillText(name, x, 12);
      x += context.measureText(name).width + 14;
    }
  }

  /** One row a time, one column a channel; a channel without a value at a time has none there. */
  csv() {
    const rows = new Map();
    const channels = this.#capture.channels;
    channels.forEach((channel, i) => channel.t_s.forEach((t, k) => {
      const row = rows.get(t) ?? new Array(channels.length).fill("");
      row[i] = channel.values[k];
      rows.set(t, row);
    }));
    const sorted = [...rows.entries()].sort((a, b) => a[0] - b[0]);
    return [["t_s", ...channels.map((channel) => channel.name)], ...sorted.map(([t, row]) => [t, ...row])]
      .map((row) => row.join(",")).join("\n") + "\n";
  }

  #save() {
    const url = URL.createObjectURL(new Blob([this.csv()], { type: "text/csv" }));
    const link = Object.assign(document.createElement("a"), { href: url, download: "scope.csv" });
    link.click();
    URL.revokeObjectURL(url);
  }
}
