// Values over the last seconds, each in a strip of its own, and curves in a frame with a scale.

import { CONTACT } from "/touch.js";

export const COLOURS = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#8a6100", "#5d3a9b", "#1b2229"];
const SECONDS = 20;
const SAMPLES_MAX = 900;

/** Makes a canvas as large as it is shown, and returns its context in shown pixels. */
export function fitted(canvas) {
  const rect = canvas.getBoundingClientRect();
  const ratio = Math.min(2, window.devicePixelRatio || 1);
  const [w, h] = [Math.round(rect.width * ratio), Math.round(rect.height * ratio)];
  if (canvas.width !== w || canvas.height !== h) [canvas.width, canvas.height] = [w, h];
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, rect.width, rect.height);
  return { context, width: rect.width, height: rect.height };
}

/** A number in a few characters. */
export function short(x) {
  if (x === null || x === undefined || !Number.isFinite(x)) return "–";
  const a = Math.abs(x);
  if (a !== 0 && (a < 1e-3 || a >= 1e6)) return x.toExponential(1);
  return x.toFixed(a >= 1000 ? 0 : a >= 100 ? 1 : a >= 1 ? 2 : 3);
}

/** Draws curves of points [x, y] in a frame with its ranges. */
export function curves(context, area, ranges, lines) {
  const { x, y, width, height } = area;
  const [x0, x1, y0, y1] = ranges;
  const px = (t) => x + ((t - x0) / (x1 - x0 || 1)) * width;
  const py = (v) => y + height - ((v - y0) / (y1 - y0 || 1)) * height;
  context.save();
  context.beginPath();
  context.rect(x, y, width, height);
  context.clip();
  lines.forEach(({ points, colour }) => {
    context.strokeStyle = colour;
    context.lineWidth = 1.4;
    context.beginPath();
    let isDrawn = false;
    for (const [t, v] of points) {
      if (v === null || !Number.isFinite(v)) {
        isDrawn = false;
        continue;
      }
      if (isDrawn) context.lineTo(px(t), py(v));
      else context.moveTo(px(t), py(v));
      isDrawn = true;
    }
    context.stroke();
  });
  context.restore();
}

/** The least and the largest value, a little wider, never empty. */
export function range(lines) {
  let low = Infinity, high = -Infinity;
  for (const { points } of lines) {
    for (const [, v] of points) {
      if (v === null || !Number.isFinite(v)) continue;
      low = Math.min(low, v);
      high = Math.max(high, v);
    }
  }
  if (!(low <= high)) return [0, 1];
  const rest = Math.max((high - low) * 0.08, Math.abs(high) * 1e-3, 1e-6);
  return [low - rest, high + rest];
}

/** What is shown of every machine that has it: title, unit, and the value among the newest. */
const USUAL = [
  ["M0", "counts", (v) => v["tactile_servo.features"]?.m0],
  ["x_c", "tactels", (v) => (v["tactile_servo.features"]?.defined & CONTACT ? v["tactile_servo.features"].x_c : v["tactile_servo.features"] ? null : undefined)],
  ["force on finger", "N", (v) => v["world.truth"]?.finger_normal_n],
  ["tool z", "mm", (v) => (v["world.truth"] ? v["world.truth"].tool_m[2] * 1e3 : undefined)],
];

export class Traces {
  #strips = [];

  constructor(list) {
    this.list = list;
    this.added = [];
  }

  #strip(title, unit, value) {
    const element = document.createElement("div");
    element.className = "trace";
    const canvas = document.createElement("canvas");
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", `Trace of ${title}`);
    element.append(canvas);
    this.list.append(element);
    const strip = { title, unit, value, element, canvas, points: [] };
    this.#strips.push(strip);
    return strip;
  }

  /** Shows the signals with these names besides the usual ones. */
  setAdded(paths) {
    for (const strip of this.#strips.filter((s) => s.path && !paths.includes(s.path))) {
      strip.element.remove();
      this.#strips = this.#strips.filter((s) => s !== strip);
    }
    for (const path of paths) {
      if (this.#strips.some((s) => s.path === path)) continue;
      const strip = this.#strip(path, "", (v) => {
        const value = v[path];
        return Array.isArray(value) ? value[0] : typeof value === "number" ? value : undefined;
      });
      strip.path = path;
    }
    this.added = paths;
  }

  /** Takes in the newest values at a time (s). */
  add(values, t) {
    for (const [title, unit, value] of USUAL) {
      const has = value(values) !== undefined;
      if (has && !this.#strips.some((s) => s.title === title)) this.#strip(title, unit, value);
    }
    for (const strip of this.#strips) {
      const value = strip.value(values);
      if (value === undefined) continue;
      const points = strip.points;
      if (points.length && t < points[points.length - 1][0]) points.length = 0;
      points.push([t, value]);
      while (points.length > SAMPLES_MAX || (points.length && points[0][0] < t - SECONDS)) points.shift();
    }
  }

  draw() {
    this.#strips.forEach((strip, i) => {
      const { context, width, height } = fitted(strip.canvas);
      const points = strip.points;
      if (!points.length || width < 10) return;
      const end = points[points.length - 1][0];
      const line = [{ points, colour: COLOURS[i % COLOURS.length] }];
      const [low, high] = range(line);
      const area = { x: 0, y: 14, width: width - 52, height: height - 17 };
      context.strokeStyle = "#d5dce1";
      context.strokeRect(area.x + 0.5, area.y + 0.5, area.width, area.height);
      curves(context, area, [end - SECONDS, end, low, high], line);
      context.fillStyle = "#1b2229";
      context.font = "11px sans-serif";
      context.fillText(`${strip.title}${strip.unit ? `, ${strip.unit}` : ""}`, 2, 10);
      context.fillStyle = "#4c5863";
      context.font = "10px sans-serif";
      context.fillText(short(high), width - 48, area.y + 8);
      context.fillText(short(low), width - 48, area.y + area.height);
      context.fillStyle = COLOURS[i % COLOURS.length];
      context.font = "bold 11px sans-serif";
      context.fillText(short(points[points.length - 1][1]), width - 48, area.y + area.height / 2 + 4);
    });
  }
}
