// The explorer: a log in its map, and what models say of a scan at a pose. `ask` sends a message and returns a promise
// of the answer, so the same component runs on a page of its own and in a notebook.

const CAUSES = ["hit", "short", "max", "rand"];
const CAUSE_WORDS = { hit: "hit", short: "short: something unmapped", max: "no return", rand: "unexplained" };
// Pixels: size of the robot, and how near a pointer must come to it, to the tip of its arrow, or to a reading.
const ROBOT = 11, ARROW = 46, GRAB = 20, NEAR = 26;
const HEAT_WIDTH = 4; // metres
const FRAME_MS = 100; // between two scans while playing

export async function mount(root, ask, place = null) {
  const page = build(root, place !== null);
  const start = await ask({ name: "start" }).catch((error) => fail(page, error));
  if (!start) return null;
  const explorer = new Explorer(page, start, ask, place);
  await explorer.begin();
  return explorer;
}

function fail(page, error) {
  page.trouble.textContent = error.message;
  return null;
}

// An element with properties and children; text never becomes markup.
function make(tag, properties = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(properties)) {
    if (name.startsWith("aria-") || name === "role" || name === "for") element.setAttribute(name, value);
    else element[name] = value;
  }
  element.append(...children);
  return element;
}

function button(text, title, pressed = null) {
  const made = make("button", { type: "button", textContent: text, title });
  if (pressed !== null) made.setAttribute("aria-pressed", String(pressed));
  return made;
}

function build(root, hasPlace) {
  const page = {
    root,
    pose: make("span", { className: "pose" }),
    trouble: make("span", { className: "trouble", role: "alert" }),
    said: make("div", { className: "hidden", "aria-live": "polite" }),
    copy: button("Copy link", "Copy the address of this moment and pose"),
    map: make("canvas", {
      tabIndex: 0,
      role: "application",
      "aria-label":
        "Map with the robot. Arrow keys move it, square brackets turn it, with shift less; comma and full stop " +
        "change the scan; plus and minus zoom; r returns to the reference pose.",
    }),
    legend: make("ul", { className: "legend", "aria-label": "Colours of the readings" }),
    heat: button("Heat map", "How likely the scan is at places around the robot (h)", true),
    building: button("Whole building", "How likely the scan is over the whole map"),
    filter: button("Run filter", "Run a particle filter from this scan and pose on"),
    reference: button("Reference", "Put the robot back to its reference pose (r)"),
    scores: make("tbody"),
    sliders: make("div"),
    judged: make("p", { className: "note" }),
    reset: button("Reset", "Set the values back to those of the set"),
    download: button("Download file", "Save the values as a parameter file"),
    density: make("canvas", { className: "plot", role: "img", "aria-label": "Density of one reading" }),
    densityText: make("p", { className: "note" }),
    play: button("Play", "Go through the log (space)"),
    scan: make("input", { type: "range", className: "scan", min: 0, step: 1, value: 0, "aria-label": "Scan" }),
    when: make("span", { className: "pose" }),
    series: make("select", { "aria-label": "Curve of the timeline" }),
    line: make("canvas", { className: "plot line", role: "img", "aria-label": "Timeline" }),
    worst: make("div", { className: "worst" }),
  };
  page.copy.hidden = !hasPlace;
  const table = make(
    "table", {},
    make("thead", {}, make("tr", {},
      make("th", { scope: "col", textContent: "model" }),
      make("th", { scope: "col", textContent: "log p(z | x, m)", title: "nats; only differences between poses mean anything for fields" }),
      make("th", { scope: "col", textContent: "over reference", title: "nats more than at the reference pose" }))),
    page.scores);
  root.replaceChildren(
    make("header", { className: "head" }, make("h1", { textContent: "beamfield explorer" }), page.pose, page.copy, page.trouble, page.said),
    make("section", { className: "map", "aria-label": "Map" }, page.map,
      make("div", { className: "tools" }, page.heat, page.building, page.filter, page.reference), page.legend),
    make("div", { className: "side" },
      make("section", { "aria-label": "Models" }, make("h2", { textContent: "What each model says of this scan, here" }), table),
      make("section", { "aria-label": "Parameters" }, make("h2", { textContent: "Parameters of the chosen model" }), page.sliders, page.judged,
        make("div", { className: "row" }, page.reset, page.download)),
      make("section", { "aria-label": "One reading" }, make("h2", { textContent: "One reading: point at one on the map" }), page.density, page.densityText)),
    make("section", { className: "time", "aria-label": "Time" },
      make("div", { className: "row" }, page.play, page.scan, page.when, page.series), page.line, page.worst),
  );
  return page;
}

