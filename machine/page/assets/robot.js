// Draws the arm from the frames that the machine tells of it, with the pin, the table and objects
// where they are simulated. Solids of flat faces, painted from the far ones to the near ones.

const LIGHT = normalized([0.35, -0.5, 0.8]);

function normalized(v) {
  const l = Math.hypot(...v) || 1;
  return v.map((x) => x / l);
}
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const sub = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
const add = (a, b) => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
const scale = (a, s) => [a[0] * s, a[1] * s, a[2] * s];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];

// A frame is twelve numbers: three rows of rotation and place.
const IDENTITY = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0];
function product(a, b) {
  const c = new Array(12);
  for (let i = 0; i < 3; i++) {
    for (let j = 0; j < 4; j++) {
      let sum = j === 3 ? a[4 * i + 3] : 0;
      for (let k = 0; k < 3; k++) sum += a[4 * i + k] * b[4 * k + j];
      c[4 * i + j] = sum;
    }
  }
  return c;
}
const turnAboutZ = (q) => {
  const s = Math.sin(q), c = Math.cos(q);
  return [c, -s, 0, 0, s, c, 0, 0, 0, 0, 1, 0];
};
const place = (f) => [f[3], f[7], f[11]];
const column = (f, j) => [f[j], f[4 + j], f[8 + j]];

/** The frames of the joints and of the tool at joint angles (rad). */
export function frames(model, q) {
  const all = [];
  let at = IDENTITY;
  model.joints.forEach((joint, i) => {
    at = product(product(at, joint.origin), turnAboutZ(q[i] ?? 0));
    all.push(at);
  });
  return { joints: all, tool: product(at, model.tool) };
}

function perpendicular(axis) {
  const other = Math.abs(axis[2]) < 0.9 ? [0, 0, 1] : [1, 0, 0];
  const x = normalized(cross(other, axis));
  return [x, cross(axis, x)];
}

/** Faces of a cone or cylinder between two points. */
function tube(from, to, r0, r1, colour, sides = 14) {
  const axis = normalized(sub(to, from));
  const [x, y] = perpendicular(axis);
  const ring = (centre, r) => Array.from({ length: sides }, (_, i) => {
    const a = (2 * Math.PI * i) / sides;
    return add(centre, add(scale(x, r * Math.cos(a)), scale(y, r * Math.sin(a))));
  });
  const low = ring(from, r0), high = ring(to, r1);
  const faces = low.map((p, i) => {
    const j = (i + 1) % sides;
    return { points: [p, low[j], high[j], high[i]], colour };
  });
  faces.push({ points: [...low].reverse(), colour }, { points: high, colour });
  return faces;
}

function box(frame, half, colour) {
  const [x, y, z] = [0, 1, 2].map((j) => column(frame, j));
  const centre = place(frame);
  const corner = (i, j, k) =>
    add(centre, add(scale(x, i * half[0]), add(scale(y, j * half[1]), scale(z, k * half[2]))));
  const sides = [
    [[-1, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1]],
    [[-1, 1, -1], [1, 1, -1], [1, -1, -1], [-1, -1, -1]],
    [[-1, -1, -1], [1, -1, -1], [1, -1, 1], [-1, -1, 1]],
    [[1, 1, -1], [-1, 1, -1], [-1, 1, 1], [1, 1, 1]],
    [[1, -1, -1], [1, 1, -1], [1, 1, 1], [1, -1, 1]],
    [[-1, 1, -1], [-1, -1, -1], [-1, -1, 1], [-1, 1, 1]],
  ];
  return sides.map((side) => ({ points: side.map((c) => corner(...c)), colour }));
}

function reach(model) {
  const lengths = [...model.joints.map((joint) => joint.origin), model.tool].map((f) => Math.hypot(...place(f)));
  return Math.max(0.2, lengths.reduce((a, b) => a + b, 0));
}

const BODY = [224, 228, 231], JOINT = [58, 78, 96], FINGER = [213, 94, 0], TIP = [230, 159, 0];
const PIN = [86, 180, 233], MARK = [0, 61, 107], OBJECT = [140, 170, 140];

