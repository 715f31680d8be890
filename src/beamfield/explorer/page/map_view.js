// The map with the robot, its scan and what a model says of it. Two of them may show the same moment.
import { CAUSES, shaded, sharp } from "./pictures.js";
import { largest } from "./words.js";

// Pixels: size of the robot, and how near a pointer must come to it, to the tip of its arrow, or to a reading.
const ROBOT = 11, ARROW = 46, GRAB = 20, NEAR = 26;

export class MapView {
  // `state` has view, pose, way, picture, start, answer, run, beam and i; `set` and `heat` are this map's own.
  constructor({ canvas }, state) {
    Object.assign(this, { canvas, state, set: null, heat: null });
    this.measure();
  }

  // Once a frame: the page is laid out for it.
  measure() { this.width = this.canvas.clientWidth; this.height = this.canvas.clientHeight; }

  draw() {
    this.frame ??= requestAnimationFrame(() => {
      this.frame = null;
      this.measure();
      if (this.width) this.drawAll();
    });
  }

  drawAll() {
    const { state } = this, colours = state.colours, context = sharp(this.canvas, { alpha: false }), { map } = state.start;
    context.fillStyle = colours.unknown;
    context.fillRect(0, 0, this.width, this.height);
    if (state.picture) this.drawImage(context, state.picture, map.origin, map.width_m, map.height_m, state.view.scale * map.width_m / state.picture.width < 1);
    if (this.heat) this.drawHeat(context, colours);
    this.drawWays(context, colours);
    if (state.answer && this.set !== null) { this.drawExpected(context, colours); this.drawReadings(context, colours); }
    this.drawRobot(context, colours);
    this.drawScale(context, colours);
  }

  // An image whose lower-left corner lies at a pose of the map.
  drawImage(context, image, [x, y, heading], width, height, smooth) {
    const [screenX, screenY] = this.toScreen([x, y]), { scale } = this.state.view;
    context.save();
    context.imageSmoothingEnabled = smooth;
    context.translate(screenX, screenY);
    context.rotate(-heading);
    context.drawImage(image, 0, -height * scale, width * scale, height * scale);
    context.restore();
  }

  drawHeat(context, colours) {
    const { heat } = this;
    heat.image ??= shaded(heat, colours.heat);
    this.drawImage(context, heat.image, heat.origin, heat.cols * heat.step_m, heat.rows * heat.step_m, true);
    const [x, y] = this.toScreen(heat.best);
    context.strokeStyle = colours.belief; context.lineWidth = 2.5;
    context.beginPath(); context.moveTo(x - 7, y); context.lineTo(x + 7, y); context.moveTo(x, y - 7); context.lineTo(x, y + 7); context.stroke();
  }

  drawWays(context, colours) {
    const { way, run, i } = this.state;
    this.drawLine(context, way, colours.quiet, 1.2);
    if (!run) return;
    this.drawLine(context, run.poses, colours.belief, 1.8);
    const at = run.updates.filter((k) => k <= i).pop();
    context.strokeStyle = context.fillStyle = colours.belief; context.lineWidth = 1;
    for (const [px, py, heading] of run.particles[at] ?? []) {
      const [x, y] = this.toScreen([px, py]);
      context.fillRect(x - 1.5, y - 1.5, 3, 3);
      context.beginPath(); context.moveTo(x, y); context.lineTo(x + 7 * Math.cos(heading), y - 7 * Math.sin(heading)); context.stroke();
    }
  }

  drawLine(context, points, colour, width) {
    context.strokeStyle = colour; context.lineWidth = width; context.beginPath();
    let drawing = false;
    for (const point of points) {
      if (!point) { drawing = false; continue; }
      const [x, y] = this.toScreen(point);
      if (drawing) context.lineTo(x, y); else context.moveTo(x, y);
      drawing = true;
    }
    context.stroke();
  }

  drawExpected(context, colours) {
    context.globalAlpha = 0.7;
    this.drawLine(context, this.ends(this.state.answer.expected), colours.quiet, 1);
    context.globalAlpha = 1;
  }

  drawReadings(context, colours) {
    const { answer, start, beam, pose } = this.state, { kind } = start.sets[this.set], shares = answer.shares[this.set];
    this.ends(answer.ranges).forEach((end, k) => {
      const share = shares?.[k];
      if (!end || (kind === "beam" && !share)) return;
      context.fillStyle = kind === "beam" ? colours[CAUSES[largest(share)]] : kind === "stack" ? colours.hit : !share ? colours.quiet : share[0] > 0.5 ? colours.hit : colours.short;
      const [x, y] = this.toScreen(end);
      context.beginPath(); context.arc(x, y, k === beam ? 5 : 2.6, 0, 2 * Math.PI); context.fill();
      if (k === beam) this.drawLine(context, [pose, end], colours.ink, 1);
    });
  }

  drawRobot(context, colours) {
    const { pose, start, i } = this.state, reference = start.poses[i];
    if (reference && Math.hypot(reference[0] - pose[0], reference[1] - pose[1], reference[2] - pose[2]) > 1e-3) {
      context.setLineDash([4, 3]);
      this.drawBody(context, reference, colours.quiet, 2);
      context.setLineDash([]);
    }
    this.drawBody(context, pose, colours.panel, 6);
    this.drawBody(context, pose, colours.ink, 3);
    const [x, y] = this.toScreen(pose), [tipX, tipY] = this.tip();
    context.fillStyle = colours.ink;
    context.beginPath(); context.arc(tipX, tipY, 6, 0, 2 * Math.PI); context.fill();
    Object.assign(this.canvas.dataset, { robot: `${x} ${y}`, tip: `${tipX} ${tipY}` }); // for whoever drives the page
  }