// Of several requests of one kind only the newest is sent, when the one before has been answered.
class Latest {
  constructor(ask, onError) { this.ask = ask; this.onError = onError; this.waiting = new Map(); this.busy = new Set(); }

  send(message, use) {
    if (this.busy.has(message.name)) { this.waiting.set(message.name, [message, use]); return; }
    this.busy.add(message.name);
    this.ask(message).then((answer) => { this.onError(null); use(answer); }).catch((error) => this.onError(error)).finally(() => {
      this.busy.delete(message.name);
      const next = this.waiting.get(message.name);
      this.waiting.delete(message.name);
      if (next) this.send(...next);
    });
  }
}

class Explorer {
  constructor(page, start, ask, place) {
    Object.assign(this, { page, start, place });
    this.latest = new Latest(ask, (error) => { page.trouble.textContent = error ? error.message : ""; });
    const said = place?.read() ?? {};
    const within = (value, n) => (Number.isInteger(value) && value >= 0 && value < n ? value : 0);
    this.i = within(said.i, start.times.length);
    this.set = within(said.set, start.sets.length);
    this.pose = said.pose ?? start.poses[this.i] ?? start.here;
    this.values = start.sets.map((one) => ({ ...one.values }));
    this.beam = null; this.answer = null; this.heat = null; this.run = null; this.playing = null; this.showHeat = true;
    this.view = { x: this.pose[0], y: this.pose[1], scale: 30 };
  }