function armSolids(model, at, hasFinger) {
  const faces = [];
  const size = reach(model);
  const last = at.joints.length - 1;
  const radius = (i) => size * (0.058 - (0.026 * i) / Math.max(1, last));
  const base = place(at.joints[0]);
  const foot = [base[0], base[1], Math.min(model.floor ?? 0, base[2] - 0.02 * size)];
  faces.push(...tube(foot, add(foot, [0, 0, 0.012 * size]), size * 0.13, size * 0.13, JOINT, 20));
  faces.push(...tube(foot, base, size * 0.075, size * 0.062, BODY, 18));
  at.joints.forEach((frame, i) => {
    const p = place(frame), axis = column(frame, 2), r = radius(i);
    const half = scale(axis, r * 1.15);
    faces.push(...tube(sub(p, half), add(p, half), r, r, JOINT, 16));
    const next = i < last ? place(at.joints[i + 1]) : place(at.tool);
    if (Math.hypot(...sub(next, p)) > 1e-4) {
      const isTool = i === last;
      const thin = isTool ? 0.45 : 0.8;
      faces.push(...tube(p, next, r * thin, (isTool ? r * 0.3 : radius(i + 1) * 0.8), isTool ? FINGER : BODY));
    }
  });
  if (hasFinger) {
    const frame = [...at.tool];
    const z = column(frame, 2);
    const p = sub(place(frame), scale(z, 0.004));
    [frame[3], frame[7], frame[11]] = p;
    faces.push(...box(frame, [0.0135, 0.0135, 0.004], TIP));
  }
  return faces;
}

function tableFrame(world, truth) {
  const table = world.table;
  const [a, b, c] = [truth?.table_tilt_x_rad ?? 0, truth?.table_tilt_y_rad ?? 0, truth?.table_pan_rad ?? 0];
  const rx = [1, 0, 0, 0, 0, Math.cos(a), -Math.sin(a), 0, 0, Math.sin(a), Math.cos(a), 0];
  const ry = [Math.cos(-b), 0, Math.sin(-b), 0, 0, 1, 0, 0, -Math.sin(-b), 0, Math.cos(-b), 0];
  const turned = product(product(turnAboutZ(c), ry), rx);
  [turned[3], turned[7], turned[11]] = [table.x_m, table.y_m, table.z_m];
  return turned;
}

function tableTiles(frame) {
  const faces = [];
  const [x, y] = [column(frame, 0), column(frame, 1)];
  const n = 8, size = 0.36;
  for (let i = 0; i < n; i++) {
    for (let j = 0; j < n; j++) {
      const at = (u, v) => add(place(frame), add(scale(x, (u / n - 0.5) * size), scale(y, (v / n - 0.5) * size)));
      const colour = (i + j) % 2 ? [214, 205, 188] : [203, 193, 174];
      faces.push({ points: [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)], colour });
    }
  }
  return faces;
}

function pinSolids(world, truth) {
  const r = world.pin.radius_m, l = world.pin.length_m;
  const axis = normalized(truth.pin_axis), centre = truth.pin_m;
  const half = scale(axis, l / 2);
  const sides = 28;
  const [x, y] = perpendicular(axis);
  const point = (c, k, turn) => {
    const a = (2 * Math.PI * k) / sides + turn;
    return add(c, add(scale(x, r * Math.cos(a)), scale(y, r * Math.sin(a))));
  };
  const [low, high] = [sub(centre, half), add(centre, half)];
  const faces = [];
  const turn = truth.pin_roll_rad ?? 0;
  for (let k = 0; k < sides; k++) {
    const colour = k % 7 === 0 ? MARK : PIN;
    faces.push({ points: [point(low, k, turn), point(low, k + 1, turn), point(high, k + 1, turn), point(high, k, turn)], colour });
  }
  const ring = (c) => Array.from({ length: sides }, (_, k) => point(c, k, turn));
  faces.push({ points: ring(low).reverse(), colour: PIN }, { points: ring(high), colour: PIN });
  return faces;
}

