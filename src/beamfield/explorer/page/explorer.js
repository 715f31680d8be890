// The explorer: a log in its map, and what models say of a scan at a pose. `ask` sends a message and returns a promise
// of the answer, so the same component runs on a page of its own and in a notebook.
import { Comparison, POSE } from "./comparison.js";
import { build, make } from "./elements.js";
import { Latest } from "./latest.js";
import { MapView } from "./map_view.js";
import { Panels } from "./panels.js";
import { coloursOf, download, recoloured } from "./pictures.js";
import { degrees, minus, wrapped } from "./words.js";

const HEAT_WIDTH = 4, AROUND = 12; // metres: of the heat map, and of the map at first
const FRAME_MS = 100; // between two scans while playing
const REST_MS = 350; // after which the robot counts as at rest
const MOST_DRAWN = 2000; // points of the robot's way
const HEAT_MS = 100; // between two heat maps: the page and the scores need the processors, too

export async function mount(root, ask, place = null) {
  let start;
  try { start = await ask({ name: "start" }); } catch (error) {
    root.replaceChildren(make("p", { className: "trouble", role: "alert", textContent: error.message }));
    return;
  }
  // What can be seen works: nothing is waited for between the two.
  await new Explorer(build(root, place !== null), start, ask, place).begin();
}

class Explorer {
  constructor(page, start, ask, place) {
    Object.assign(this, { page, start, place });
    this.latest = new Latest(ask, (text) => { page.trouble.textContent = text; });
    const said = place?.read() ?? {};
    const within = (value, n, otherwise) => (Number.isInteger(value) && value >= 0 && value < n ? value : otherwise);
    this.i = within(said.i, start.times.length, 0);
    this.set = within(said.set, start.sets.length, 0);
    this.other = within(said.other, start.sets.length, null);
    if (this.other === this.set) this.other = null;
    this.recorded = start.run && withUpdates(start.run);
    this.run = this.recorded;
    this.pose = said.pose ?? this.poseNow() ?? start.here;
    this.values = start.sets.map((one) => ({ ...one.values }));
    this.beam = null; this.answer = null; this.scores = null; this.playing = null; this.showHeat = true;
    this.view = { x: this.pose[0], y: this.pose[1], scale: 30 };
    const step = Math.ceil(start.poses.length / MOST_DRAWN);
    this.way = start.poses.filter((_, k) => k % step === 0);
    this.views = page.views.map((view) => new MapView(view, this));
    this.comparison = new Comparison(this, () => { this.panels.showVerdict(); this.panels.drawTimeline(); this.panels.listWorst(); });
    this.panels = new Panels(this);
  }