  async begin() {
    const { page, start } = this;
    this.picture = await recoloured(start.map.picture, this.colours());
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", async () => {
      this.picture = await recoloured(start.map.picture, this.colours());
      this.draw();
    });
    page.scan.max = start.times.length - 1;
    for (const name of Object.keys(start.numbers)) page.series.append(new Option(name, name));
    page.series.hidden = page.line.hidden = page.series.length === 0;
    this.listWorst();
    this.listSets();
    this.listSliders();
    this.listen();
    new ResizeObserver(() => this.draw()).observe(page.map);
    this.fit();
    this.changed();
  }

  colours() {
    const style = getComputedStyle(this.page.root);
    const names = ["wall", "free", "unknown", "ink", "quiet", "line", "accent", ...CAUSES];
    return Object.fromEntries(names.map((name) => [name, style.getPropertyValue(`--${name}`).trim()]));
  }

  // Something is at another place, time or value: ask anew, and show what is known at once.
  changed() {
    const { page, start } = this;
    const [x, y, heading] = this.pose;
    page.scan.value = this.i;
    page.when.textContent = `scan ${this.i + 1} of ${start.times.length}, ${start.times[this.i].toFixed(1)} s`;
    page.pose.textContent = `x ${x.toFixed(2)} m, y ${y.toFixed(2)} m, heading ${degrees(heading).toFixed(1)}°`;
    page.reference.disabled = start.poses[this.i] === null;
    this.place?.write(this);
    this.latest.send(this.message("scan"), (answer) => { this.answer = answer; this.showScores(); this.draw(); });
    if (this.showHeat) this.askHeat();
    if (this.beam !== null) this.askDensity();
    this.draw();
    this.drawTimeline();
  }

  message(name, more = {}) {
    return { name, i: this.i, pose: this.pose, set: this.set, parameters: this.moved(), ...more };
  }

  // Only what was moved: weights that are not touched keep their ratios.
  moved() {
    const before = this.start.sets[this.set].values;
    return Object.fromEntries(Object.entries(this.values[this.set]).filter(([name, value]) => value !== before[name]));
  }

  askHeat() {
    this.latest.send(this.message("heat", { width_m: HEAT_WIDTH }), (heat) => { this.heat = this.showHeat ? heat : null; this.draw(); });
  }

  askDensity() {
    this.latest.send(this.message("density", { beam: this.beam }), (density) => this.showDensity(density));
  }

  listSets() {
    this.page.scores.replaceChildren(...this.start.sets.map((one, number) => {
      const radio = make("input", { type: "radio", name: "set", checked: number === this.set });
      radio.addEventListener("change", () => { this.set = number; this.heat = null; this.listSliders(); this.changed(); });
      const label = make("label", {}, radio, one.label);
      return make("tr", {}, make("th", { scope: "row" }, label), make("td"), make("td"));
    }));
    this.page.legend.replaceChildren();
  }

  showScores() {
    const said = [];
    this.answer.scores.forEach((score, number) => {
      const [, log, over] = this.page.scores.rows[number].cells;
      log.textContent = score.log === null ? "impossible" : minus(score.log.toFixed(1));
      over.textContent = score.over_reference === null ? "–" : signed(score.over_reference, 1);
      if (number === this.set) said.push(`${this.start.sets[number].label}: ${log.textContent}, over reference ${over.textContent}`);
    });
    this.values[this.set] = { ...this.answer.values };
    this.showValues();
    this.showLegend();
    clearTimeout(this.saying);
    this.saying = setTimeout(() => { this.page.said.textContent = `${this.page.pose.textContent}. ${said}`; }, 700);
  }

  showLegend() {
    const kind = this.start.sets[this.set].kind;
    const entry = (name, text) => make("li", {}, make("span", { className: `swatch ${name}` }), text);
    const entries = kind === "beam" ? CAUSES.map((name) => entry(name, CAUSE_WORDS[name]))
      : kind === "field" ? [entry("hit", "near an obstacle"), entry("short", "far from any"), make("li", { textContent: "grey: not looked at" })] : [entry("hit", "reading")];
    this.page.legend.replaceChildren(...entries, make("li", { textContent: "line: expected ranges" }));
  }

  listSliders() {
    this.inputs = {};
    this.page.sliders.replaceChildren(...this.start.sets[this.set].sliders.map((slider) => {
      const id = `beamfield-${slider.name}`;
      const input = make("input", { type: "range", id, min: 0, max: 1000, step: 1 });
      const output = make("output");
      output.setAttribute("for", id);
      input.addEventListener("input", () => {
        this.values[this.set][slider.name] = toValue(slider, Number(input.value) / 1000);
        output.textContent = `${digits(this.values[this.set][slider.name])} ${slider.unit}`;
        this.changed();
        this.judge();
      });
      this.inputs[slider.name] = { slider, input, output };
      return make("div", { className: "slider" }, make("label", { for: id, textContent: slider.name }), output, input);
    }));
    this.showValues();
    this.judge();
  }

  showValues() {
    for (const [name, { slider, input, output }] of Object.entries(this.inputs)) {
      const value = this.values[this.set][name];
      if (document.activeElement !== input) input.value = Math.round(1000 * toShare(slider, value));
      output.textContent = `${digits(value)} ${slider.unit}`;
      input.setAttribute("aria-valuetext", output.textContent);
    }
    this.page.reset.disabled = Object.keys(this.moved()).length === 0;
  }

  judge() {
    this.latest.send(this.message("judge"), ({ now, before, scans }) => {
      this.page.judged.textContent = now === null ? "" :
        `Mean log likelihood of a beam over ${scans} scans of the log: ${minus(now.toFixed(3))} nats` +
        (Math.abs(now - before) < 5e-4 ? "" : ` (${signed(now - before, 3)} by your change)`);
    });
  }

  listen() {
    const { page } = this;
    page.scan.addEventListener("input", () => this.toScan(Number(page.scan.value)));
    page.play.addEventListener("click", () => this.togglePlay());
    page.reference.addEventListener("click", () => this.toReference());
    page.reset.addEventListener("click", () => {
      this.values[this.set] = { ...this.start.sets[this.set].values };
      this.showValues(); this.changed(); this.judge();
    });
    page.heat.addEventListener("click", () => this.toggleHeat());
    page.building.addEventListener("click", () => this.wholeBuilding());
    page.filter.addEventListener("click", () => this.runFilter());
    page.download.addEventListener("click", () => this.latest.send(this.message("file"), ({ file, text }) => download(file, text)));
    page.copy.addEventListener("click", async () => {
      await navigator.clipboard.writeText(this.place.address()).catch(() => {});
      page.copy.textContent = "Copied";
      setTimeout(() => { page.copy.textContent = "Copy link"; }, 1500);
    });
    page.series.addEventListener("change", () => { this.drawTimeline(); this.listWorst(); });
    page.line.addEventListener("click", (event) => {
      const share = event.offsetX / page.line.clientWidth;
      this.toScan(nearestTime(this.start.times, share * this.start.times.at(-1)));
    });
    page.map.addEventListener("wheel", (event) => { event.preventDefault(); this.zoom(Math.exp(-event.deltaY / 500), event.offsetX, event.offsetY); }, { passive: false });
    page.map.addEventListener("keydown", (event) => this.key(event));
    this.drag();
  }

  drag() {
    const { page } = this;
    const fingers = new Map();
    let grabbed = null;
    page.map.addEventListener("pointerdown", (event) => {
      page.map.setPointerCapture(event.pointerId);
      fingers.set(event.pointerId, [event.offsetX, event.offsetY]);
      const [x, y] = this.toScreen(this.pose), [tipX, tipY] = this.tip();
      if (Math.hypot(event.offsetX - tipX, event.offsetY - tipY) < GRAB) grabbed = "turn";
      else if (Math.hypot(event.offsetX - x, event.offsetY - y) < GRAB) grabbed = "move";
      else { grabbed = "pan"; this.pointAt(event.offsetX, event.offsetY); }
    });
    page.map.addEventListener("pointermove", (event) => {
      const before = fingers.get(event.pointerId), now = [event.offsetX, event.offsetY];
      if (!before) { this.pointAt(...now); return; }
      if (fingers.size === 2) {
        const other = [...fingers.entries()].find(([id]) => id !== event.pointerId)[1];
        const ratio = Math.hypot(now[0] - other[0], now[1] - other[1]) / Math.hypot(before[0] - other[0], before[1] - other[1]);
        this.zoom(ratio, ...other);
      } else if (grabbed === "pan") {
        this.view.x -= (now[0] - before[0]) / this.view.scale;
        this.view.y += (now[1] - before[1]) / this.view.scale;
        this.draw();
      } else {
        const [x, y] = this.toMap(...now);
        this.pose = grabbed === "move" ? [x, y, this.pose[2]] : [this.pose[0], this.pose[1], Math.atan2(y - this.pose[1], x - this.pose[0])];
        this.changed();
      }
      fingers.set(event.pointerId, now);
    });
    for (const name of ["pointerup", "pointercancel"]) page.map.addEventListener(name, (event) => fingers.delete(event.pointerId));
  }

  key(event) {
    const small = event.shiftKey ? 0.2 : 1;
    const move = (x, y, turn) => { this.pose = [this.pose[0] + x, this.pose[1] + y, wrapped(this.pose[2] + turn)]; this.changed(); };
    const middle = [this.page.map.clientWidth / 2, this.page.map.clientHeight / 2];
    const actions = {
      ArrowUp: () => move(0, 0.1 * small, 0), ArrowDown: () => move(0, -0.1 * small, 0),
      ArrowLeft: () => move(-0.1 * small, 0, 0), ArrowRight: () => move(0.1 * small, 0, 0),
      "[": () => move(0, 0, 0.05 * small), "]": () => move(0, 0, -0.05 * small),
      "{": () => move(0, 0, 0.01), "}": () => move(0, 0, -0.01),
      ",": () => this.toScan(this.i - 1), ".": () => this.toScan(this.i + 1),
      "+": () => this.zoom(1.25, ...middle), "-": () => this.zoom(0.8, ...middle),
      r: () => this.toReference(), h: () => this.toggleHeat(), " ": () => this.togglePlay(),
    };
    if (event.ctrlKey || event.metaKey || event.altKey || !actions[event.key]) return;
    event.preventDefault();
    actions[event.key]();
  }

  toScan(i) {
    this.i = Math.max(0, Math.min(this.start.times.length - 1, i));
    const known = this.run?.poses[this.i] ?? this.start.poses[this.i];
    if (known) this.pose = [...known];
    this.heat = null;
    this.keepInView();
    this.changed();
  }

  toReference() {
    if (this.start.poses[this.i]) { this.pose = [...this.start.poses[this.i]]; this.changed(); }
  }

  togglePlay() {
    if (this.playing) { clearInterval(this.playing); this.playing = null; }
    else {
      this.playing = setInterval(() => {
        if (this.i + 1 >= this.start.times.length) this.togglePlay(); else this.toScan(this.i + 1);
      }, FRAME_MS);
    }
    this.page.play.textContent = this.playing ? "Pause" : "Play";
  }

  toggleHeat() {
    this.showHeat = !this.showHeat;
    this.page.heat.setAttribute("aria-pressed", String(this.showHeat));
    this.heat = null;
    this.changed();
  }

  wholeBuilding() {
    this.page.building.disabled = true;
    this.latest.send(this.message("building"), (found) => { this.heat = found; this.fit(); this.draw(); });
    this.page.building.disabled = false;
  }

  runFilter() {
    if (this.run) { this.run = null; this.page.filter.textContent = "Run filter"; this.draw(); return; }
    this.latest.send(this.message("filter"), (run) => {
      const poses = Array(this.start.times.length).fill(null);
      run.poses.forEach((pose, k) => { poses[run.first + k] = pose.includes(null) ? null : pose; });
      this.run = { poses, particles: run.particles };
      this.page.filter.textContent = "Hide filter";
      this.draw();
    });
  }

  // The reading whose end is nearest to the pointer.
  pointAt(screenX, screenY) {
    if (!this.answer) return;
    let best = null, nearest = NEAR;
    this.ends(this.answer.ranges).forEach((end, beam) => {
      if (!end) return;
      const [x, y] = this.toScreen(end), off = Math.hypot(x - screenX, y - screenY);
      if (off < nearest) { best = beam; nearest = off; }
    });
    if (best !== null && best !== this.beam) { this.beam = best; this.askDensity(); this.draw(); }
  }

  // Where beams of given ranges end in the map, from the robot's pose now; null where there is none.
  ends(ranges) {
    const [x, y, heading] = this.pose, cos = Math.cos(heading), sin = Math.sin(heading);
    return this.start.mounts.map(([mx, my, turn], beam) => {
      const range = ranges[beam];
      if (range === null || range === undefined) return null;
      const bx = mx + range * Math.cos(turn), by = my + range * Math.sin(turn);
      return [x + cos * bx - sin * by, y + sin * bx + cos * by];
    });
  }

  toScreen([x, y]) {
    const { clientWidth, clientHeight } = this.page.map;
    return [clientWidth / 2 + (x - this.view.x) * this.view.scale, clientHeight / 2 - (y - this.view.y) * this.view.scale];
  }

  toMap(screenX, screenY) {
    const { clientWidth, clientHeight } = this.page.map;
    return [this.view.x + (screenX - clientWidth / 2) / this.view.scale, this.view.y - (screenY - clientHeight / 2) / this.view.scale];
  }

  tip() {
    const [x, y] = this.toScreen(this.pose);
    return [x + ARROW * Math.cos(this.pose[2]), y - ARROW * Math.sin(this.pose[2])];
  }

  zoom(ratio, screenX, screenY) {
    const [x, y] = this.toMap(screenX, screenY);
    this.view.scale = Math.max(1, Math.min(400, this.view.scale * ratio));
    const [nowX, nowY] = this.toMap(screenX, screenY);
    this.view.x += x - nowX; this.view.y += y - nowY;
    this.draw();
  }

  // Show where the robot went, or all of the map while a heat map covers it.
  fit() {
    const { clientWidth, clientHeight } = this.page.map;
    const known = this.start.poses.filter(Boolean), map = this.start.map;
    const whole = this.heat?.rows !== undefined || known.length === 0;
    const xs = whole ? [map.origin[0], map.origin[0] + map.width_m] : known.map((pose) => pose[0]);
    const ys = whole ? [map.origin[1], map.origin[1] + map.height_m] : known.map((pose) => pose[1]);
    const margin = whole ? 0 : 5, low = [xs, ys].map((v) => Math.min(...v) - margin), high = [xs, ys].map((v) => Math.max(...v) + margin);
    this.view = { x: (low[0] + high[0]) / 2, y: (low[1] + high[1]) / 2,
      scale: Math.max(1, Math.min(120, clientWidth / (high[0] - low[0]), clientHeight / (high[1] - low[1]))) };
  }

  keepInView() {
    const [x, y] = this.toScreen(this.pose), { clientWidth, clientHeight } = this.page.map;
    if (x < 0.1 * clientWidth || x > 0.9 * clientWidth || y < 0.1 * clientHeight || y > 0.9 * clientHeight) [this.view.x, this.view.y] = this.pose;
  }

  draw() {
    cancelAnimationFrame(this.frame);
    this.frame = requestAnimationFrame(() => this.drawMap());
  }

  drawMap() {
    const context = sharp(this.page.map), colours = this.colours(), { clientWidth, clientHeight } = this.page.map;
    context.fillStyle = colours.unknown;
    context.fillRect(0, 0, clientWidth, clientHeight);
    const { map } = this.start;
    if (this.picture) this.drawImage(context, this.picture, map.origin, map.width_m, map.height_m, this.view.scale * map.width_m / this.picture.width < 1);
    if (this.heat) this.drawHeat(context, colours);
    this.drawWays(context, colours);
    if (this.answer) { this.drawExpected(context, colours); this.drawReadings(context, colours); }
    this.drawRobot(context, colours);
    this.drawScale(context, colours);
  }

  // An image whose lower-left corner lies at a pose of the map.
  drawImage(context, image, [x, y, heading], width, height, smooth) {
    const [screenX, screenY] = this.toScreen([x, y]);
    context.save();
    context.imageSmoothingEnabled = smooth;
    context.translate(screenX, screenY);
    context.rotate(-heading);
    context.drawImage(image, 0, -height * this.view.scale, width * this.view.scale, height * this.view.scale);
    context.restore();
  }

  drawHeat(context, colours) {
    const heat = this.heat, building = heat.rows !== undefined;
    const rows = building ? heat.rows : heat.places, cols = building ? heat.cols : heat.places;
    heat.image ??= shaded(heat.heat, rows, cols, colours.rand);
    if (building) this.drawImage(context, heat.image, heat.origin, cols * heat.step_m, rows * heat.step_m, true);
    else {
      const half = heat.width_m / 2, [x, y] = heat.centre;
      this.drawImage(context, heat.image, [x - half, y - half, 0], heat.width_m, heat.width_m, true);
    }
    const [x, y] = this.toScreen(heat.best);
    context.strokeStyle = colours.rand; context.lineWidth = 2;
    context.beginPath(); context.moveTo(x - 6, y); context.lineTo(x + 6, y); context.moveTo(x, y - 6); context.lineTo(x, y + 6); context.stroke();
  }

  drawWays(context, colours) {
    this.drawLine(context, this.start.poses, colours.quiet, 1.2);
    if (!this.run) return;
    this.drawLine(context, this.run.poses, colours.accent, 2);
    const at = Object.keys(this.run.particles).map(Number).filter((i) => i <= this.i).pop();
    context.fillStyle = colours.accent;
    for (const particle of this.run.particles[at] ?? []) { const [x, y] = this.toScreen(particle); context.fillRect(x - 1.5, y - 1.5, 3, 3); }
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
    this.drawLine(context, this.ends(this.answer.expected), colours.quiet, 1);
    context.globalAlpha = 1;
  }

  drawReadings(context, colours) {
    const ends = this.ends(this.answer.ranges), kind = this.start.sets[this.set].kind;
    ends.forEach((end, beam) => {
      if (!end) return;
      const share = this.answer.shares?.[beam];
      if (kind === "beam" && !share) return;
      context.fillStyle = kind === "beam" ? colours[CAUSES[largest(share)]] : kind === "stack" ? colours.hit : !share ? colours.quiet : share[0] > 0.5 ? colours.hit : colours.short;
      const [x, y] = this.toScreen(end), size = beam === this.beam ? 5 : 2.6;
      context.beginPath(); context.arc(x, y, size, 0, 2 * Math.PI); context.fill();
      if (beam === this.beam) this.drawLine(context, [this.pose, end], colours.accent, 1);
    });
  }

  drawRobot(context, colours) {
    const [x, y] = this.toScreen(this.pose), [tipX, tipY] = this.tip();
    Object.assign(this.page.map.dataset, { robot: `${x} ${y}`, tip: `${tipX} ${tipY}` }); // for whoever drives the page
    context.strokeStyle = colours.accent; context.fillStyle = colours.accent; context.lineWidth = 3;
    context.beginPath(); context.moveTo(x, y); context.lineTo(tipX, tipY); context.stroke();
    context.beginPath(); context.arc(tipX, tipY, 6, 0, 2 * Math.PI); context.fill();
    context.globalAlpha = 0.85;
    context.beginPath(); context.arc(x, y, ROBOT, 0, 2 * Math.PI); context.fill();
    context.globalAlpha = 1;
  }

  drawScale(context, colours) {
    const metres = [0.1, 0.5, 1, 2, 5, 10, 20, 50].find((m) => m * this.view.scale > 60) ?? 100;
    const { clientWidth, clientHeight } = this.page.map, right = clientWidth - 14, y = clientHeight - 14;
    context.strokeStyle = context.fillStyle = colours.ink; context.lineWidth = 2; context.font = "12px system-ui, sans-serif"; context.textAlign = "right";
    context.beginPath(); context.moveTo(right - metres * this.view.scale, y); context.lineTo(right, y); context.stroke();
    context.fillText(`${metres} m`, right, y - 6);
  }

  showDensity(density) {
    const { page } = this, context = sharp(page.density), colours = this.colours(), { clientWidth: width, clientHeight: height } = page.density;
    context.clearRect(0, 0, width, height);
    const measured = density.measured === null ? "no measurement" : `measured ${density.measured.toFixed(2)} m`;
    let text = `Reading ${this.beam}: ${measured}, expected ${density.expected.toFixed(2)} m.`;
    if (!density.curves) { page.densityText.textContent = `${text} Only a beam model has a density of the range.`; return; }
    if (density.shares.some((share) => share > 0)) {
      text += ` Causes: ${CAUSES.map((name, k) => `${name} ${Math.round(100 * density.shares[k])} %`).join(", ")}.`;
    }
    page.densityText.textContent = text;
    page.density.setAttribute("aria-label", `Density of the range. ${text}`);
    const { ranges, curves } = density, end = this.start.max_range, bottom = height - 18;
    const total = ranges.map((_, k) => curves.hit[k] + curves.short[k] + curves.rand[k]);
    const low = Math.log10(Math.max(1e-4, Math.min(...total) / 2)), high = Math.log10(Math.max(...total) * 1.5);
    const toX = (range) => 4 + (width - 8) * range / end;
    const toY = (value) => bottom - (bottom - 6) * (Math.log10(Math.max(value, 1e-12)) - low) / (high - low);
    const curve = (values, colour, thick) => {
      context.strokeStyle = colour; context.lineWidth = thick; context.beginPath();
      values.forEach((value, k) => { const y = Math.min(bottom + 2, toY(value)); if (k) context.lineTo(toX(ranges[k]), y); else context.moveTo(toX(ranges[k]), y); });
      context.stroke();
    };
    curve(curves.short, colours.short, 1); curve(curves.rand, colours.rand, 1); curve(curves.hit, colours.hit, 1); curve(total, colours.ink, 2);
    if (density.measured !== null) {
      context.strokeStyle = colours.accent; context.setLineDash([4, 3]); context.beginPath();
      context.moveTo(toX(density.measured), 4); context.lineTo(toX(density.measured), bottom); context.stroke(); context.setLineDash([]);
    }
    context.fillStyle = colours.quiet; context.font = "11px system-ui, sans-serif"; context.textAlign = "left";
    context.fillText("0", 4, height - 4); context.textAlign = "right"; context.fillText(`${end.toFixed(1)} m`, width - 4, height - 4);
    context.textAlign = "center"; context.fillText("density per metre, logarithmic; dashed: measured", width / 2, height - 4);
  }

  drawTimeline() {
    const { page, start } = this, values = start.numbers[page.series.value];
    if (!values) return;
    const context = sharp(page.line), colours = this.colours(), { clientWidth: width, clientHeight: height } = page.line;
    const known = values.filter((value) => value !== null), low = Math.min(...known), high = Math.max(...known), end = start.times.at(-1) || 1;
    const toX = (k) => width * start.times[k] / end, toY = (value) => height - 6 - (height - 12) * (high > low ? (value - low) / (high - low) : 0.5);
    context.clearRect(0, 0, width, height);
    context.strokeStyle = colours.hit; context.lineWidth = 1.4; context.beginPath();
    let drawing = false;
    values.forEach((value, k) => {
      if (value === null) { drawing = false; return; }
      if (drawing) context.lineTo(toX(k), toY(value)); else context.moveTo(toX(k), toY(value));
      drawing = true;
    });
    context.stroke();
    context.strokeStyle = colours.short; context.lineWidth = 2; context.beginPath();
    context.moveTo(toX(this.i), 0); context.lineTo(toX(this.i), height); context.stroke();
    context.fillStyle = colours.quiet; context.font = "11px system-ui, sans-serif"; context.textAlign = "left";
    context.fillText(digits(high), 2, 11); context.fillText(digits(low), 2, height - 3);
    page.line.setAttribute("aria-label", `Timeline of ${page.series.value}: ${values[this.i] === null ? "no value" : digits(values[this.i])} now, from ${digits(low)} to ${digits(high)}`);
  }

  // Scans that fit worst, two seconds apart: neighbours look alike.
  listWorst() {
    const values = this.start.numbers["p-value"] ?? this.start.numbers[this.page.series.value];
    if (!values) return;
    const order = values.map((value, i) => [value, i]).filter(([value]) => value !== null).sort((a, b) => a[0] - b[0]);
    const chosen = [];
    for (const [value, i] of order) {
      if (chosen.length >= 6) break;
      if (chosen.every(([, other]) => Math.abs(this.start.times[i] - this.start.times[other]) > 2)) chosen.push([value, i]);
    }
    this.page.worst.replaceChildren("Worst scans:", ...chosen.map(([value, i]) => {
      const made = button(`${this.start.times[i].toFixed(1)} s`, `Scan ${i + 1}: ${digits(value)}`);
      made.addEventListener("click", () => this.toScan(i));
      return made;
    }));
  }
}