  drawBody(context, pose, colour, width) {
    const [x, y] = this.toScreen(pose), cos = Math.cos(pose[2]), sin = Math.sin(pose[2]);
    context.strokeStyle = colour; context.lineWidth = width; context.beginPath();
    context.arc(x, y, ROBOT, 0, 2 * Math.PI);
    context.moveTo(x + ROBOT * cos, y - ROBOT * sin); context.lineTo(x + ARROW * cos, y - ARROW * sin);
    context.stroke();
  }

  drawScale(context, colours) {
    const { scale } = this.state.view, metres = [0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50].find((m) => m * scale > 44) ?? 100;
    const right = this.width - 14, y = this.height - 14;
    context.strokeStyle = context.fillStyle = colours.ink; context.lineWidth = 2; context.font = "12px system-ui, sans-serif"; context.textAlign = "right";
    context.beginPath(); context.moveTo(right - metres * scale, y); context.lineTo(right, y); context.stroke();
    context.fillText(`${metres} m`, right, y - 6);
  }

  // Where beams of given ranges end in the map, from the robot's pose now; null where there is none.
  ends(ranges) {
    const [x, y, heading] = this.state.pose, cos = Math.cos(heading), sin = Math.sin(heading);
    return this.state.start.mounts.map(([mx, my, turn], beam) => {
      const range = ranges[beam];
      if (range === null || range === undefined) return null;
      const bx = mx + range * Math.cos(turn), by = my + range * Math.sin(turn);
      return [x + cos * bx - sin * by, y + sin * bx + cos * by];
    });
  }

  toScreen([x, y]) {
    const { view } = this.state;
    return [this.width / 2 + (x - view.x) * view.scale, this.height / 2 - (y - view.y) * view.scale];
  }

  toMap(screenX, screenY) {
    const { view } = this.state;
    return [view.x + (screenX - this.width / 2) / view.scale, view.y - (screenY - this.height / 2) / view.scale];
  }

  tip() {
    const { pose } = this.state, [x, y] = this.toScreen(pose);
    return [x + ARROW * Math.cos(pose[2]), y - ARROW * Math.sin(pose[2])];
  }

  // The reading whose end is nearest to the pointer; null if none is near.
  readingAt(screenX, screenY) {
    if (!this.state.answer) return null;
    let best = null, nearest = NEAR;
    this.ends(this.state.answer.ranges).forEach((end, beam) => {
      if (!end) return;
      const [x, y] = this.toScreen(end), off = Math.hypot(x - screenX, y - screenY);
      if (off < nearest) { best = beam; nearest = off; }
    });
    return best;
  }

  zoom(ratio, screenX = this.width / 2, screenY = this.height / 2) {
    const { view } = this.state, [x, y] = this.toMap(screenX, screenY);
    view.scale = Math.max(1, Math.min(400, view.scale * ratio));
    const [nowX, nowY] = this.toMap(screenX, screenY);
    view.x += x - nowX; view.y += y - nowY;
    this.state.draw();
  }

  // Pointers: the robot and its arrow are dragged, all else pans, two fingers zoom. `moved` gets a pose, `pointed` a beam.
  listen({ moved, pointed }) {
    const { canvas, state } = this, fingers = new Map();
    let grabbed = null;
    const point = (x, y) => { const beam = this.readingAt(x, y); if (beam !== null) pointed(beam); };
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      fingers.set(event.pointerId, [event.offsetX, event.offsetY]);
      const [x, y] = this.toScreen(state.pose), [tipX, tipY] = this.tip();
      if (Math.hypot(event.offsetX - tipX, event.offsetY - tipY) < GRAB) grabbed = "turn";
      else if (Math.hypot(event.offsetX - x, event.offsetY - y) < GRAB) grabbed = "move";
      else { grabbed = "pan"; point(event.offsetX, event.offsetY); }
    });
    canvas.addEventListener("pointermove", (event) => {
      // The robot stays in sight when the pointer leaves the map.
      const before = fingers.get(event.pointerId), now = [clamped(event.offsetX, this.width), clamped(event.offsetY, this.height)];
      if (!before) { point(...now); this.showCursor(...now); return; }
      if (fingers.size === 2) {
        const other = [...fingers.entries()].find(([id]) => id !== event.pointerId)[1];
        const apart = ([x, y]) => Math.hypot(x - other[0], y - other[1]);
        this.zoom(apart(now) / apart(before), ...other);
      } else if (grabbed === "pan") {
        state.view.x -= (now[0] - before[0]) / state.view.scale;
        state.view.y += (now[1] - before[1]) / state.view.scale;
        state.draw();
      } else {
        const [x, y] = this.toMap(...now), [oldX, oldY, heading] = state.pose;
        moved(grabbed === "move" ? [x, y, heading] : [oldX, oldY, Math.atan2(y - oldY, x - oldX)]);
      }
      fingers.set(event.pointerId, now);
    });
    for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, (event) => fingers.delete(event.pointerId));
    canvas.addEventListener("wheel", (event) => { event.preventDefault(); this.zoom(Math.exp(-event.deltaY / 500), event.offsetX, event.offsetY); }, { passive: false });
  }

  showCursor(screenX, screenY) {
    const near = ([x, y]) => Math.hypot(x - screenX, y - screenY) < GRAB;
    this.canvas.style.cursor = near(this.tip()) || near(this.toScreen(this.state.pose)) ? "grab" : "crosshair";
  }
}

const clamped = (value, end) => Math.max(0, Math.min(end, value));