function objectSolids(world, table) {
  const faces = [];
  for (const object of world.objects ?? []) {
    const frame = product(table, product([1, 0, 0, object.x_m, 0, 1, 0, object.y_m, 0, 0, 1, object.top_m], turnAboutZ(object.yaw_rad)));
    const z = column(frame, 2);
    const top = place(frame), foot = sub(top, scale(z, object.top_m));
    if (object.kind === "sphere") {
      const centre = sub(top, scale(z, object.radius_m));
      for (let i = 0; i < 6; i++) {
        const [u, v] = [(i / 6 - 0.5) * Math.PI, ((i + 1) / 6 - 0.5) * Math.PI];
        faces.push(...tube(add(centre, scale(z, object.radius_m * Math.sin(u))), add(centre, scale(z, object.radius_m * Math.sin(v))),
          object.radius_m * Math.cos(u), object.radius_m * Math.cos(v), OBJECT).slice(0, 14));
      }
      faces.push(...tube(foot, centre, 0.004, 0.004, JOINT));
    } else {
      const half = [object.kind === "bar" ? object.width_m / 2 : Math.max(object.radius_m, 0.001), object.length_m / 2, object.top_m / 2];
      const middle = product(frame, [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, -object.top_m / 2]);
      faces.push(...box(middle, half, OBJECT));
    }
  }
  return faces;
}

const VIEWS = {
  side: { azimuth: -1.05, elevation: 0.3, zoom: 1 },
  front: { azimuth: 0, elevation: 0.16, zoom: 1 },
  top: { azimuth: -1.57, elevation: 1.5, zoom: 1 },
  finger: { azimuth: -1.2, elevation: 0.12, zoom: 3.2, follows: true },
};

export class RobotView {
  model = null;
  world = null;
  q = [];
  truth = null;
  hasFinger = false;
  view = { ...VIEWS.side };
  drawn = 0;

  constructor(canvas) {
    this.canvas = canvas;
    this.context = canvas.getContext("2d");
    new ResizeObserver(() => this.draw()).observe(canvas);
    this.#listen();
  }

  choose(name) {
    this.view = { ...VIEWS[name] };
    this.draw();
  }