const degrees = (radians) => 180 * radians / Math.PI;
const wrapped = (angle) => Math.atan2(Math.sin(angle), Math.cos(angle));
const minus = (text) => text.replace("-", "−");
const signed = (value, n) => `${value < 0 ? "−" : "+"}${Math.abs(value).toFixed(n)}`;
const digits = (value) => (value === 0 ? "0" : Math.abs(value) < 1e-3 ? minus(value.toExponential(1)) : minus(String(Number(value.toPrecision(3)))));
const largest = (values) => values.indexOf(Math.max(...values));

function toShare({ low, high, logarithmic }, value) {
  return logarithmic ? Math.log(value / low) / Math.log(high / low) : (value - low) / (high - low);
}

function toValue({ low, high, logarithmic }, share) {
  return Math.max(low, Math.min(high, logarithmic ? low * (high / low) ** share : low + share * (high - low)));
}

function nearestTime(times, time) {
  let best = 0;
  times.forEach((value, i) => { if (Math.abs(value - time) < Math.abs(times[best] - time)) best = i; });
  return best;
}

// A canvas whose pixels are those of the screen; returns a context that counts in CSS pixels.
function sharp(canvas) {
  const ratio = globalThis.devicePixelRatio || 1, width = Math.round(canvas.clientWidth * ratio), height = Math.round(canvas.clientHeight * ratio);
  if (canvas.width !== width || canvas.height !== height) { canvas.width = width; canvas.height = height; }
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  return context;
}

