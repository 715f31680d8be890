// What stands beside the map: models, parameters, one reading, time.
import { make, button } from "./elements.js";
import { CAUSES } from "./pictures.js";
import { densityWords, drawCurve, drawDensity } from "./plots.js";
import { digits, minus, nearestTime, signed, toShare, toValue } from "./words.js";

const CAUSE_WORDS = { hit: "hit", short: "short: something unmapped", max: "no return", rand: "unexplained" };
const WORST = 6, APART_S = 2; // scans that are listed, and seconds between them: neighbours look alike

export class Panels {
  constructor(explorer) { Object.assign(this, { explorer, page: explorer.page, start: explorer.start, density: null }); }

  begin() {
    const { explorer, page, start } = this;
    page.scan.max = start.times.length - 1;
    this.warning = start.run?.lost ?? (start.poses.some(Boolean) ? "" : "The log has no poses: drag the robot to where it was.");
    page.lost.textContent = this.warning;
    this.listModels();
    page.curve.addEventListener("change", () => { this.drawTimeline(); this.listWorst(); });
    page.line.addEventListener("click", (event) => explorer.toScan(nearestTime(start.times, event.offsetX / page.line.clientWidth * start.times.at(-1))));
    page.beside.addEventListener("change", () => explorer.choose(explorer.set, page.beside.value === "" ? null : Number(page.beside.value)));
    page.reset.addEventListener("click", () => this.setValues(start.sets[explorer.set].values));
    page.resetTo.addEventListener("change", () => this.setValues(start.sets[Number(page.resetTo.value)].values));
  }

  // Once: what has the focus must stay.
  listModels() {
    const { explorer, page, start } = this;
    this.radios = start.sets.map((_, number) => {
      const radio = make("input", { type: "radio", name: page.own });
      radio.addEventListener("change", () => explorer.choose(number, explorer.other));
      return radio;
    });
    page.scores.replaceChildren(...start.sets.map((one, number) => {
      const label = make("label", {}, this.radios[number], make("span", { textContent: one.label }));
      return make("tr", {}, make("th", { scope: "row" }, label), make("td"), make("td"), make("td"));
    }));
    page.beside.replaceChildren(new Option("nothing", ""), ...start.sets.map((one, number) => new Option(one.label, number)));
  }

  showModels() {
    const { explorer, page, start } = this;
    this.radios[explorer.set].checked = true;
    page.beside.value = explorer.other ?? "";
    for (const option of page.beside.options) option.disabled = option.value === String(explorer.set);
    page.views.forEach(({ caption, letter }, k) => {
      const set = [explorer.set, explorer.other][k];
      caption.textContent = explorer.other === null || set === null ? "" : `${letter}: ${start.sets[set].label}`;
    });
    if (explorer.answer) this.showScores();
    this.showPoseScores();
  }

  showScores() {
    const { explorer, page, start } = this, said = [];
    explorer.answer.scores.forEach((score, number) => {
      const [, log, over] = page.scores.rows[number].cells;
      log.textContent = score.log === null ? "impossible" : minus(score.log.toFixed(1));
      over.textContent = score.over_reference === null ? "–" : signed(score.over_reference, 1);
      if (number === explorer.set) said.push(`${start.sets[number].label}: ${log.textContent}, over reference ${over.textContent}`);
    });
    this.showValues();
    clearTimeout(this.saying);
    this.saying = setTimeout(() => { page.said.textContent = `${page.pose.textContent}. ${said}. ${page.verdict.textContent}`; }, 700);
  }

  showPoseScores() {
    const { explorer, page } = this;
    [...page.scores.rows].forEach((row, number) => { row.cells[3].textContent = explorer.scores ? signed(explorer.scores.pose[number], 1) : "–"; });
    this.showVerdict();
  }

  showVerdict() { this.page.verdict.textContent = this.explorer.comparison.words(this.explorer.scores); }

  showLegends() {
    this.explorer.views.forEach(({ set, heat }, k) => {
      if (set === null) return;
      const { kind } = this.start.sets[set], entry = (name, text) => make("li", {}, make("span", { className: `swatch ${name}` }), text);
      const entries = kind === "beam" ? CAUSES.map((name) => entry(name, CAUSE_WORDS[name]))
        : kind === "field" ? [entry("hit", "near an obstacle"), entry("short", "far from any"), make("li", { textContent: "grey: not looked at" })] : [entry("hit", "reading")];
      entries.push(make("li", { textContent: "line: expected ranges" }));
      if (this.start.poses.some(Boolean)) entries.push(entry("quiet", "path"));
      const { run, recorded } = this.explorer;
      if (run) entries.push(entry("belief", run === recorded ? "recorded run" : "filter"));
      if (heat) entries.push(entry("heat", heatWords(heat)));
      this.page.views[k].legend.replaceChildren(...entries);
    });
  }

