// The tactile image as a heat map, with its centroid and main axis. The colours are those of the
// cividis map, which colour-blind people read as others do.

const CIVIDIS = [
  [0, 32, 76], [0, 45, 110], [43, 62, 107], [72, 78, 107], [95, 95, 110], [116, 112, 117],
  [139, 130, 120], [163, 149, 117], [189, 169, 108], [215, 191, 93], [242, 215, 68], [255, 234, 70],
];

function colour(share) {
  const x = Math.min(1, Math.max(0, share)) * (CIVIDIS.length - 1);
  const i = Math.min(CIVIDIS.length - 2, Math.floor(x)), f = x - i;
  return CIVIDIS[i].map((v, k) => Math.round(v + f * (CIVIDIS[i + 1][k] - v)));
}

/** Bits of what an image defines: there is load, and there may be load that it does not show. */
export const CONTACT = 1;
const CONTACT_UNCERTAIN = 8;

/** Counts that fill the scale at least, so that noise stays dark. */
const FULL_COUNTS_MIN = 300;

export class TouchView {
  #figures = new Map();

  constructor(list, text) {
    this.list = list;
    this.text = text;
  }

  /** Draws the images among the newest values; says whether there are any. */
  draw(values) {
    const images = Object.keys(values).filter((path) => path.endsWith(".image.counts"));
    for (const path of images) {
      const signal = path.slice(0, -".counts".length);
      const task = signal.split(".")[0];
      const features = values[`${task.replace("scan", "servo")}.features`]
        ?? (images.length === 1 ? values["tactile_servo.features"] : null);
      this.#image(signal, values, features);
    }
    const features = values["tactile_servo.features"];
    if (features) {
      const number = (x, digits) => (x === null || x === undefined ? "–" : x.toFixed(digits));
      const angle = features.theta_z_rad === null ? null : (features.theta_z_rad * 180) / Math.PI;
      const without = features.defined & CONTACT_UNCERTAIN ? "contact not known" : "no contact";
      this.text.textContent = features.defined & CONTACT
        ? `M0 ${number(features.m0, 0)} counts · centroid ${number(features.x_c, 2)}, ${number(features.y_c, 2)} · axis ${number(angle, 1)} deg · strokes ${features.reversals}`
        : `M0 ${number(features.m0, 0)} counts · ${without}`;
    } else {
      this.text.textContent = images.length ? "" : "this machine feels nothing";
    }
    return images.length > 0;
  }

  #figure(signal) {
    let figure = this.#figures.get(signal);
    if (!figure) {
      const element = document.createElement("figure");
      const canvas = document.createElement("canvas");
      canvas.setAttribute("role", "img");
      canvas.dataset.signal = signal;
      const caption = document.createElement("figcaption");
      const name = document.createElement("span"), range = document.createElement("span");
      name.textContent = signal;
      caption.append(name, range);
      element.append(canvas, caption);
      this.list.append(element);
      figure = { canvas, range, context: canvas.getContext("2d"), full: FULL_COUNTS_MIN };
      this.#figures.set(signal, figure);
    }
    return figure;
  }

  #image(signal, values, features) {
    const counts = values[`${signal}.counts`];
    const rows = values[`${signal}.rows`], cols = values[`${signal}.cols`];
    const valid = values[`${signal}.valid`];
    if (!counts || !rows || !cols) return;
    const figure = this.#figure(signal);
    const { canvas, context } = figure;
    const cell = Math.max(4, Math.floor(320 / Math.max(rows, cols)));
    if (canvas.width !== cols * cell || canvas.height !== rows * cell) {
      canvas.width = cols * cell;
      canvas.height = rows * cell;
      canvas.style.aspectRatio = `${cols} / ${rows}`;
    }
    let most = 0;
    for (let i = 0; i < rows * cols; i++) most = Math.max(most, counts[i] ?? 0);
    // The scale follows upwards at once and downwards slowly.
    figure.full = Math.max(FULL_COUNTS_MIN, most, figure.full * 0.98);
    for (let r = 0; r < rows; r++) {
      for (let c = 0; c < cols; c++) {
        const at = r * cols + c;
        const [x, y] = [c * cell, (rows - 1 - r) * cell];
        const [red, green, blue] = colour((counts[at] ?? 0) / figure.full);
        context.fillStyle = `rgb(${red},${green},${blue})`;
        context.fillRect(x, y, cell, cell);
        if (valid && !valid[at]) {
          context.strokeStyle = "#ffffff";
          context.lineWidth = 1;
          context.strokeRect(x + 1.5, y + 1.5, cell - 3, cell - 3);
        }
      }
    }
    const shown = `0 to ${figure.full.toFixed(0)} counts`;
    figure.range.textContent = shown;
    canvas.setAttribute("aria-label", `Tactile image of ${rows} by ${cols}, largest ${most.toFixed(0)} counts`);
    canvas.dataset.largest = most.toFixed(0);
    if (features?.defined & CONTACT) this.#axis(context, features, rows, cell);
  }

  #axis(context, features, rows, cell) {
    // Rows and columns are counted from one, and the angle from the rows' own axis, y, towards -x.
    const x = (features.x_c - 0.5) * cell, y = (rows - features.y_c + 0.5) * cell;
    const angle = features.theta_z_rad ?? 0;
    const length = cell * rows * 0.45;
    const [dx, dy] = [-Math.sin(angle) * length, -Math.cos(angle) * length];
    for (const [width, style] of [[5, "#00204c"], [2, "#ffffff"]]) {
      context.strokeStyle = style;
      context.lineWidth = width;
      context.beginPath();
      context.moveTo(x - dx, y - dy);
      context.lineTo(x + dx, y + dy);
      context.stroke();
      context.beginPath();
      context.arc(x, y, cell * 0.45, 0, 2 * Math.PI);
      context.stroke();
    }
  }
}