function rgb(colour) {
  const context = new OffscreenCanvas(1, 1).getContext("2d");
  context.fillStyle = colour;
  context.fillRect(0, 0, 1, 1);
  return [...context.getImageData(0, 0, 1, 1).data];
}

// The map's picture, white where free and black where occupied, in the colours of the page.
async function recoloured(base64, colours) {
  const image = new Image();
  image.src = `data:image/png;base64,${base64}`;
  await image.decode();
  const canvas = new OffscreenCanvas(image.width, image.height), context = canvas.getContext("2d");
  context.drawImage(image, 0, 0);
  const pixels = context.getImageData(0, 0, image.width, image.height), wall = rgb(colours.wall), free = rgb(colours.free);
  for (let k = 0; k < pixels.data.length; k += 4) {
    if (pixels.data[k + 3] > 0) pixels.data.set((pixels.data[k] < 128 ? wall : free).slice(0, 3), k);
  }
  context.putImageData(pixels, 0, 0);
  return canvas;
}

// Bytes, the lowest row first, as an image that is the denser the larger they are.
function shaded(base64, rows, cols, colour) {
  const bytes = atob(base64), canvas = new OffscreenCanvas(cols, rows), context = canvas.getContext("2d"), [r, g, b] = rgb(colour);
  const pixels = context.createImageData(cols, rows);
  for (let row = 0; row < rows; row++) {
    for (let col = 0; col < cols; col++) {
      pixels.data.set([r, g, b, 0.85 * bytes.charCodeAt(row * cols + col)], 4 * ((rows - 1 - row) * cols + col));
    }
  }
  context.putImageData(pixels, 0, 0);
  return canvas;
}

function download(name, text) {
  const link = make("a", { href: URL.createObjectURL(new Blob([text], { type: "text/plain" })), download: name });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 1000);
}