  async begin() {
    const { page } = this, painted = this.paint();
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.paint());
    this.listen();
    this.panels.begin();
    this.compare();
    new ResizeObserver(() => this.redraw()).observe(page.root);
    const { clientWidth, clientHeight } = page.views[0].canvas;
    this.view.scale = Math.min(clientWidth, clientHeight) / AROUND;
    this.showTime();
    this.changed();
    this.scored();
    await painted;
  }

  // In the colours of the page, which are others in the dark.
  async paint() {
    this.colours = coloursOf(this.page.root);
    this.picture = await recoloured(this.start.map.picture, this.colours);
    for (const view of this.views) delete view.heat?.image;
    this.redraw();
  }

  poseNow() { return this.run?.poses[this.i] ?? this.start.poses[this.i]; }

  // Something is at another place, time or value: ask anew, and show what is known at once.
  changed() {
    const { page, start } = this, [x, y, heading] = this.pose;
    page.pose.textContent = `x ${minus(x.toFixed(2))} m, y ${minus(y.toFixed(2))} m, heading ${minus(degrees(heading).toFixed(1))}°`;
    page.reference.disabled = start.poses[this.i] === null;
    const shown = this.other === null ? [this.set] : [this.set, this.other];
    this.latest.send(this.message("scan", { shown }), (answer) => {
      this.answer = answer;
      answer.values.forEach((values, number) => { this.values[number] = { ...values }; });
      this.panels.showScores();
      this.draw();
    });
    this.askHeat(true);
    clearTimeout(this.resting);
    this.resting = setTimeout(() => { this.askHeat(false); this.place?.write(this); }, REST_MS);
    this.askDensity();
    this.draw();
  }

  showTime() {
    const { page, start } = this;
    page.scan.value = this.i;
    page.when.textContent = `scan ${this.i + 1} of ${start.times.length}, ${start.times[this.i].toFixed(1)} s`;
    this.panels.drawTimeline();
  }

  // The scan or a value is another: what does not depend on the pose.
  scored() {
    if (this.start.poses[this.i] === null) { this.scores = null; this.panels.showPoseScores(); return; }
    const sets = this.start.sets.map((_, number) => number);
    this.latest.send(this.message("scores", { scans: [this.i], sets }), ({ scores: [score] }) => { this.scores = score; this.panels.showPoseScores(); });
  }

  valued() { this.changed(); this.scored(); this.panels.judge(); this.comparison.restart(); }

  message(name, more = {}) {
    return { name, i: this.i, pose: this.pose, set: this.set, parameters: this.moved(), ...more };
  }

  // Only what was moved, by the number of the set: weights that are not touched keep their ratios.
  moved() {
    const changes = this.start.sets.map((one, number) => [number, Object.entries(this.values[number]).filter(([name, value]) => value !== one.values[name])]);
    return Object.fromEntries(changes.filter(([, values]) => values.length).map(([number, values]) => [number, Object.fromEntries(values)]));
  }

  askHeat(dragged) {
    if (!this.showHeat) return;
    for (const view of this.views) {
      if (view.set === null) continue;
      const { set } = view;
      this.latest.send(this.message("heat", { set, width_m: HEAT_WIDTH, dragged }), (heat) => {
        if (!this.showHeat || view.set !== set) return;
        view.heat = heat;
        view.draw();
        this.panels.showLegends();
      }, { kind: `heat ${view.canvas.dataset.letter}`, every: HEAT_MS });
    }
  }

  askDensity() {
    if (this.beam === null) return;
    const { beam } = this, found = [];
    this.views.filter((view) => view.set !== null).forEach(({ set }, k, all) => {
      this.latest.send(this.message("density", { beam, set }), (density) => {
        found[k] = density;
        if (found.filter(Boolean).length === all.length) this.panels.showDensity(beam, found);
      }, { kind: `density ${k}` });
    });
  }

  // Show the models that are chosen, on one map or on two.
  compare() {
    [this.set, this.other].forEach((set, k) => {
      const view = this.views[k];
      if (view.set !== set) view.heat = null;
      view.set = set;
      view.canvas.dataset.letter = "AB"[k];
    });
    this.page.root.classList.toggle("two", this.other !== null);
    this.page.views[1].figure.hidden = this.other === null;
    this.comparison.restart();
    this.panels.listSliders();
    this.panels.showModels();
    this.panels.listCurves(this.other === null ? null : POSE);
    this.panels.drawTimeline();
    this.panels.showLegends();
  }

  choose(set, other) {
    // A model beside itself says nothing: the two change places.
    const beside = other === set ? (other === this.other ? this.set : null) : other;
    Object.assign(this, { set, other: beside });
    this.compare();
    this.changed();
  }

  listen() {
    const { page } = this;
    page.scan.addEventListener("input", () => this.toScan(Number(page.scan.value)));
    page.play.addEventListener("click", () => this.togglePlay());
    page.reference.addEventListener("click", () => this.toReference());
    page.fit.addEventListener("click", () => { this.fit(); this.draw(); });
    page.heat.addEventListener("click", () => this.toggleHeat());
    page.building.addEventListener("click", () => this.wholeBuilding());
    page.filter.addEventListener("click", () => this.runFilter());
    page.recorded.hidden = !this.recorded;
    page.recorded.addEventListener("click", () => this.show(this.run === this.recorded ? null : this.recorded));
    page.download.addEventListener("click", () => this.latest.send(this.message("file"), ({ file, text }) => download(file, text)));
    page.copy.addEventListener("click", async () => {
      this.place.write(this);
      const copied = await navigator.clipboard.writeText(this.place.address()).then(() => true, () => false);
      page.copy.textContent = copied ? "Copied" : "Copy it from the address bar";
      setTimeout(() => { page.copy.textContent = "Copy link"; }, 2000);
    });
    for (const view of this.views) {
      view.listen({
        moved: (pose) => { this.pose = pose; this.changed(); },
        pointed: (beam) => this.toReading(beam),
      });
      view.canvas.addEventListener("keydown", (event) => this.key(event, view));
    }
  }

  key(event, view) {
    const small = event.shiftKey ? 0.2 : 1, { start } = this;
    const move = (x, y, turn) => { this.pose = [this.pose[0] + x, this.pose[1] + y, wrapped(this.pose[2] + turn)]; this.changed(); };
    const actions = {
      ArrowUp: () => move(0, 0.1 * small, 0), ArrowDown: () => move(0, -0.1 * small, 0),
      ArrowLeft: () => move(-0.1 * small, 0, 0), ArrowRight: () => move(0.1 * small, 0, 0),
      "[": () => move(0, 0, 0.05), "]": () => move(0, 0, -0.05), "{": () => move(0, 0, 0.01), "}": () => move(0, 0, -0.01),
      ",": () => this.toScan(this.i - 1), ".": () => this.toScan(this.i + 1),
      "+": () => view.zoom(1.25), "-": () => view.zoom(0.8),
      n: () => this.toReading(((this.beam ?? -1) + 1) % start.mounts.length), b: () => this.toReading(((this.beam ?? 0) || start.mounts.length) - 1),
      r: () => this.toReference(), h: () => this.toggleHeat(), " ": () => this.togglePlay(),
    };
    if (event.ctrlKey || event.metaKey || event.altKey || !actions[event.key]) return;
    event.preventDefault();
    actions[event.key]();
  }

  toScan(i) {
    this.i = Math.max(0, Math.min(this.start.times.length - 1, i));
    const known = this.poseNow();
    if (known) this.pose = [...known];
    for (const view of this.views) view.heat = null;
    this.keepInView();
    this.showTime();
    this.changed();
    this.scored();
  }

  toReading(beam) {
    if (beam !== this.beam) { this.beam = beam; this.askDensity(); this.draw(); }
  }

  toReference() {
    if (this.start.poses[this.i]) { this.pose = [...this.start.poses[this.i]]; this.keepInView(); this.changed(); }
  }

  togglePlay() {
    if (this.playing) { clearInterval(this.playing); this.playing = null; }
    else {
      if (this.i + 1 >= this.start.times.length) this.toScan(0);
      this.playing = setInterval(() => {
        if (this.i + 1 >= this.start.times.length) this.togglePlay(); else this.toScan(this.i + 1);
      }, FRAME_MS);
    }
    this.page.play.textContent = this.playing ? "Pause" : "Play";
  }

  toggleHeat() {
    this.showHeat = !this.showHeat;
    this.page.heat.setAttribute("aria-pressed", String(this.showHeat));
    for (const view of this.views) view.heat = null;
    this.panels.showLegends();
    this.changed();
  }

  wholeBuilding() {
    const { building } = this.page;
    building.disabled = true;
    for (const view of this.views) {
      if (view.set === null) continue;
      this.latest.send(this.message("building", { set: view.set }), (heat) => {
        view.heat = heat;
        this.fit(true);
        this.draw();
        this.panels.showLegends();
      }, { kind: `building ${view.canvas.dataset.letter}`, done: () => { building.disabled = false; } });
    }
  }

  runFilter() {
    const { filter } = this.page;
    if (this.run && this.run !== this.recorded) { this.show(null); return; }
    Object.assign(filter, { disabled: true, textContent: "Running" });
    this.latest.send(this.message("filter"), (run) => this.show(withUpdates(run)), { done: () => { filter.disabled = false; this.show(this.run); } });
  }

  show(run) {
    const { filter, recorded } = this.page, own = run !== null && run !== this.recorded;
    this.run = run;
    filter.textContent = own ? "Hide filter" : "Run filter";
    filter.setAttribute("aria-pressed", String(own));
    recorded.setAttribute("aria-pressed", String(run !== null && !own));
    this.page.lost.textContent = own ? run.lost ?? "" : this.panels.warning;
    this.panels.showLegends();
    this.draw();
  }

  // Show where the robot went, or all that is free of the map.
  fit(whole = this.start.poses.every((pose) => pose === null)) {
    const { clientWidth, clientHeight } = this.page.views[0].canvas, { map, poses } = this.start, known = poses.filter(Boolean);
    const xs = whole ? map.free.slice(0, 2) : known.map((pose) => pose[0]);
    const ys = whole ? map.free.slice(2) : known.map((pose) => pose[1]);
    const margin = whole ? 2 : 5, low = [xs, ys].map((v) => Math.min(...v) - margin), high = [xs, ys].map((v) => Math.max(...v) + margin);
    Object.assign(this.view, { x: (low[0] + high[0]) / 2, y: (low[1] + high[1]) / 2,
      scale: Math.max(1, Math.min(120, clientWidth / (high[0] - low[0]), clientHeight / (high[1] - low[1]))) });
  }

  keepInView() {
    const [x, y] = this.views[0].toScreen(this.pose), { clientWidth, clientHeight } = this.page.views[0].canvas;
    if (x < 0.1 * clientWidth || x > 0.9 * clientWidth || y < 0.1 * clientHeight || y > 0.9 * clientHeight) [this.view.x, this.view.y] = this.pose;
  }

  draw() { for (const view of this.views) view.draw(); }

  redraw() { this.draw(); this.panels.drawTimeline(); this.panels.drawDensity(); }
}

function withUpdates(run) { return { ...run, updates: Object.keys(run.particles).map(Number).sort((a, b) => a - b) }; }