  #listen() {
    const canvas = this.canvas;
    let last = null;
    canvas.addEventListener("pointerdown", (event) => {
      last = [event.clientX, event.clientY];
      canvas.setPointerCapture(event.pointerId);
    });
    canvas.addEventListener("pointermove", (event) => {
      if (!last) return;
      this.#orbit((event.clientX - last[0]) * 0.008, (event.clientY - last[1]) * 0.008);
      last = [event.clientX, event.clientY];
    });
    for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, () => { last = null; });
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.#zoom(Math.exp(-event.deltaY * 0.001));
    }, { passive: false });
    canvas.addEventListener("keydown", (event) => {
      const steps = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, -0.1], ArrowDown: [0, 0.1] };
      if (steps[event.key]) this.#orbit(...steps[event.key]);
      else if (event.key === "+" || event.key === "=") this.#zoom(1.15);
      else if (event.key === "-") this.#zoom(1 / 1.15);
      else return;
      event.preventDefault();
    });
  }

  #orbit(turn, rise) {
    this.view.azimuth -= turn;
    this.view.elevation = Math.min(1.55, Math.max(-0.3, this.view.elevation + rise));
    this.draw();
  }

  #zoom(factor) {
    this.view.zoom = Math.min(12, Math.max(0.4, this.view.zoom * factor));
    this.draw();
  }

  /** The camera: axes, centre and scale; also written to the canvas for whoever checks a drawing. */
  camera(tool) {
    const { azimuth, elevation, zoom } = this.view;
    const toward = [Math.cos(elevation) * Math.cos(azimuth), Math.cos(elevation) * Math.sin(azimuth), Math.sin(elevation)];
    const right = normalized(cross([0, 0, 1], toward));
    const up = cross(toward, right);
    const size = reach(this.model);
    const floor = this.model.floor ?? 0;
    // The middle of where the arm works, or its finger. An arm at a table works above that; any other one all around its base.
    const hasTable = Boolean(this.world?.table);
    const middle = hasTable ? [0.2 * size, -0.09 * size, floor + 0.26 * size] : [0, 0, floor + 0.33 * size];
    const centre = this.view.follows && tool ? tool : middle;
    const rect = this.canvas.getBoundingClientRect();
    const extent = (hasTable ? 1.2 : 1.4) * size;
    const pixels = (Math.min(rect.width, rect.height * 1.25) / extent) * zoom;
    return { right, up, toward, centre, pixels, width: rect.width, height: rect.height, far: 3.2 * size };
  }

  draw() {
    const { canvas, context } = this;
    const rect = canvas.getBoundingClientRect();
    const ratio = Math.min(2, window.devicePixelRatio || 1);
    if (canvas.width !== Math.round(rect.width * ratio) || canvas.height !== Math.round(rect.height * ratio)) {
      canvas.width = Math.round(rect.width * ratio);
      canvas.height = Math.round(rect.height * ratio);
    }
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, rect.width, rect.height);
    if (!this.model || !rect.width) return;
    const at = frames(this.model, this.q);
    const camera = this.camera(place(at.tool));
    const project = (p) => {
      const d = sub(p, camera.centre);
      const depth = dot(d, camera.toward);
      const near = camera.far / (camera.far - depth);
      return [
        camera.width / 2 + dot(d, camera.right) * camera.pixels * near,
        camera.height / 2 - dot(d, camera.up) * camera.pixels * near,
        depth,
      ];
    };
    this.#floor(project);
    if (this.world?.table) {
      this.#paint(tableTiles(tableFrame(this.world, this.truth)), project, camera, false);
    }
    const faces = armSolids(this.model, at, this.hasFinger);
    if (this.world?.pin && this.truth?.pin_m) faces.push(...pinSolids(this.world, this.truth));
    if (this.world?.objects && this.world.table) {
      faces.push(...objectSolids(this.world, tableFrame(this.world, this.truth)));
    }
    this.#paint(faces, project, camera, true);
    this.#axes(at.tool, project);
    this.drawn++;
    const tip = project(place(at.tool));
    canvas.dataset.tool = JSON.stringify(place(at.tool).map((x) => Math.round(x * 1e5) / 1e5));
    canvas.dataset.tip = JSON.stringify(tip.slice(0, 2).map(Math.round));
    canvas.dataset.camera = JSON.stringify(camera);
  }

  #floor(project) {
    const { context } = this;
    const z = (this.model.floor ?? 0);
    const size = Math.ceil(reach(this.model) * 10) / 10;
    context.lineWidth = 1;
    context.strokeStyle = "#dde3e7";
    context.beginPath();
    for (let k = -size; k <= size + 1e-9; k += 0.1) {
      for (const [a, b] of [[[k, -size, z], [k, size, z]], [[-size, k, z], [size, k, z]]]) {
        const [p, q] = [project(a), project(b)];
        context.moveTo(p[0], p[1]);
        context.lineTo(q[0], q[1]);
      }
    }
    context.stroke();
  }

  #paint(faces, project, camera, isSorted) {
    const { context } = this;
    const eye = add(camera.centre, scale(camera.toward, camera.far));
    const seen = [];
    for (const face of faces) {
      const [a, b, c] = face.points;
      const normal = normalized(cross(sub(b, a), sub(c, a)));
      if (dot(normal, sub(eye, a)) <= 0) continue;
      const points = face.points.map(project);
      const depth = points.reduce((sum, p) => sum + p[2], 0) / points.length;
      const shade = 0.62 + 0.38 * Math.max(0, dot(normal, LIGHT));
      seen.push({ points, depth, colour: face.colour.map((v) => Math.round(v * shade)) });
    }
    if (isSorted) seen.sort((p, q) => p.depth - q.depth);
    context.lineJoin = "round";
    for (const { points, colour } of seen) {
      const fill = `rgb(${colour.join(",")})`;
      context.beginPath();
      points.forEach((p, i) => (i ? context.lineTo(p[0], p[1]) : context.moveTo(p[0], p[1])));
      context.closePath();
      context.fillStyle = fill;
      context.strokeStyle = fill;
      context.lineWidth = 0.7;
      context.fill();
      context.stroke();
    }
  }

  #axes(tool, project) {
    const { context } = this;
    const length = 0.06 * reach(this.model);
    const from = project(place(tool));
    ["#d55e00", "#009e73", "#0072b2"].forEach((colour, j) => {
      const to = project(add(place(tool), scale(column(tool, j), length)));
      context.strokeStyle = colour;
      context.lineWidth = 2;
      context.beginPath();
      context.moveTo(from[0], from[1]);
      context.lineTo(to[0], to[1]);
      context.stroke();
      context.fillStyle = colour;
      context.font = "10px sans-serif";
      context.fillText("xyz"[j], to[0] + 2, to[1] - 2);
    });
  }
}