  listSliders() {
    const { explorer, page, start } = this, own = start.sets[explorer.set], id = (name) => `${page.own}-${name}`;
    this.inputs = {};
    page.sliders.replaceChildren(...own.sliders.map((slider) => {
      const input = make("input", { type: "range", id: id(slider.name), min: 0, max: 1000, step: 1 }), output = make("output");
      output.setAttribute("for", input.id);
      input.addEventListener("input", () => {
        explorer.values[explorer.set][slider.name] = toValue(slider, Number(input.value) / 1000);
        this.showValues();
        explorer.valued();
      });
      this.inputs[slider.name] = { slider, input, output };
      return make("div", { className: "slider" }, make("label", { for: input.id, textContent: slider.name }), output, input);
    }));
    const family = [...start.sets.entries()].filter(([number, one]) => one.family === own.family && number !== explorer.set);
    const placeholder = new Option("Set to …", "", true, true);
    placeholder.disabled = true;
    page.resetTo.replaceChildren(placeholder, ...family.map(([number, one]) => new Option(one.label, number)));
    page.resetTo.hidden = family.length === 0;
    // A filter's replay decides these values, which takes minutes: the command does it, and writes a file to look at here.
    page.fitting.textContent = own.kind === "stack" ? `To fit them: beamfield calibrate LOG --map MAP --stack ${own.family.split(" ")[0]}; show its file with --params.` : "";
    this.showValues();
    this.judge();
  }

  setValues(values) {
    const { explorer, page } = this;
    explorer.values[explorer.set] = { ...values };
    page.resetTo.value = "";
    this.showValues();
    explorer.valued();
  }

  showValues() {
    const { explorer } = this;
    for (const [name, { slider, input, output }] of Object.entries(this.inputs)) {
      const value = explorer.values[explorer.set][name];
      if (document.activeElement !== input) input.value = Math.round(1000 * toShare(slider, value));
      const text = shown(slider, value);
      if (output.textContent === text) continue;
      output.textContent = text;
      input.setAttribute("aria-valuetext", text);
    }
    this.page.reset.disabled = explorer.moved()[explorer.set] === undefined;
  }

  judge() {
    const { explorer, page } = this;
    explorer.latest.send(explorer.message("judge"), ({ now, before, scans, held_out: heldOut }) => {
      const said = (what, name, n) => (now[name] === null ? [] : [`${what} ${minus(now[name].toFixed(n))} nats` +
        (Math.abs(now[name] - before[name]) < 0.5 * 10 ** -n ? "" : ` (${signed(now[name] - before[name], n)} by your change)`)]);
      const parts = [...said("pose score", "pose", 2), ...said("log likelihood of a reading", "reading", 3)];
      page.judged.textContent = parts.length ? `Mean over ${scans}${heldOut ? " held-out" : ""} scan${scans > 1 ? "s" : ""}: ${parts.join("; ")}.` : "";
    });
  }

  showDensity(beam, densities) {
    const { explorer, page } = this, words = densityWords(beam, densities, explorer.other === null ? null : "AB");
    this.density = densities;
    page.density.classList.remove("empty");
    page.densityText.textContent = words;
    page.density.setAttribute("aria-label", `Density of the range. ${words}`);
    this.drawDensity();
  }

  drawDensity() { if (this.density) drawDensity(this.page.density, this.density, this.start.max_range, this.explorer.colours); }

  // Curves of the log, and of the comparison if there is one; `first` is chosen if it is new.
  listCurves(first) {
    const { explorer, page, start } = this, before = page.curve.value, names = [...Object.keys(explorer.comparison.curves), ...Object.keys(start.numbers)];
    const had = [...page.curve.options].some((option) => option.value === first);
    page.curve.replaceChildren(...names.map((name) => new Option(name, name)));
    page.curve.value = first && !had ? first : names.includes(before) ? before : names[0] ?? "";
    page.curve.hidden = page.line.hidden = names.length === 0;
    this.listWorst();
  }

  curve() {
    const { explorer, page, start } = this, name = page.curve.value, difference = explorer.comparison.curves[name], values = difference ?? start.numbers[name];
    return values && { name, values, times: start.times, i: explorer.i, isDifference: difference !== undefined, level: start.levels[name] };
  }

  drawTimeline() {
    const curve = this.curve();
    if (curve) this.page.line.setAttribute("aria-label", drawCurve(this.page.line, curve, this.explorer.colours));
  }

  // Where to look: the scans that fit worst, or those where two models differ most.
  listWorst() {
    const { page } = this, curve = this.curve();
    page.worst.replaceChildren();
    if (page.line.hidden) page.worst.textContent = "No curve: no scan was judged. That takes reference poses, and is left out with --no-fit or fit=False.";
    if (!curve) return;
    const order = [...curve.values.entries()].filter(([, value]) => value !== null).sort((a, b) => a[1] - b[1]);
    if (curve.isDifference) {
      this.list("A better:", order.toReversed().filter(([, value]) => value > 0), WORST / 2);
      this.list("B better:", order.filter(([, value]) => value < 0), WORST / 2);
    } else {
      const high = /lost|error/.test(curve.name);
      this.list(`${high ? "Highest" : "Lowest"}:`, high ? order.toReversed() : order, WORST);
    }
  }

  list(title, order, n) {
    const { times } = this.start, chosen = [];
    for (const [i, value] of order) {
      if (chosen.length >= n) break;
      if (chosen.every(([other]) => Math.abs(times[i] - times[other]) > APART_S)) chosen.push([i, value]);
    }
    if (!chosen.length) return;
    this.page.worst.append(title, ...chosen.map(([i, value]) => {
      const made = button(`${times[i].toFixed(1)} s`, `Scan ${i + 1}: ${digits(value)}`);
      made.addEventListener("click", () => this.explorer.toScan(i));
      return made;
    }));
  }
}

const shown = ({ unit }, value) => `${digits(value)} ${unit}`.trim();

function heatWords({ beams: [used, of], best_over_here: over }) {
  const words = [used < of ? `heat map, ${used} of ${of} beams` : "heat map"];
  if (over !== undefined && over !== null) words.push(`cross: best place, ${signed(over, 1)} nats`);
  return words.join("; ");
}
